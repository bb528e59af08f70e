"""Makes the pictures of the cockpit's page, and the film of its first minutes, on a running rig.

`python docs/pictures_of_the_page.py [ADDRESS]` beside a rig with a cockpit (`python
test/cockpit/virtual.py FOLDER` starts a virtual one) writes `docs/images/cockpit_*.png` and
`cockpit.webm`. It arms and steers that rig. It needs Playwright and a Chromium.
"""

from __future__ import annotations

import base64
import io
import shutil
import sys
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
from PIL import Image
from playwright.sync_api import sync_playwright

IMAGES = Path(__file__).parent / 'images'
WIDE = {'width': 1440, 'height': 900}
PHONE, TABLET = {'width': 390, 'height': 844}, {'width': 820, 'height': 1180}
FILM = {'maxWidth': 800, 'maxHeight': 500}
_TICK = Fraction(1, 1000)


def main(address: str) -> None:
    """Visit the page at `address`, and keep what is seen."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=shutil.which('chromium'), args=['--no-sandbox', '--disable-gpu'])
        page = _open(browser.new_context(viewport=WIDE), address)
        film = Film(page)
        _first_minutes(page)
        _keep(page, 'cockpit_light')
        page.emulate_media(color_scheme='dark')
        page.click('#tab-field')
        page.wait_for_timeout(1500)
        _keep(page, 'cockpit_dark')
        page.click('#stop')
        page.wait_for_timeout(1500)
        page.close()
        for name, kind in (('cockpit_phone', PHONE), ('cockpit_tablet', TABLET)):
            small = _open(browser.new_context(viewport=kind, has_touch=True, is_mobile=True,
                                              device_scale_factor=1.5), address)
            small.click('#tab-estimates')
            small.wait_for_timeout(2000)
            _keep(small, name)
            small.close()
        browser.close()
    film.save(IMAGES / 'cockpit.webm')


def _keep(page: Any, name: str) -> None:
    """The `page` as an image of that `name`, in no more colours than are told apart."""
    picture = Image.open(io.BytesIO(page.screenshot()))
    picture.convert('RGB').quantize(128).save(IMAGES / f'{name}.png', optimize=True)


class Film:
    """What `page` shows from now on, as Chromium casts it."""

    def __init__(self, page: Any) -> None:
        self._frames: list[tuple[float, bytes]] = []
        self._session = page.context.new_cdp_session(page)
        self._session.on('Page.screencastFrame', self._keep)
        self._session.send('Page.startScreencast', {
            'format': 'jpeg', 'quality': 90, 'everyNthFrame': 6, **FILM})

    def _keep(self, frame: dict[str, Any]) -> None:
        self._frames.append((frame['metadata']['timestamp'], base64.b64decode(frame['data'])))
        self._session.send('Page.screencastFrameAck', {'sessionId': frame['sessionId']})

    def save(self, path: Path) -> None:
        """Write it to `path`, VP9 in WebM, each frame at its time."""
        with av.open(str(path), 'w') as file:
            stream = file.add_stream('libvpx-vp9', rate=10, options={
                'crf': '54', 'b': '0', 'deadline': 'good', 'cpu-used': '3'})
            stream.width, stream.height = FILM['maxWidth'], FILM['maxHeight']
            stream.pix_fmt, stream.time_base = 'yuv420p', _TICK
            begin, last = self._frames[0][0], -1
            for seconds, jpeg in self._frames:
                with av.open(io.BytesIO(jpeg)) as picture:
                    frame = next(picture.decode(video=0))
                last = max(round((seconds - begin) / _TICK), last + 1)
                frame = frame.reformat(stream.width, stream.height, 'yuv420p')
                frame.pts, frame.time_base = last, _TICK
                file.mux(stream.encode(frame))
            file.mux(stream.encode())


def _open(context: Any, address: str) -> Any:
    page = context.new_page()
    page.goto(address)
    page.wait_for_selector('#overlay .rings g', state='attached', timeout=60_000)
    if page.is_visible('#take-control'):
        page.click('#take-control')
    page.wait_for_selector('#arm:enabled', state='attached')
    return page


def _first_minutes(page: Any) -> None:
    """Look, arm, steer by hand, then let the controller go to a place, and along a path."""
    page.wait_for_timeout(1500)
    _switch(page, 'teleop')
    _arm(page)
    page.focus('#stick')
    for key in ['ArrowRight', 'ArrowUp', 'ArrowLeft', 'ArrowDown', 'ArrowRight']:
        page.keyboard.down(key)
        page.wait_for_timeout(2500)
        page.keyboard.up(key)
    _switch(page, 'path_following')
    _choose(page, 'path')
    places = [(0.30, 0.35), (0.45, 0.28), (0.60, 0.35), (0.64, 0.52), (0.52, 0.66), (0.36, 0.60)]
    page.mouse.move(*_place(page, *places[0]))
    page.mouse.down()
    for place in places[1:]:
        page.mouse.move(*_place(page, *place), steps=15)
    page.mouse.up()
    page.wait_for_timeout(8000)
    _switch(page, 'waypoint')
    _choose(page, 'goal')
    page.mouse.click(*_place(page, 0.62, 0.36))
    page.wait_for_timeout(8000)
    if page.get_attribute('#rig-chip', 'data-state') != 'armed':
        sys.exit(f'the rig did not stay armed: {page.inner_text("#rig-sentence")}')


def _arm(page: Any) -> None:
    page.hover('#arm')
    page.mouse.down()
    page.wait_for_selector('#rig-chip[data-state=armed]', timeout=20_000)
    page.mouse.up()


def _choose(page: Any, mode: str) -> None:
    page.click(f'#modes label:has(input[value={mode}])')


def _place(page: Any, right: float, down: float) -> tuple[float, float]:
    """A point of the page, by its shares of the picture."""
    box = page.locator('#frame').bounding_box()
    return box['x'] + right * box['width'], box['y'] + down * box['height']


def _switch(page: Any, name: str) -> None:
    page.select_option('#controller', name)
    page.click('#controller-form button')
    page.wait_for_selector(f'#controller-now:has-text("At work: {name.replace("_", " ")}.")')


if __name__ == '__main__':
    main(sys.argv[1] if sys.argv[1:] else 'http://127.0.0.1:8642/')
