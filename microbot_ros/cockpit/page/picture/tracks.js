// Where the particles were, by the stamps of the pictures they were found in.

const KEPT = 90;
// Beyond this a position is not carried over to another picture [ns].
const REACH = 250_000_000n;
// The tracker may take so long over a picture before that is shown without it [ms].
const PATIENCE_MS = 60;
const SILENT_MS = 1000;
const TRAIL_STEP = 200_000_000n;
const TRAIL_POINTS = 30;

export class Tracks {
  constructor() {
    this.readings = [];
    this.trails = new Map();
    this.heard = -Infinity;
    this.waiting = null;
  }

  clear() {
    this.readings = [];
    this.trails.clear();
  }

  // Resolves once the particles of `stamp` are here, or are not worth waiting for.
  async found(stamp) {
    const silent = performance.now() - this.heard > SILENT_MS;
    if (silent || this.readings.at(-1)?.stamp >= BigInt(stamp)) return;
    await new Promise((resolve) => {
      this.waiting = { stamp: BigInt(stamp), resolve };
      setTimeout(resolve, PATIENCE_MS);
    });
  }

  take({ stamp, particles }) {
    const reading = { stamp: BigInt(stamp), particles };
    // A stamp that goes back is another run, or a recording that begins anew.
    if (this.readings.length && reading.stamp <= this.readings.at(-1).stamp) this.clear();
    this.readings.push(reading);
    if (this.readings.length > KEPT) this.readings.shift();
    this.#extendTrails(reading);
    this.heard = performance.now();
    if (this.waiting?.stamp <= reading.stamp) this.waiting.resolve();
  }

  // The particles at `stamp`: as found there, or between the two readings around it.
  at(stamp) {
    const when = BigInt(stamp);
    const next = this.readings.findIndex((reading) => reading.stamp >= when);
    const after = this.readings[next];
    if (after?.stamp === when) return after.particles;
    const before = this.readings.at(next < 0 ? -1 : Math.max(next - 1, 0));
    if (!before || distance(before.stamp, when) > REACH) return [];
    if (!after || before.stamp > when) return before.particles;
    return between(before, after, when);
  }

  get newest() {
    return this.readings.at(-1)?.particles ?? [];
  }

  #extendTrails({ stamp, particles }) {
    for (const { id, x_px, y_px } of particles) {
      const trail = this.trails.get(id) ?? [];
      if (trail.length && stamp - trail.at(-1).stamp < TRAIL_STEP) continue;
      trail.push({ stamp, x: x_px, y: y_px });
      if (trail.length > TRAIL_POINTS) trail.shift();
      this.trails.set(id, trail);
    }
    const oldest = stamp - TRAIL_STEP * BigInt(TRAIL_POINTS);
    for (const [id, trail] of this.trails) {
      if (trail.at(-1).stamp < oldest) this.trails.delete(id);
    }
  }
}

const distance = (a, b) => (a < b ? b - a : a - b);

function between(before, after, when) {
  const share = Number(when - before.stamp) / Number(after.stamp - before.stamp);
  const later = new Map(after.particles.map((particle) => [particle.id, particle]));
  return before.particles.filter(({ id }) => later.has(id)).map((particle) => {
    const { x_px, y_px } = later.get(particle.id);
    return { ...particle, x_px: particle.x_px + share * (x_px - particle.x_px),
      y_px: particle.y_px + share * (y_px - particle.y_px) };
  });
}
