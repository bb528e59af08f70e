"""The cockpit beside a rig at work: what it costs the loop, and how soon it shows and stops."""

from __future__ import annotations

import json
import os
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from builtin_interfaces.msg import Time
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from sensor_msgs.msg import CameraInfo, CompressedImage
from std_srvs.srv import SetBool
from websockets.sync.client import ClientConnection, connect

from bench import _browser, _rig
from bench._emulator import EmulatorProcess
from bench.figure import Figure
from microbot_ros.cockpit.address import WORDS
from microbot_ros.common.errors import RigError
from microbot_ros.nodes.base.lifecycle import IMAGES_IN
from microbot_ros.nodes.client.graph import Graph
from microbot_ros.nodes.client.graph_client import GraphClient
from microbot_ros.session.mcap.recording import Recording
from microbot_ros.session.replay.log import header_stamp_ns
from microbot_ros.virtual_rig.microscope import Microscope, MicroscopeSettings

_ISSUE = 21
_WIDTH, _HEIGHT, _RATE_HZ, _FILMED = 1280, 1024, 100.0, 60
_ROUNDS, _PHASE_S, _RECORDED_S, _SETTLED_S = 4, 10.0, 15.0, 2.0
_LOOKED_S, _SLOWED_S, _SLOWER = 12.0, 18.0, 6.0
_PREVIEW_S = 1 / 30
_EVERY = QoSProfile(depth=500, reliability=QoSReliabilityPolicy.BEST_EFFORT)
_STOPS, _PATIENCE_S, _TRIES = 15, 3.0, 10


def figures() -> Iterator[Figure]:
    """All figures, of one run of some four minutes."""
    os.environ.setdefault('ROS_DOMAIN_ID', str(215 + os.getpid() % 17))  # nobody else's graph
    with tempfile.TemporaryDirectory(prefix='bench-cockpit-') as name:
        folder = Path(name)
        with (EmulatorProcess(folder) as board,
              _rig.running(folder, _film(), board, _RATE_HZ,
                           recorder={'recording': False}),
              GraphClient('bench') as client, _browser.browser() as browser):
            bench = _Bench(folder, client, browser)
            yield from bench.loop()
            yield bench.recorded()
            yield from bench.shown()
            yield bench.slowed()
            yield bench.two_pages()
            yield bench.stopped(board)


def _film() -> list[np.ndarray]:
    """Four particles at rest on a large sensor."""
    scope = Microscope(MicroscopeSettings(
        width_px=_WIDTH, height_px=_HEIGHT, pixel_size_um=0.45), seed=3)
    place = 1e-6 * np.array([[-80, 40], [70, 50], [-60, -70], [90, -60]])
    heading = np.array([0.3, 1.9, 3.5, 5.1])
    return [scope.render(place, heading, k / _RATE_HZ) for k in range(_FILMED)]


