"""What every kind of camera is: opened by settings, read frame by frame, closed.

A kind of one's own is a subclass of `CameraDriver` in any package, by the entry point
`microbot_ros.cameras`; docs/reference/cameras.md has a template.
"""

from __future__ import annotations

import functools
import importlib
import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from types import ModuleType
from typing import ClassVar

import numpy as np

from microbot_ros.common import settings, units
from microbot_ros.common.errors import InputError
from microbot_ros.common.plugins import installed
from microbot_ros.common.settings import setting

GROUP = 'microbot_ros.cameras'
INTERFACE_VERSION = 1
ENCODINGS = {
    'mono8': (np.uint8, 1), 'mono16': (np.uint16, 1),
    'bgr8': (np.uint8, 3), 'rgb8': (np.uint8, 3), 'bgra8': (np.uint8, 4), 'rgba8': (np.uint8, 4),
    'bayer_rggb8': (np.uint8, 1), 'bayer_bggr8': (np.uint8, 1),
    'bayer_gbrg8': (np.uint8, 1), 'bayer_grbg8': (np.uint8, 1),
}
"""How pixels are laid out, in the names of sensor_msgs → the type of a value, values per pixel."""


@dataclass(frozen=True)
class CameraSettings:
    """What is asked of a camera. What it can't do is refused: nothing is silently left undone."""

    source: str = setting(
        '', 'What to read: a device number (0) or path (/dev/video0), a video file, a folder of '
        'images or a glob; for other kinds of camera its name, see docs/reference/cameras.md. '
        'Nothing else is tried when it cannot be opened.', read_only=True)
    frame_rate_hz: float = setting(
        0.0, 'Pace of a file, or asked of a device; 0 takes what the file says, or the device’s '
        'own.', lower=0.0, upper=10_000.0, read_only=True)
    exposure_ms: float = setting(
        0.0, 'Time of exposure; 0: the device’s own. While running, the camera is opened anew.',
        lower=0.0, upper=1e6)
    gain: float = setting(
        0.0, 'Gain in the device’s unit (dB for most); 0: the device’s own. While running, the '
        'camera is opened anew.', lower=0.0, upper=1e6)
    width_px: int = setting(
        0, 'Width of the region that is read; 0: the device’s own.', lower=0, upper=100_000,
        read_only=True)
    height_px: int = setting(
        0, 'Height of the region that is read; 0: the device’s own.', lower=0, upper=100_000,
        read_only=True)
    offset_x_px: int = setting(
        0, 'First column of the region.', lower=0, upper=100_000, read_only=True)
    offset_y_px: int = setting(
        0, 'First row of the region.', lower=0, upper=100_000, read_only=True)
    pixel_format: str = setting(
        '', 'Pixel format by the device’s name for it (Mono8, YUYV); empty: the device’s own.',
        read_only=True)
    trigger: str = setting(
        '', 'What starts each exposure, by the device’s name for it (Line1); empty: the camera '
        'itself.', read_only=True)

    @property
    def asked(self) -> list[str]:
        """Names of what was asked for, beside the source."""
        return [name for name, default in settings.defaults(CameraSettings).items()
                if name != 'source' and getattr(self, name) != default]


class Clock(StrEnum):
    """Where the moments of exposure come from."""

    HOST = 'this computer’s, stamped in its driver'
    DEVICE = 'the camera’s own, brought to this computer’s'
    NONE = 'none: a frame is stamped as it arrives'


@dataclass(frozen=True)
class CameraFormat:
    """What an open camera gives: `height` and `width` [px] of its frames, their `encoding` (one
    of `ENCODINGS`), its own name for the `pixel_format`, and the `clock` of their stamps.

    `frame_rate` [Hz] is None where the device does not say. `least_delay` [s] passes at least
    between the beginning of an exposure and the arrival of its frame: the exposure, where that is
    known. `offset` is the first column and row of a region, `sensor` (height, width) [px] the
    whole, None where that is not known. After `patience` [s] without a frame it is taken for lost.
    """

    height: int
    width: int
    encoding: str
    pixel_format: str
    clock: Clock
    frame_rate: float | None = None
    least_delay: float = 0.0
    offset: tuple[int, int] = (0, 0)
    sensor: tuple[int, int] | None = None
    patience: float = 3.0


