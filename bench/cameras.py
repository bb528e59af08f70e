"""Cameras at 640×480 as fast as they give: is every lost frame counted, what does it cost?

Each kind is made to lose frames, by stalling its reader or damaging some, and by a book other
than its frame numbers it is known how many. The processor's share has the emulator in it.
"""

from __future__ import annotations

import importlib.util
import os
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from builtin_interfaces.msg import Time

from bench._aravis import has_aravis
from bench.figure import Figure
from microbot_ros.cameras.camera import CameraSettings, EndOfFrames, camera_class
from microbot_ros.cameras.stream import FrameStream
from microbot_ros.nodes.base import messages

_SIZE = {'width_px': 640, 'height_px': 480}
_SECONDS = 3.0
_IMAGES, _UNREADABLE = 600, (7, 100, 101, 500)
_EXPOSURES = 2000
_DAMAGED = 25


def figures() -> Iterator[Figure]:
    """Of every kind that is here."""
    with tempfile.TemporaryDirectory(prefix='bench-cameras-') as name:
        for kind, there, measure in (
            ('file', True, _file),
            ('pylon', _installed('pypylon'), _pylon),
            ('micromanager', _installed('pymmcore', 'mm_test_adapters'), _micromanager),
            ('aravis', has_aravis(), _aravis),
        ):
            yield from measure(Path(name)) if there else _left_out(kind)


def _installed(*packages: str) -> bool:
    return all(importlib.util.find_spec(package) for package in packages)


def _left_out(kind: str) -> list[Figure]:
    print(f'bench: cameras: {kind} is not installed, left out', file=sys.stderr)
    return []


class _Reader:
    """Reads a camera and makes messages of its frames, as its node does."""

    def __init__(self, kind: str, source: str, **wanted: Any) -> None:
        settings = CameraSettings(source, **wanted)
        self.stream = FrameStream(camera_class(kind)(settings, lambda _: None))
        self.driver: Any = self.stream._camera
        self.count = 0
        self.delays: list[float] = []

    def read(self, timeout: float = 0.5) -> bool:
        found = self.stream.read(timeout)
        if found is None:
            return False
        frame, exposed = found
        messages.image(frame.image, Time(), encoding=self.stream.format.encoding)
        self.delays.append(time.monotonic() - exposed)
        self.count += 1
        return True

    def read_for(self, seconds: float) -> tuple[float, float]:
        """Frames per second and the share of a core."""
        count, begin, spent = self.count, time.monotonic(), time.process_time()
        while time.monotonic() < begin + seconds:
            self.read()
        took = time.monotonic() - begin
        return (self.count - count) / took, (time.process_time() - spent) / took


def _report(kind: str, reader: _Reader, rate: float, share: float, exposed: int, book: str,
            ) -> list[Figure]:
    """`exposed` frames there were by a `book`, from the first to the last that came."""
    reader.stream.close()
    lost = reader.stream.lost
    uncounted = abs(exposed - reader.count - lost)
    late_ms = float(np.median(reader.delays)) * 1e3
    cores = share / rate * 100
    return [
        Figure(19, f'{kind}, {rate:.0f} frames/s: {lost} of {exposed} frames lost, not counted',
               uncounted, 'frames', '0', book, uncounted == 0 and lost > 0),
        Figure(19, f'{kind}: core per 100 frames/s, and {late_ms:.1f} ms from exposure to message',
               cores, 'cores', '≤ 1', 'emulator included', cores <= 1)]


def _file(folder: Path) -> list[Figure]:
    rng = np.random.default_rng(0)
    picture = rng.normal(200, 3, (480, 640)).astype(np.uint8)
    for k in range(_IMAGES):
        cv2.imwrite(str(folder / f'{k:04d}.png'), picture)
    for k in _UNREADABLE:
        (folder / f'{k:04d}.png').write_bytes(b'')
    reader = _Reader('file', str(folder), frame_rate_hz=10_000.0)
    begin, spent = time.monotonic(), time.process_time()
    try:
        while True:
            reader.read()
    except EndOfFrames:
        took = time.monotonic() - begin
    return _report('file', reader, reader.count / took, (time.process_time() - spent) / took,
                   _IMAGES, 'images in the folder')


def _pylon(_: Path) -> list[Figure]:
    os.environ['PYLON_CAMEMU'] = '1'
    reader = _Reader('pylon', '0815-0000', **_SIZE, exposure_ms=0.1, frame_rate_hz=5000.0)
    rate, share = reader.read_for(_SECONDS)
    reader.driver._device.ForceFailedBufferCount.Value = _DAMAGED
    reader.driver._device.ForceFailedBuffer.Execute()
    time.sleep(0.5)
    reader.read_for(_SECONDS)
    return _report('pylon', reader, rate, share, reader.count + _DAMAGED,
                   'frames that the emulator was told to damage')


def _micromanager(folder: Path) -> list[Figure]:
    config = folder / 'demo.cfg'
    config.write_text('\n'.join([
        'Device,Camera,DemoCamera,DCam', 'Property,Core,Initialize,1',
        'Property,Camera,OnCameraCCDXSize,640', 'Property,Camera,OnCameraCCDYSize,480',
        'Property,Camera,FastImage,1', 'Property,Core,Camera,Camera']) + '\n')
    reader = _Reader('micromanager', str(config), exposure_ms=0.5)
    core = reader.driver._core
    core.stopSequenceAcquisition()
    core.startSequenceAcquisition(_EXPOSURES, 0.0, False)
    rate, share = reader.read_for(0.8)
    # Until its buffer is full, and then some.
    while core.isSequenceRunning() and core.getBufferFreeCapacity() > 1:
        time.sleep(0.05)
    time.sleep(0.2)
    while core.isSequenceRunning() or core.getRemainingImageCount():
        reader.read()
    return _report('micromanager', reader, rate, share, _EXPOSURES, 'exposures that were ordered')


def _aravis(_: Path) -> list[Figure]:
    reader = _Reader('aravis', 'Fake_1', **_SIZE, exposure_ms=0.5, frame_rate_hz=1000.0)
    rate, share = reader.read_for(_SECONDS)
    time.sleep(0.5)
    reader.read_for(_SECONDS)
    return _report('aravis', reader, rate, share, _book(reader.driver._stream),
                   "Aravis' book of its buffers")


def _book(stream: Any) -> int:
    """Frames that came for us, with or without room, and are no longer on their way to us."""
    def look() -> tuple[tuple[int, ...], int]:
        return tuple(stream.get_statistics()), stream.get_n_buffers()[1]

    seen, before = look(), None
    while seen != before:
        before, seen = seen, look()
    return sum(seen[0]) - seen[1]
