"""Contract of all camera kinds: opened with settings, read frame by frame, closed.

Another package adds a kind as a subclass of `CameraDriver` under the entry point
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
from microbot_ros.common.extras import installed
from microbot_ros.common.settings import setting

GROUP = 'microbot_ros.cameras'
INTERFACE_VERSION = 1  # raised when a driver written for the contract would no longer work
ENCODINGS = {
    'mono8': (np.uint8, 1), 'mono16': (np.uint16, 1),
    'bgr8': (np.uint8, 3), 'rgb8': (np.uint8, 3), 'bgra8': (np.uint8, 4), 'rgba8': (np.uint8, 4),
    'bayer_rggb8': (np.uint8, 1), 'bayer_bggr8': (np.uint8, 1),
    'bayer_gbrg8': (np.uint8, 1), 'bayer_grbg8': (np.uint8, 1),
}
"""Pixel layout, as named in sensor_msgs → type of a value, values per pixel."""


@dataclass(frozen=True)
class CameraSettings:
    """Settings requested from a camera; one that it cannot fulfil is refused, never ignored."""

    source: str = setting(
        '', 'Source of the frames: a device number (0) or path (/dev/video0), a video '
            'file, a folder of images or a glob; for other kinds of camera its name, '
            'see docs/reference/cameras.md. No other source is tried if it cannot be '
            'opened.', read_only=True)
    frame_rate_hz: float = setting(
        0.0, 'Frame rate: the pace of a file, or the rate requested '
             "of a device; 0 takes the file's, or the device's "
             'default.', lower=0.0, upper=10_000.0, read_only=True)
    exposure_ms: float = setting(
        0.0, "Exposure time; 0: the device's default. A change while running reopens the camera.",
        lower=0.0, upper=1e6)
    gain: float = setting(
        0.0, "Gain in the unit of the device (dB for most); 0: the device's default. A change "
             'while running reopens the camera.', lower=0.0, upper=1e6)
    width_px: int = setting(
        0, "Width of the region that is read; 0: the device's default.", lower=0, upper=100_000,
        read_only=True)
    height_px: int = setting(
        0, "Height of the region that is read; 0: the device's default.", lower=0, upper=100_000,
        read_only=True)
    offset_x_px: int = setting(
        0, 'First column of the region.', lower=0, upper=100_000, read_only=True)
    offset_y_px: int = setting(
        0, 'First row of the region.', lower=0, upper=100_000, read_only=True)
    pixel_format: str = setting(
        '', "Pixel format, by the device's name for it (Mono8, YUYV); empty: the device's "
            'default.',
        read_only=True)
    trigger: str = setting(
        '', "Trigger that starts each exposure, by the device's name for it (Line1); empty: the "
            'camera itself.', read_only=True)

    @property
    def asked(self) -> list[str]:
        """Names of the settings that differ from their defaults, without `source`."""
        return [name for name, default in settings.defaults(CameraSettings).items()
                if name != 'source' and getattr(self, name) != default]


class Clock(StrEnum):
    """Origin of the exposure times."""

    HOST = "clock of this computer, stamped in the camera's driver"
    DEVICE = 'clock of the camera, converted to that of this computer'
    NONE = 'no clock: a frame is stamped on arrival'


@dataclass(frozen=True)
class CameraFormat:
    """Format of the frames of an open camera.

    Attributes
    ----------
    height, width : int [px]
    encoding : str
        One of `ENCODINGS`.
    pixel_format : str
        The device's own name of the format.
    clock : Clock
    frame_rate : float or None
        Rate [Hz], None if the device does not report it.
    least_delay : float
        Shortest time [s] from the start of an exposure to the arrival of its frame: the exposure
        time, if it is known.
    offset : (int, int)
        First column and row of the region [px].
    sensor : (int, int) or None
        Height and width of the whole sensor [px], None if unknown.
    patience : float
        Time [s] without a frame after which the camera counts as lost.
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
    """One picture, valid until the next is read.

    Attributes
    ----------
    number : int
        Number that the device gives the frame.
    image : (H, W) or (H, W, values per pixel) array
        In the encoding of the format.
    arrived : float
        Time of arrival on the monotonic clock [s].
    exposed : float
        Start of the exposure on the clock of the format [s], NaN if it has none.
    """

    number: int
    image: np.ndarray
    arrived: float
    exposed: float = math.nan


class EndOfFrames(Exception):  # noqa: N818 — the normal end of a file, not an error
    """A file has no more frames."""