@dataclass(frozen=True)
class CameraFrame:
    """One picture: the device's `number` of it, and its `image`, valid until the next is read.

    `image` is (H, W), or (H, W, values per pixel), in the format's encoding. `arrived` [s] is
    when it did, on the monotonic clock. `exposed` [s] is when its exposure began, by the format's
    clock; NaN where that does not say.
    """

    number: int
    image: np.ndarray
    arrived: float
    exposed: float = math.nan


class EndOfFrames(Exception):  # noqa: N818 — no error: a film ends
    """A file has no more frames."""


class CameraDriver(ABC):
    """A source of frames, by `wanted` settings; `report` is given sentences about what is odd.

    `open`, `read` until it has been enough, `close`, and perhaps again. Numbers of frames go up
    by one with every exposure, so that those that never arrived are known. One thread calls it.
    """

    interface_version: ClassVar[int] = INTERFACE_VERSION
    wraps_after: ClassVar[int] = 0
    """How many numbers there are where they begin anew, as 65535 in GigE Vision; 0: they don't."""

    def __init__(self, wanted: CameraSettings, report: Callable[[str], None]) -> None:
        self.wanted = wanted
        self.report = report

    @abstractmethod
    def open(self) -> CameraFormat:
        """Open the device, set it up as wanted and let it run.

        InputError, with nothing left open, where that can't be: no such device, a setting that
        it does not have or take.
        """

    @abstractmethod
    def read(self, timeout: float) -> CameraFrame | None:
        """The next frame; None where none came within `timeout` [s].

        Frames that arrived damaged are left out; their number is missing then. InputError where
        the device is lost; EndOfFrames at the end of a film.
        """

    @property
    def dropped(self) -> int:
        """Frames since `open` that this computer is known to have had no room for, where their
        numbers need not tell."""
        return 0

    @abstractmethod
    def close(self) -> None:
        """Give back the device; harmless where it is closed, or gone."""

    def refuse(self, *names: str, why: str = '') -> None:
        """InputError where a setting of these `names` is asked for, which this kind hasn't;
        `why` says what to do instead."""
        for name in names:
            if name in self.wanted.asked:
                raise InputError(self.wanted.source, f'has no {name} to set'
                                 + (why and f'; {why}'))

    def within(self, name: str, lowest: float, highest: float) -> float:
        """The setting of this `name` if it is from `lowest` to `highest`, else InputError."""
        value: float = getattr(self.wanted, name)
        if not lowest <= value <= highest:
            unit = units.symbol(name)
            raise InputError(self.wanted.source, f'{name} must be {lowest:g} to {highest:g} {unit}'
                             .rstrip() + f' here; received {value:g}')
        return value

    def one_of(self, name: str, known: list[str]) -> str:
        """The setting of this `name` if it is among the `known`, else InputError."""
        value: str = getattr(self.wanted, name)
        if value not in known:
            raise InputError(self.wanted.source, f'{name} must be one of {", ".join(known)}; '
                             f'received {value!r}')
        return value


@functools.cache
def camera_class(kind: str) -> type[CameraDriver]:
    """The class registered for a `kind` of camera in the entry-point group `microbot_ros.cameras`.

    InputError for one that is not there, does not load or is written for another contract: there
    is no falling back to another.
    """
    found = installed(GROUP, 'camera', kind)
    if not (isinstance(found, type) and issubclass(found, CameraDriver)):
        raise InputError('camera', f"the kind '{kind}' is no CameraDriver")
    if found.interface_version != INTERFACE_VERSION:
        raise InputError('camera', f"the kind '{kind}' is written for interface version "
                         f'{found.interface_version}, expected {INTERFACE_VERSION}')
    return found


def kind_of(kind: str, source: str) -> str:
    """The `kind` of camera; '' stands for v4l2 where `source` is a device, else for a file."""
    if kind:
        return kind
    return 'v4l2' if source.isdigit() or source.startswith('/dev/') else 'file'


def optional(package: str, kind: str) -> ModuleType:
    """The module of an optional `package`, which a `kind` of camera needs, or InputError."""
    try:
        return importlib.import_module(package)
    except ImportError as error:
        raise InputError('camera', f"the kind '{kind}' needs {package}: pip install "
                         f"'microbot_ros[cameras]' ({error})") from None
