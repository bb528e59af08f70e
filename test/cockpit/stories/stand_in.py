"""A rig that is none, behind the real server: it plays pictures and notes what it is asked."""

from __future__ import annotations

import asyncio
import math
import threading
import time
from typing import Any

import cv2
import numpy as np

from microbot_ros.cockpit.rig import Answer, ParticleListener, PictureListener, RefusedError

WIDTH, HEIGHT, PIXEL_UM = 1280, 960, 0.5
REDUCED = 2
RATE_HZ = 25.0


def state() -> dict[str, Any]:
    """What it tells to begin with."""
    return {
        'rig': 'disarmed', 'sentence': 'The coils are off; the driver is linked and well.',
        'link': {'age_ms': 12.0}, 'latency_ms': 17.4, 'picture_age_ms': 41.0,
        'recording': {'on': False, 'seconds': 0.0, 'lost': 0, 'title': ''},
        'field': {'wanted_mT': [3.0, 4.0], 'applied_mT': [2.9, 4.05], 'measured_mT': None},
        'controller': {
            'name': 'waypoint', 'goals': [], 'path': [],
            'available': [{'name': 'hold', 'summary': 'Stays where it is.'},
                          {'name': 'waypoint', 'summary': 'Goes straight to the goal.'},
                          {'name': 'teleop', 'summary': 'By joystick.'}],
            'parameters': [
                {'name': 'waypoint.field_mT', 'type': 'number', 'value': 5.0, 'minimum': 0.01,
                 'maximum': 100.0, 'unit': 'mT', 'description': 'Strength of the field.',
                 'read_only': False},
                {'name': 'waypoint.particle', 'type': 'integer', 'value': 1, 'minimum': -1,
                 'maximum': 2**31 - 1, 'unit': '', 'description': 'Which particle goes there.',
                 'read_only': False},
                {'name': 'slew_mT_per_s', 'type': 'number', 'value': 1000.0, 'minimum': 1.0,
                 'maximum': 1e6, 'unit': 'mT/s', 'description': 'Fastest change of the field.',
                 'read_only': True},
                {'name': 'waypoint.learn', 'type': 'boolean', 'value': True, 'minimum': None,
                 'maximum': None, 'unit': '', 'description': 'Whether drift is made up for.',
                 'read_only': False}]},
        'estimates': [
            {'id': n, 'v_um_s': 4.0 + n, 'v_std_um_s': 0.08, 'phi_deg': 24.0 - 3 * n,
             'phi_std_deg': 1.1, 'd_um2_s': 0.21, 'd_std_um2_s': 0.01,
             'force_pn': 0.088, 'force_std_pn': 0.002, 'reason': None} for n in range(3)],
        'currents_a': [0.31, -0.31, 0.42, -0.42],
        'health': [
            {'name': 'camera', 'level': 'ok', 'sentence': '100.0 frames/s, none lost.'},
            {'name': 'tracker', 'level': 'warn', 'sentence': 'Two particles crossed.'},
            {'name': 'coil_driver', 'level': 'ok', 'sentence': 'Answers within 1.1 ms.'}]}


