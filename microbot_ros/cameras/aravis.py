"""Camera kind `aravis`: GigE Vision and USB3 Vision cameras, and the simulated Aravis camera."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

from microbot_ros.cameras.camera import CameraDriver, CameraFormat, CameraFrame, Clock
from microbot_ros.cameras.pixels import GENICAM, encoding_of, picture
from microbot_ros.common.errors import InputError

_BUFFERS = 32  # choice: 0.3 s of frames at 100 frames/s


class AravisCamera(CameraDriver):
    """GenICam camera, by the name that `arv-tool` lists, its IP address or its serial number.

    `Fake_1` is the camera that needs no hardware.
    """

    wraps_after = 65535

    def open(self) -> CameraFormat:
        self._device: Any = None
        self._buffer: Any = None
        self._aravis, self._error = _bindings()
        if not self.wanted.source:
            raise InputError('camera', 'expected the name, IP address or serial number of a '
                                       'camera as source; arv-tool lists the cameras found')
        if self.wanted.source.startswith('Fake'):
            self._aravis.enable_interface('Fake')
        try:
            with self._told():
                self._device = self._aravis.Camera.new(self.wanted.source)
                self._set_up()
                found = self._format()
                self._device.set_acquisition_mode(self._aravis.AcquisitionMode.CONTINUOUS)
                self._stream = self._device.create_stream(None, None)
                for _ in range(_BUFFERS):
                    self._stream.push_buffer(
                        self._aravis.Buffer.new_allocate(self._device.get_payload()))
                self._device.start_acquisition()
                return found
        except InputError:
            self.close()
            raise

    def read(self, timeout: float) -> CameraFrame | None:
        if self._buffer is not None:
            self._stream.push_buffer(self._buffer)
        self._buffer = buffer = self._stream.timeout_pop_buffer(max(1, round(timeout * 1e6)))
        arrived = time.monotonic()
        if buffer is None or buffer.get_status() != self._aravis.BufferStatus.SUCCESS:
            return None
        image = picture(buffer.get_data(), self._encoding, buffer.get_image_height(),
                        buffer.get_image_width())
        nanoseconds = buffer.get_timestamp()
        return CameraFrame(buffer.get_frame_id(), image, arrived,
                           nanoseconds * 1e-9 if nanoseconds else math.nan)

    @property
    def dropped(self) -> int:
        _, _, underruns = self._stream.get_statistics()
        return int(underruns)

    def close(self) -> None:
        if self._device is None:
            return
        with suppress(self._error):
            self._device.stop_acquisition()
        # Aravis closes the device when its last reference goes.
        self._device = self._stream = self._buffer = None

    @contextmanager
    def _told(self) -> Iterator[None]:
        try:
            yield
        except self._error as error:
            raise InputError(self.wanted.source, f'Aravis says: {error.message}') from None

    def _set_up(self) -> None:
        device, wanted = self._device, self.wanted
        if wanted.pixel_format:
            device.set_pixel_format_from_string(self.one_of(
                'pixel_format', list(device.dup_available_pixel_formats_as_strings())))
        self._region()
        if wanted.exposure_ms:
            self._has('exposure_ms', device.is_exposure_time_available())
            lowest, highest = device.get_exposure_time_bounds()
            device.set_exposure_time(
                1e3 * self.within('exposure_ms', lowest / 1e3, highest / 1e3))
        if wanted.gain:
            self._has('gain', device.is_gain_available())
            device.set_gain(self.within('gain', *device.get_gain_bounds()))
        if wanted.frame_rate_hz:
            self._has('frame_rate_hz', device.is_frame_rate_available())
            device.set_frame_rate(self.within('frame_rate_hz', *device.get_frame_rate_bounds()))
        if wanted.trigger:
            device.set_trigger(self.one_of('trigger', [
                name for name in device.dup_available_trigger_sources() if name != 'Software']))

    def _has(self, name: str, available: bool) -> None:
        if not available:
            self.refuse(name)

    def _region(self) -> None:
        device, wanted = self._device, self.wanted
        asked = {'width_px', 'height_px', 'offset_x_px', 'offset_y_px'} & set(wanted.asked)
        if not asked:
            return
        now = device.get_region()
        size = []
        for name, own, bounds in (('width_px', now.width, device.get_width_bounds()),
                                  ('height_px', now.height, device.get_height_bounds())):
            size.append(int(self.within(name, *bounds)) if name in asked else own)
        sensor = device.get_sensor_size()
        self.within('offset_x_px', 0, sensor.width - size[0])
        self.within('offset_y_px', 0, sensor.height - size[1])
        device.set_region(wanted.offset_x_px, wanted.offset_y_px, *size)

    def _format(self) -> CameraFormat:
        device = self._device
        pixel_format = device.get_pixel_format_as_string()
        self._encoding = encoding_of(pixel_format, GENICAM, self.wanted.source)
        region, sensor = device.get_region(), device.get_sensor_size()
        exposure = 0.0
        if device.is_exposure_time_available() and (
                not device.is_exposure_auto_available()
                or device.get_exposure_time_auto() == self._aravis.Auto.OFF):
            exposure = device.get_exposure_time() * 1e-6
        rate = device.get_frame_rate() if device.is_frame_rate_available() else None
        return CameraFormat(
            region.height, region.width, self._encoding, pixel_format, Clock.DEVICE,
            frame_rate=rate, least_delay=exposure, offset=(region.x, region.y),
            sensor=(sensor.height, sensor.width),
            patience=math.inf if self.wanted.trigger else 3.0 + 2 * exposure)


def _bindings() -> tuple[Any, Any]:
    """Return the Aravis bindings and their error type; InputError if they are not installed."""
    try:
        import gi

        gi.require_version('Aravis', '0.8')
        from gi.repository import Aravis, GLib
    except (ImportError, ValueError) as error:
        raise InputError('camera', "the kind 'aravis' needs Aravis for Python: apt install "
                         'gir1.2-aravis-0.8 python3-gi, and in a virtual environment pip install '
                         f'PyGObject ({error})') from None
    return Aravis, GLib.Error