class CameraDriver(ABC):
    """Base of all camera kinds; one thread opens, reads and closes it, possibly repeatedly.

    Frame numbers increase by one with every exposure, so that missing frames can be counted.

    Parameters
    ----------
    wanted : CameraSettings
        Requested settings.
    report : callable
        Takes a sentence about anything unusual.
    """

    interface_version: ClassVar[int] = INTERFACE_VERSION
    wraps_after: ClassVar[int] = 0
    """Number of frame numbers before they start again (65535 for GigE Vision).

    0 if they do not.
    """

    def __init__(self, wanted: CameraSettings, report: Callable[[str], None]) -> None:
        self.wanted = wanted
        self.report = report

    @abstractmethod
    def open(self) -> CameraFormat:
        """Open the device, apply the settings and start it.

        Raises InputError, with nothing left open, if there is no such device or it refuses a
        setting.

        Returns
        -------
        CameraFormat
            Format of the frames.
        """

    @abstractmethod
    def read(self, timeout: float) -> CameraFrame | None:
        """Return the next frame, or None if none arrives within `timeout` [s].

        Damaged frames are skipped, so that their numbers are missing. Raises InputError if the
        device is lost and EndOfFrames at the end of a file.

        Parameters
        ----------
        timeout : float
            Longest time to wait [s].

        Returns
        -------
        CameraFrame or None
            The frame, or None.
        """

    @property
    def dropped(self) -> int:
        """Frames since `open` that this computer dropped for lack of buffers, if counted."""
        return 0

    @abstractmethod
    def close(self) -> None:
        """Release the device. Has no effect if it is closed or disconnected."""

    def refuse(self, *names: str, why: str = '') -> None:
        """Raise InputError if a setting in `names`, which this kind does not have, is requested.

        `why` tells the user what to do instead.

        Parameters
        ----------
        why : str
            Advice for the user.
        *names : str
            Names of the settings.
        """
        for name in names:
            if name in self.wanted.asked:
                raise InputError(self.wanted.source, f'{name} cannot be set'
                                 + (why and f'; {why}'))

    def within(self, name: str, lowest: float, highest: float) -> float:
        """Return the setting `name` if it is from `lowest` to `highest`, else raise InputError.

        Parameters
        ----------
        name : str
            Name of the setting.
        lowest : float
            Smallest value.
        highest : float
            Largest value.

        Returns
        -------
        float
            The value.
        """
        value: float = getattr(self.wanted, name)
        if not lowest <= value <= highest:
            unit = units.symbol(name)
            raise InputError(self.wanted.source, f'{name} must be {lowest:g} to {highest:g} {unit}'
                             .rstrip() + f' here; received {value:g}')
        return value

    def one_of(self, name: str, known: list[str]) -> str:
        """Return the setting `name` if it is among the `known` ones, else raise InputError.

        Parameters
        ----------
        name : str
            Name of the setting.
        known : list of str
            Allowed values.

        Returns
        -------
        str
            The value.
        """
        value: str = getattr(self.wanted, name)
        if value not in known:
            raise InputError(self.wanted.source, f'{name} must be one of {", ".join(known)}; '
                             f'received {value!r}')
        return value


@functools.cache
def camera_class(kind: str) -> type[CameraDriver]:
    """Return the class registered for a `kind` in the entry-point group `microbot_ros.cameras`.

    Raises InputError if it is missing, cannot be loaded or has another interface version; no other
    kind is tried.

    Parameters
    ----------
    kind : str
        Kind of camera.

    Returns
    -------
    type[CameraDriver]
        The class.
    """
    found = installed(GROUP, 'camera', kind)
    if not (isinstance(found, type) and issubclass(found, CameraDriver)):
        raise InputError('camera', f"the kind '{kind}' does not derive from CameraDriver")
    if found.interface_version != INTERFACE_VERSION:
        raise InputError('camera', f"the kind '{kind}' has interface version "
                                   f'{found.interface_version}; expected {INTERFACE_VERSION}')
    return found


def kind_of(kind: str, source: str) -> str:
    """Return `kind`; if it is '', v4l2 for a `source` that is a device, else file.

    Parameters
    ----------
    kind : str
        Kind of camera, or ''.
    source : str
        Name of the device or file.

    Returns
    -------
    str
        Kind of camera.
    """
    if kind:
        return kind
    return 'v4l2' if source.isdigit() or source.startswith('/dev/') else 'file'


def optional(package: str, kind: str) -> ModuleType:
    """Import the optional `package` that a camera `kind` needs, or raise InputError.

    Parameters
    ----------
    package : str
        Name of the package.
    kind : str
        Kind of camera.

    Returns
    -------
    ModuleType
        The package.
    """
    try:
        return importlib.import_module(package)
    except ImportError as error:
        raise InputError('camera', f"the kind '{kind}' needs {package}: pip install "
                         f"'microbot_ros[cameras]' ({error})") from None