class _Bench:
    """A rig in a `folder`, that a `client` arms and a `browser` looks at by a cockpit."""

    def __init__(self, folder: Path, client: GraphClient, browser: Any) -> None:
        self._folder, self._client, self._browser = folder, client, browser
        self._answers = _rig.listen(client)

    @contextmanager
    def _cockpit(self) -> Iterator[tuple[str, psutil.Process]]:
        """A cockpit in a process of its own: its address, and the process."""
        said: list[str] = []
        parameters = self._folder / 'cockpit.yaml'
        parameters.write_text(json.dumps(
            {'cockpit': {'ros__parameters': {'port': 0, 'token': False}}}))
        with Graph(lambda _, line: said.append(line)) as graph:
            graph.start_node('cockpit', parameters)
            graph.wait_ready(60.0)
            while not (named := [line for line in said if WORDS in line]):
                graph.pump(0.1)
            address = Path(named[0].partition(WORDS)[2]).read_text().strip()
            yield address, psutil.Process(graph.process_id('cockpit'))

    @contextmanager
    def _looked_at(self) -> Iterator[Any]:
        """The page in the browser, settled."""
        with self._cockpit() as (address, _), _browser.page(self._browser, address) as page:
            self._client.spin(_SETTLED_S)
            yield page

    def loop(self) -> list[Figure]:
        """p99 from a frame to its currents, in turns with and without."""
        spent: dict[bool, list[float]] = {False: [], True: []}
        _rig.drive(self._client, self._answers, 5.0)
        for _ in range(_ROUNDS):
            spent[False] += self._spent_s()
            with self._looked_at():
                spent[True] += self._spent_s()
        bare, seen = (float(np.percentile(spent[key], 99)) for key in (False, True))
        return [_figure('loop p99 with cockpit and page over without, 1280×1024 at 100 Hz',
                        seen / bare, 1.1, f'without: {1e3 * bare:.2f} ms')]

    def _spent_s(self) -> list[float]:
        self._answers.written_s.clear()
        _rig.drive(self._client, self._answers, _PHASE_S)
        return list(self._answers.written_s)

    def recorded(self) -> Figure:
        """The share of frames that a recording holds, with over without."""
        bare = self._recorded_share('bare')
        with self._looked_at():
            seen = self._recorded_share('seen')
        ratio = seen / bare
        return Figure(_ISSUE, 'frames recorded with cockpit and page over without', ratio, 'ratio',
                      '>= 0.999', f'without: {bare:.4f} of those published', ratio >= 0.999)

    def _recorded_share(self, name: str) -> float:
        folder, published = self._folder / name, set[int]()
        hearing = self._client.node.create_subscription(
            CameraInfo, 'camera/camera_info',
            lambda message: published.add(_nanoseconds(message.header.stamp)), _EVERY)
        self._client.set('recorder', folder=str(folder))
        self._client.record(True)
        self._client.spin(_RECORDED_S)
        self._end_recording()
        self._client.node.destroy_subscription(hearing)
        with Recording(folder) as recording:
            held = {header_stamp_ns(message.data)
                    for message in recording.messages(['/camera/image_raw'])}
        return len(held) / len(held | {one for one in published if min(held) <= one <= max(held)})

    def _end_recording(self) -> None:
        """It writes all that waits before it answers, and that may take longer than is waited."""
        for _ in range(_TRIES):
            try:
                self._client.record(False)
            except RigError as error:
                if 'not recording' in str(error):
                    return
            else:
                return
        raise RigError('recorder: still writing')

    def shown(self) -> list[Figure]:
        """How many pictures of the preview are shown, and how old they are then."""
        published: list[int] = []
        hearing = self._client.node.create_subscription(
            CompressedImage, 'camera/preview',
            lambda message: published.append(_nanoseconds(message.header.stamp)), IMAGES_IN)
        with self._looked_at() as page:
            _browser.forget(page)
            self._client.spin(_LOOKED_S)
            stamps, ages = _browser.shown(page)
        self._client.node.destroy_subscription(hearing)
        there = [stamp for stamp in published if stamps[0] <= stamp <= stamps[-1]]
        share, p95 = len(set(stamps)) / len(there), float(np.percentile(ages, 95))
        return [
            Figure(_ISSUE, 'frames shown over preview frames', share, 'ratio', '>= 0.9',
                   f'{len(there) / _LOOKED_S:.1f} frames/s of preview', share >= 0.9),
            _figure('frame to pixels, p95 over the interval of the preview', p95 / _PREVIEW_S, 3.0,
                    f'p95 {1e3 * p95:.0f} ms')]

    def slowed(self) -> Figure:
        """Whether pictures grow old in a browser that is too slow for them."""
        with self._looked_at() as page:
            _browser.slow_down(page, _SLOWER)
            self._client.spin(_SETTLED_S)
            _browser.forget(page)
            self._client.spin(_SLOWED_S)
            _, ages = _browser.shown(page)
        third = len(ages) // 3
        first, last = float(ages[:third].mean()), float(ages[-third:].mean())
        return _figure('processor slowed six times: age in the last third over the first',
                       last / first, 1.2, f'first: {1e3 * first:.0f} ms, {len(ages)} pictures')

    def two_pages(self) -> Figure:
        """The cockpit's processor for two pages that are shown all, over that for one."""
        with self._cockpit() as (address, process), _socket(address) as first:
            one = self._share(process, [first])
            with _socket(address) as second:
                two = self._share(process, [first, second])
        return _figure("two pages over one: the cockpit's processor", two / one, 1.3,
                       f'one: {100 * one:.1f} % of a core')

    def _share(self, process: psutil.Process, pages: list[ClientConnection]) -> float:
        """Of a core, while each of the `pages` sees all that comes."""
        _look(pages, _SETTLED_S)
        before, begin = sum(process.cpu_times()[:2]), time.monotonic()
        _look(pages, _PHASE_S)
        return (sum(process.cpu_times()[:2]) - before) / (time.monotonic() - begin)

    def stopped(self, board: EmulatorProcess) -> Figure:
        """From STOP to zero by a page, over the same by a client of the service."""
        direct = self._client.node.create_client(SetBool, 'coil_driver/arm')
        direct.wait_for_service()
        took: dict[str, list[float]] = {'page': [], 'service': []}
        with self._cockpit() as (address, _), _socket(address) as page:
            for _ in range(_STOPS):
                for way, stop in (
                        ('page', lambda: page.send('{"verb":"stop","id":1}')),
                        ('service', lambda: direct.call_async(SetBool.Request(data=False)))):
                    self._let_flow(board)
                    moment = time.monotonic()
                    stop()
                    took[way].append(board.zero_after(moment, _PATIENCE_S) - moment)
                    self._client.spin(0.1)
                    _look([page], 0.1)  # one that reads nothing would be let go
        ours, theirs = float(np.median(took['page'])), float(np.median(took['service']))
        return _figure('STOP to zero over a direct call of the service', ours / theirs, 2.0,
                       f'the service: {1e3 * theirs:.1f} ms, median of {_STOPS}')

    def _let_flow(self, board: EmulatorProcess) -> None:
        """Armed, and currents there, whatever a busy machine cuts."""
        for _ in range(_TRIES):
            _rig.drive(self._client, self._answers, 0.5)
            if not board.zero:
                return
        raise RigError('coil_driver: no currents flow')


def _nanoseconds(stamp: Time) -> int:
    return stamp.sec * 1_000_000_000 + stamp.nanosec


@contextmanager
def _socket(address: str) -> Iterator[ClientConnection]:
    place = address.removeprefix('http://').rstrip('/')
    with connect(f'ws://{place}/socket', origin=f'http://{place}', compression=None,
                 close_timeout=0.2) as made:
        yield made


def _look(pages: list[ClientConnection], seconds: float) -> None:
    """Say `seen` to every picture, for so long."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        for page in pages:
            try:
                data = page.recv(timeout=0.005)
            except TimeoutError:
                continue
            if isinstance(data, bytes):
                stamp = int.from_bytes(data[:8], 'big')
                page.send(f'{{"verb":"seen","stamp":"{stamp}"}}')


def _figure(name: str, value: float, most: float, peer: str) -> Figure:
    return Figure(_ISSUE, name, value, 'ratio', f'<= {most:g}', peer, value <= most)
