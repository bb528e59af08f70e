"""Tests that every camera kind must pass; call it in a test of your own package.

    from microbot_ros.cameras.testkit import exercise

    def test_my_camera_keeps_the_contract():
        exercise(MyCamera, 'name-of-a-connected-camera')

The camera must be connected.
"""

from __future__ import annotations

import dataclasses
import math
import time
from typing import Any

from microbot_ros.cameras.camera import (
    ENCODINGS,
    CameraDriver,
    CameraFormat,
    CameraFrame,
    CameraSettings,
    Clock,
)
from microbot_ros.cameras.stream import FrameStream
from microbot_ros.common.errors import InputError

_IMPOSSIBLE: dict[str, Any] = {
    'source': 'no such camera', 'pixel_format': 'no such format', 'trigger': 'no such line',
    'width_px': 99_999, 'height_px': 99_999, 'offset_x_px': 99_999, 'offset_y_px': 99_999,
    'gain': 999_999.0}
"""Settings that no camera can fulfil. Choice: sizes and a gain far above any sensor's."""
_FRAMES = 10
"""Choice: frames read per opening, enough to see whether numbers rise."""
_PATIENCE_S = 20.0
"""Choice: time [s] that these frames may take, far above any camera's interval."""
_SLACK_S = 0.5
"""Choice: excess [s] of a read over its timeout, which a loaded machine needs."""


def exercise(kind: type[CameraDriver], source: str) -> None:
    """Test a camera `kind` on the connected camera `source`; AssertionError names what is wrong.

    It is opened twice. Frames must match the format and arrive in time, their numbers must rise,
    and no exposure may lie in the future. Impossible settings must be refused in one line and
    leave the camera free.

    Parameters
    ----------
    kind : type[CameraDriver]
        Class of the driver.
    source : str
        Name of the camera.
    """
    wanted = CameraSettings(source)
    for _ in range(2):
        _frames(kind, wanted)
    for name, value in _IMPOSSIBLE.items():
        _refuses(kind, dataclasses.replace(wanted, **{name: value}), name)
    _frames(kind, wanted)


def _frames(kind: type[CameraDriver], wanted: CameraSettings) -> None:
    driver = kind(wanted, lambda _: None)
    stream = FrameStream(driver)
    _check_format(stream.format)
    numbers: list[int] = []
    moments: list[float] = []
    deadline = time.monotonic() + _PATIENCE_S
    while len(numbers) < _FRAMES:
        now = time.monotonic()
        assert now < deadline, f'delivered {len(numbers)} frames in {_PATIENCE_S:g} s'
        found = stream.read(0.05)
        took = time.monotonic() - now
        assert took < 0.05 + _SLACK_S, f'read took {took:.2f} s; expected at most 0.05 s'
        if found:
            _check_frame(found[0], stream.format)
            numbers.append(found[0].number)
            moments.append(found[1])
    driver.close()
    driver.close()
    assert driver.wraps_after or numbers == sorted(set(numbers)), (
        f'frame numbers must ascend; received {numbers}')
    assert moments == sorted(moments), 'exposure times must ascend'


def _check_format(form: CameraFormat) -> None:
    assert form.encoding in ENCODINGS, f'encoding {form.encoding} is none of {list(ENCODINGS)}'
    assert form.height > 0 < form.width, f'a size of {form.width}×{form.height}'
    assert 0 <= form.least_delay < math.inf, f'a least_delay of {form.least_delay} s'
    assert form.frame_rate is None or form.frame_rate > 0, f'{form.frame_rate} frames/s'
    assert form.patience > 0, f'a patience of {form.patience} s'


def _check_frame(frame: CameraFrame, form: CameraFormat) -> None:
    now = time.monotonic()
    assert now - _PATIENCE_S < frame.arrived <= now, (
        "'arrived' must be a time of the monotonic clock")
    if form.clock is Clock.HOST:
        assert frame.exposed <= frame.arrived, 'exposed after arrival'


def _refuses(kind: type[CameraDriver], wanted: CameraSettings, name: str) -> None:
    driver = kind(wanted, lambda _: None)
    said = ''
    try:
        driver.open()
    except InputError as error:
        said = str(error)
    finally:
        driver.close()
    assert said, f'{name} {getattr(wanted, name)!r} must be refused with an InputError'
    assert '\n' not in said, f'the error must be one line; received {said}'
