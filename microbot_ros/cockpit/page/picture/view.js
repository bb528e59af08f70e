// Where things are: pixels of the camera's full picture, micrometres of the workspace, and
// points of the page. Pixels as in tracks.csv: y down, the centre of the first one at 0, 0.

export class View {
  constructor(frame) {
    this.frame = frame;
    this.width = 640;
    this.height = 480;
    this.matrix = null;
    this.camera = null;
    this.zoom = 1;
    this.pan = [0, 0];
    this.#fit();
    new ResizeObserver(() => this.#fit()).observe(frame.parentElement);
  }

  // Take over the camera of the node's `hello`, null where it has none yet. Says whether places
  // from before are nowhere now.
  use(camera) {
    if (!camera) return false;
    const other = JSON.stringify(camera) !== JSON.stringify(this.camera);
    this.camera = camera;
    this.width = camera.width_px;
    this.height = camera.height_px;
    this.matrix = camera.to_um ?? upright(camera);
    this.#fit();
    return other;
  }

  // A picture has come: nothing has a place on it before its camera is known. Says as `use` does.
  cover() {
    const other = !this.camera && !this.covered;
    if (other) this.matrix = null;
    this.covered = true;
    return other;
  }

  // Without camera and picture: an empty ground, doubled until it holds all `particles`; their places on it.
  place(particles) {
    // Those that came before the node knew the camera lie nowhere in its picture.
    if (this.camera || this.covered) return particles.filter(({ x_px }) => this.camera && x_px !== null);
    const half = Math.max(this.matrix ? -this.matrix[0][2] : 50,
      ...particles.map(({ x_um, y_um }) => Math.max(Math.abs(x_um), Math.abs(y_um) * 4 / 3)));
    const pixel_size_um = 50 * 2 ** Math.ceil(Math.log2(half / 50) - 1e-9) / ((this.width - 1) / 2);
    this.matrix = upright({ width_px: this.width, height_px: this.height, pixel_size_um });
    return particles.map((particle) => {
      const [x_px, y_px] = this.fromMicrometres(particle.x_um, particle.y_um);
      return { ...particle, x_px, y_px };
    });
  }

  // Camera pixels → points of the page, from the frame's top left corner.
  toPage(x, y) {
    return [(x + 0.5) * this.scale, (y + 0.5) * this.scale];
  }

  toPixels(pageX, pageY) {
    return [pageX / this.scale - 0.5, pageY / this.scale - 0.5];
  }

  toMicrometres(x, y) {
    return this.matrix?.map(([a, b, c]) => a * x + b * y + c);
  }

  fromMicrometres(x, y) {
    const [[a, b, c], [d, e, f]] = this.matrix;
    const det = a * e - b * d;
    return [(e * (x - c) - b * (y - f)) / det, (a * (y - f) - d * (x - c)) / det];
  }

  micrometresToPage(x, y) {
    return this.toPage(...this.fromMicrometres(x, y));
  }

  // A direction as seen on the screen (right, up) in the axes of the workspace, as long as it was.
  direction(right, up) {
    if (!this.matrix) return [right, up];
    const [[a, b], [d, e]] = this.matrix;
    const pixel = Math.hypot(a, d);
    return [(a * right - b * up) / pixel, (d * right - e * up) / pixel];
  }

  // An angle of the workspace [rad] as a direction on the page (right, down).
  heading(angle) {
    if (!this.matrix) return [Math.cos(angle), -Math.sin(angle)];
    const [[a, b], [d, e]] = this.matrix;
    const pixel = Math.hypot(a, d);
    const [c, s] = [Math.cos(angle), Math.sin(angle)];
    return [(a * c + d * s) / pixel, (b * c + e * s) / pixel];
  }

  // Enlarge so many times; what is at a point of the window stays there.
  zoomTo(zoom, clientX, clientY) {
    const box = this.frame.getBoundingClientRect();
    const by = Math.min(Math.max(zoom, 1), 16) / this.zoom;
    this.zoom *= by;
    const keep = (at, low, size) => (at - low - size / 2) * (1 - by);
    this.move(keep(clientX, box.left, box.width), keep(clientY, box.top, box.height));
  }

  // Move the picture by so many points of the page; its edge does not come in where it is larger.
  move(right, down) {
    this.pan = [this.pan[0] + right, this.pan[1] + down];
    this.#fit();
  }

  #fit() {
    const { clientWidth, clientHeight } = this.frame.parentElement;
    this.scale = this.zoom * Math.max(Math.min(clientWidth / this.width, clientHeight / this.height), 0.01);
    const size = [this.width * this.scale, this.height * this.scale];
    const room = [(size[0] - clientWidth) / 2, (size[1] - clientHeight) / 2].map((one) => Math.max(one, 0));
    this.pan = this.pan.map((one, axis) => Math.min(Math.max(one, -room[axis]), room[axis]));
    Object.assign(this.frame.style, { width: `${size[0]}px`, height: `${size[1]}px`,
      left: `${(clientWidth - size[0]) / 2 + this.pan[0]}px`, top: `${(clientHeight - size[1]) / 2 + this.pan[1]}px` });
    this.frame.parentElement.style.setProperty('--wide', `${Math.min(size[0], clientWidth)}px`);
    this.frame.parentElement.style.setProperty('--high', `${Math.min(size[1], clientHeight)}px`);
    this.changed?.();
  }
}

// Of a camera that is neither turned nor mirrored, the origin at the picture's centre.
function upright({ width_px, height_px, pixel_size_um: p }) {
  return [[p, 0, -p * (width_px - 1) / 2], [0, -p, p * (height_px - 1) / 2]];
}
