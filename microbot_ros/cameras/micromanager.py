"""Camera kind `micromanager`: any camera with a Micro-Manager adapter."""

from __future__ import annotations

import math
import os
import time
from contextlib import suppress
from typing import Any

from microbot_ros.cameras.camera import (
    CameraDriver,
    CameraFormat,
    CameraFrame,
    Clock,
    optional,
)
from microbot_ros.cameras.pixels import encoding_of, picture
from microbot_ros.common.errors import InputError

_ENCODINGS = {'GRAY8': 'mono8', 'GRAY16': 'mono16', 'RGB32': 'bgra8'}
_BUFFER_MB = 256  # choice: 120 frames of 2048×1088, 8 bit
_FOR_EVER = 2**31 - 1
"""Frames of a sequence, which is restarted at its end.

A sequence without an end reallocates its buffer on overflow while a frame is taken from it, which
crashes the process (MMCore 12).
"""
_POLL_S = 0.0005
"""Choice: polling interval; MMCore offers nothing to wait on."""


class MicroManagerCamera(CameraDriver):
    """Camera of a Micro-Manager configuration (.cfg file), or `demo`."""

    def open(self) -> CameraFormat:
        self._core: Any = None
        self._mmcore = optional('pymmcore', 'micromanager')
        self.refuse('frame_rate_hz', 'trigger', why='set it in the configuration file')
        core = self._core = self._mmcore.CMMCore()
        try:
            core.setDeviceAdapterSearchPaths(_adapters())
            self._load()
            self._set_up()
            core.setCircularBufferMemoryFootprint(_BUFFER_MB)
            core.startSequenceAcquisition(_FOR_EVER, 0.0, True)
            return self._first_format()
        except (RuntimeError, OSError) as error:
            self.close()
            raise InputError(self.wanted.source, f'Micro-Manager says: {_line(error)}') from None
        except InputError:
            self.close()
            raise

    def read(self, timeout: float) -> CameraFrame | None:
        core, deadline = self._core, time.monotonic() + timeout
        try:
            while not core.getRemainingImageCount():
                if not core.isSequenceRunning():
                    why = (': its buffer overflowed; this computer is too slow for the frame rate'
                           if core.isBufferOverflowed() else '')
                    raise InputError(self.wanted.source, f'stopped delivering frames{why}')
                if time.monotonic() >= deadline:
                    return None
                time.sleep(_POLL_S)
            return self._next()
        except (RuntimeError, OSError) as error:
            raise InputError(self.wanted.source, f'Micro-Manager says: {_line(error)}') from None

    def close(self) -> None:
        if self._core is None:
            return
        for step in (self._core.stopSequenceAcquisition, self._core.unloadAllDevices):
            with suppress(RuntimeError, OSError):
                step()
        self._core = None

    def _load(self) -> None:
        core, source = self._core, self.wanted.source
        if source == 'demo':
            core.loadDevice('Camera', 'DemoCamera', 'DCam')
            core.initializeDevice('Camera')
            core.setCameraDevice('Camera')
        elif source.endswith('.cfg'):
            core.loadSystemConfiguration(source)
        else:
            raise InputError(source or 'camera', 'expected a configuration file of Micro-Manager '
                             '(.cfg) as source, or demo')
        if not core.getCameraDevice():
            raise InputError(source, 'the configuration file names no camera (Core, Camera)')

    def _set_up(self) -> None:
        core, wanted = self._core, self.wanted
        self._sensor = core.getImageHeight(), core.getImageWidth()
        if wanted.pixel_format:
            self._property('pixel_format', 'PixelType', wanted.pixel_format)
        if wanted.gain:
            self._property('gain', 'Gain', f'{wanted.gain:g}')
        if wanted.exposure_ms:
            self._expose(wanted.exposure_ms)
        if {'width_px', 'height_px', 'offset_x_px', 'offset_y_px'} & set(wanted.asked):
            height, width = self._sensor
            self.within('width_px', 0, width - self.within('offset_x_px', 0, width - 1))
            self.within('height_px', 0, height - self.within('offset_y_px', 0, height - 1))
            core.setROI(wanted.offset_x_px, wanted.offset_y_px,
                        wanted.width_px or width - wanted.offset_x_px,
                        wanted.height_px or height - wanted.offset_y_px)

    def _expose(self, exposure_ms: float) -> None:
        """Set and read back the exposure time: some adapters clip it silently."""
        core, camera = self._core, self._core.getCameraDevice()
        if core.hasProperty(camera, 'Exposure') and core.hasPropertyLimits(camera, 'Exposure'):
            self.within('exposure_ms', core.getPropertyLowerLimit(camera, 'Exposure'),
                        core.getPropertyUpperLimit(camera, 'Exposure'))
        core.setExposure(exposure_ms)
        if abs(core.getExposure() - exposure_ms) > 0.05 * exposure_ms:
            raise InputError(self.wanted.source, 'exposure_ms was set to '
                                                 f'{core.getExposure():g} ms; requested '
                                                 f'{exposure_ms:g} ms')

    def _property(self, name: str, its: str, value: str) -> None:
        """Set the camera's property `its` from the setting `name`."""
        core, camera = self._core, self._core.getCameraDevice()
        if not core.hasProperty(camera, its):
            self.refuse(name)
        if allowed := list(core.getAllowedPropertyValues(camera, its)):
            self.one_of(name, allowed)
        elif core.hasPropertyLimits(camera, its):
            self.within(name, core.getPropertyLowerLimit(camera, its),
                        core.getPropertyUpperLimit(camera, its))
        core.setProperty(camera, its, value)

    def _first_format(self) -> CameraFormat:
        """Return the format; it is known only with a frame, so the first is taken and dropped."""
        exposure = self._core.getExposure() * 1e-3
        deadline = time.monotonic() + 3.0 + 2 * exposure
        while not self._core.getRemainingImageCount():
            if time.monotonic() > deadline:
                raise InputError(self.wanted.source, 'expected a camera that delivers frames; '
                                                     'it delivers none')
            time.sleep(_POLL_S)
        told = self._mmcore.Metadata()
        self._core.getLastImageMD(told)
        pixel_type = _tag(told, 'PixelType')
        self._encoding = encoding_of(pixel_type, _ENCODINGS, self.wanted.source)
        self._height, self._width = self._core.getImageHeight(), self._core.getImageWidth()
        x, y, _, _ = self._core.getROI()
        return CameraFormat(
            self._height, self._width, self._encoding, pixel_type, Clock.DEVICE,
            least_delay=exposure, offset=(x, y), sensor=self._sensor,
            patience=3.0 + 2 * exposure)

    def _next(self) -> CameraFrame:
        told = self._mmcore.Metadata()
        pixels = self._core.popNextImageMD(told)
        arrived = time.monotonic()
        height, width = pixels.shape
        image = picture(pixels, self._encoding, height, width) if (
            self._encoding == 'bgra8') else pixels
        elapsed = _tag(told, 'ElapsedTime-ms')
        return CameraFrame(int(_tag(told, 'ImageNumber')), image, arrived,
                           float(elapsed) * 1e-3 if elapsed else math.nan)


def _adapters() -> list[str]:
    """Return the adapter folders of MICROMANAGER_PATH, pymmcore-plus and the demo camera."""
    folders = [path] if (path := os.environ.get('MICROMANAGER_PATH')) else []
    with suppress(ImportError):
        from pymmcore_plus import find_micromanager

        folders += map(str, find_micromanager(return_first=False))
    with suppress(ImportError):
        import mm_test_adapters

        folders.append(str(mm_test_adapters.device_adapter_path()))
    return folders


def _tag(told: Any, name: str) -> str:
    return str(told.GetSingleTag(name).GetValue()) if told.HasTag(name) else ''


def _line(error: Exception) -> str:
    return str(error).splitlines()[0]