class StandIn:
    """The rig. `heard` is what it was asked, each with the monotonic time [s]; `refusals` are its
    reasons by verb; `told` is its state, to be changed by a test; `shown` the particles' pixels by
    the stamp of each picture; `pictures`, `tracker` and `seen_by`, the camera, say what it has,
    and `camera_known` whether it says so; `slow` [s] is how long its particles come after their
    pictures."""

    def __init__(self) -> None:
        self.heard: list[tuple[float, str, Any]] = []
        self.refusals: dict[str, str] = {}
        self.told = state()
        self.shown: dict[int, dict[int, tuple[float, float]]] = {}
        self.slow = 0.02
        self.kinds = ['janus', 'debris']
        self.seen_by: dict[str, Any] | None = {
            'width_px': WIDTH, 'height_px': HEIGHT, 'pixel_size_um': PIXEL_UM}
        self.pictures = self.tracker = self.camera_known = True
        self._quit = threading.Event()
        self._heard_one = threading.Condition()

    def asked(self, verb: str) -> list[Any]:
        """What came with each `verb` so far."""
        return [what for _, name, what in self.heard if name == verb]

    def times(self, verb: str) -> list[float]:
        """When each `verb` came, monotonic [s]."""
        return [when for when, name, _ in self.heard if name == verb]

    def wait_for(self, verb: str, count: int = 1, timeout_s: float = 5.0) -> Any:
        """What came with the `count`th `verb`, as soon as it has come; AssertionError if it does
        not within `timeout_s` [s]."""
        with self._heard_one:
            came = self._heard_one.wait_for(lambda: len(self.asked(verb)) >= count, timeout_s)
        assert came, f'{verb} did not come {count}×; heard {[name for _, name, _ in self.heard]}'
        return self.asked(verb)[count - 1]

    def _note(self, verb: str, what: Any = None) -> Answer:
        with self._heard_one:
            self.heard.append((time.monotonic(), verb, what))
            self._heard_one.notify_all()
        if verb in self.refusals:
            raise RefusedError(self.refusals[verb])
        return ''

    # What the server needs of a rig ------------------------------------------------------------

    def watch(self, picture: PictureListener, particles: ParticleListener) -> None:
        self._thread = threading.Thread(target=self._play, args=(picture, particles), daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Show nothing any more."""
        self._quit.set()
        self._thread.join()

    def reopen(self) -> None:
        """Be ready to be watched again."""
        self._quit.clear()

    def look(self, wanted: bool) -> None:
        pass

    def camera(self) -> dict[str, Any] | None:
        return self.seen_by if self.camera_known else None

    def state(self) -> dict[str, Any]:
        takes = ['joystick'] if self.told['controller']['name'] == 'teleop' else ['goals', 'path']
        return {**self.told, 'controller': {**self.told['controller'], 'takes': takes}}

    async def keep_up(self) -> None:
        await asyncio.Event().wait()

    async def stop(self) -> Answer:
        self._note('stop')
        self.told = {**self.told, 'rig': 'disarmed', 'sentence': 'Stopped by a page.'}
        return 'zero, confirmed by a reading'

    async def arm(self) -> Answer:
        self._note('arm')
        self.told = {**self.told, 'rig': 'armed', 'sentence': 'Currents may flow.'}
        return 'armed'

    def attend(self) -> None:
        self._note('attend')

    def stick(self, x: float, y: float) -> None:
        self._note('stick', (x, y))

    async def goal(self, x_um: float, y_um: float, particle: int | None) -> Answer:
        return self._note('goal', (x_um, y_um, particle))

    async def clear_goals(self) -> Answer:
        return self._note('clear_goals')

    async def path(self, points_um: list[tuple[float, float]]) -> Answer:
        return self._note('path', points_um)

    async def switch_controller(self, name: str) -> Answer:
        self._note('switch_controller', name)
        self.told = {**self.told, 'controller': {**self.told['controller'], 'name': name}}
        return f'{name} is at work'

    async def set(self, name: str, value: Any) -> Answer:
        self._note('set', (name, value))
        for one in self.told['controller']['parameters']:
            if one['name'] == name:
                one['value'] = value
        self.told = {**self.told, 'controller': dict(self.told['controller'])}
        return f'{name} is {value}'

    async def teach(self, like: bool, x: float, y: float, kind: str | None, stamp: int) -> Answer:
        return self._note('teach', (like, x, y, kind, stamp))

    async def record(self, on: bool, title: str) -> Answer:
        self._note('record', (on, title))
        self.told = {**self.told, 'recording': {'on': on, 'seconds': 0.0, 'lost': 0,
                                                'title': title}}
        return ''

    async def note(self, text: str) -> Answer:
        return self._note('note', text)

    # Its pictures --------------------------------------------------------------------------------

    def _play(self, picture: PictureListener, particles: ParticleListener) -> None:
        while not self._quit.wait(1 / RATE_HZ):
            if not self.pictures:
                continue
            stamp = time.time_ns()
            places = _places(stamp)
            self.shown[stamp] = places
            if self.seen_by:
                picture(stamp, _jpeg(places))
            if self._quit.wait(self.slow) or not self.tracker:
                continue
            known = self.camera()
            particles({'kind': 'particles', 'stamp': str(stamp), 'particles': [
                {'id': n, 'kind': 'janus', 'x_px': x if known else None,
                 'y_px': y if known else None,
                 'x_um': (x - (WIDTH - 1) / 2) * PIXEL_UM,
                 'y_um': ((HEIGHT - 1) / 2 - y) * PIXEL_UM, 'heading_rad': 0.5 * n,
                 'sigma_px': 0.1} for n, (x, y) in places.items()]})


def _places(stamp: int) -> dict[int, tuple[float, float]]:
    """Three particles on circles, at some hundred pixels a second."""
    t = stamp * 1e-9 % 1000.0
    return {n: (300.0 + 320.0 * n + 60.0 * math.cos(2 * t + n),
                480.0 + 150.0 * math.sin(2 * t + n)) for n in range(3)}


def _jpeg(places: dict[int, tuple[float, float]]) -> bytes:
    image = np.full((HEIGHT // REDUCED, WIDTH // REDUCED), 150, np.uint8)
    image += (np.random.default_rng(0).normal(0, 3, image.shape)).astype(np.int8).view(np.uint8)
    for x, y in places.values():
        centre = [round(((p + 0.5) / REDUCED - 0.5) * 16) for p in (x, y)]
        cv2.circle(image, centre, 5 * 16, 60, -1, cv2.LINE_AA, 4)
    return cv2.imencode('.jpg', image)[1].tobytes()
