"""Camera kind `v4l2`: a camera of this computer, by device number or path."""

from __future__ import annotations

import math
import time

import numpy as np

from microbot_ros.cameras import v4l2_device
from microbot_ros.cameras.camera import CameraDriver, CameraFormat, CameraFrame, Clock
from microbot_ros.cameras.pixels import encoding_of, picture
from microbot_ros.cameras.v4l2_device import Captured, PixelLayout, VideoDevice
from microbot_ros.common.errors import InputError

_LUMA = {'YUYV': (2, 0), 'YVYU': (2, 0), 'UYVY': (2, 1), 'VYUY': (2, 1)}
"""Packed colour formats → step and first index of the brightness bytes."""
_PLANAR = ('NV12', 'NV21', 'YU12', 'YV12')
"""Planar colour formats: all brightness bytes come first."""
_COMPRESSED = ('MJPG', 'JPEG')
_ENCODINGS = {
    'GREY': 'mono8', 'Y10': 'mono16', 'Y12': 'mono16', 'Y14': 'mono16', 'Y16': 'mono16',
    **dict.fromkeys((*_LUMA, *_PLANAR, *_COMPRESSED), 'mono8'),
    'BGR3': 'bgr8', 'RGB3': 'rgb8',
    'RGGB': 'bayer_rggb8', 'BA81': 'bayer_bggr8', 'GBRG': 'bayer_gbrg8', 'GRBG': 'bayer_grbg8',
}
_PER_MS = 10  # V4L2_CID_EXPOSURE_ABSOLUTE counts units of 100 µs


class V4l2Camera(CameraDriver):
    """Camera by device number (0) or path (/dev/video0); of colour the brightness is read."""

    def open(self) -> CameraFormat:
        source = self.wanted.source
        path = f'/dev/video{source}' if source.isdigit() else source
        self._device: VideoDevice | None = None
        self.refuse('trigger')
        try:
            self._device = self._connected(path)
            self._layout = self._laid_out()
            self._set_rate()
            self._set_exposure_and_gain()
            self._device.start()
            return self._format()
        except OSError as error:
            self.close()
            raise InputError(source, 'expected a camera that delivers frames; it '
                                     f'delivers none ({error.strerror or error})') from None
        except InputError:
            self.close()
            raise

    def read(self, timeout: float) -> CameraFrame | None:
        assert self._device is not None
        try:
            captured = self._device.capture(timeout)
        except OSError as error:
            raise InputError(self.wanted.source, f'stopped delivering frames ({error.strerror})'
                             ) from None
        arrived = time.monotonic()
        image = None if captured is None or captured.broken else self._image(captured.data)
        if captured is None or image is None:
            return None
        return CameraFrame(captured.sequence, image, arrived, self._exposed(captured))

    def close(self) -> None:
        if self._device is not None:
            self._device.close()
            self._device = None

    def _connected(self, path: str) -> VideoDevice:
        return VideoDevice(path)

    def _laid_out(self) -> PixelLayout:
        """Negotiate size and pixel format as requested, or the device's own if it can be read."""
        device, wanted = self._device, self.wanted
        assert device is not None
        now, here = device.layout(), device.pixel_formats()
        pixel_format = now.pixel_format
        if wanted.pixel_format:
            pixel_format = self.one_of('pixel_format', here or [now.pixel_format])
        elif pixel_format not in _ENCODINGS:
            pixel_format = next(filter(_ENCODINGS.__contains__, here), pixel_format)
        self._encoding = encoding_of(pixel_format, _ENCODINGS, wanted.source)
        width, height = wanted.width_px or now.width, wanted.height_px or now.height
        if wanted.offset_x_px or wanted.offset_y_px:
            self._crop(device, width, height)
        layout = device.lay_out(width, height, pixel_format)
        given = layout.width, layout.height, layout.pixel_format
        if given != (width, height, pixel_format):
            raise InputError(wanted.source, f'does not support {width}×{height} '
                                            f'{pixel_format}; nearest is '
                                            f'{layout.width}×{layout.height} '
                                            f'{layout.pixel_format}')
        return layout

    def _crop(self, device: VideoDevice, width: int, height: int) -> None:
        region = self.wanted.offset_x_px, self.wanted.offset_y_px, width, height
        try:
            given = device.crop(*region)
        except OSError:
            self.refuse('offset_x_px', 'offset_y_px')
            raise
        if given != region:
            raise InputError(self.wanted.source, 'does not read the region {2}×{3} at {0}, {1}; '
                             .format(*region) + 'nearest is {2}×{3} at {0}, {1}'.format(*given))

    def _set_rate(self) -> None:
        wanted = self.wanted.frame_rate_hz
        if not wanted:
            return
        assert self._device is not None
        given = self._device.ask_frame_rate(wanted)
        if given is None:
            self.refuse('frame_rate_hz')
        elif abs(given - wanted) > 0.01 * wanted:
            raise InputError(self.wanted.source, f'does not support {wanted:g} frames/s; '
                                                 f'nearest is {given:g}')

    def _set_exposure_and_gain(self) -> None:
        device, wanted = self._device, self.wanted
        assert device is not None
        if wanted.exposure_ms:
            low, high = self._limits('exposure_ms', v4l2_device.EXPOSURE_ABSOLUTE)
            value = self.within('exposure_ms', low / _PER_MS, high / _PER_MS) * _PER_MS
            if device.limits(v4l2_device.EXPOSURE_AUTO):
                device.set(v4l2_device.EXPOSURE_AUTO, v4l2_device.EXPOSURE_MANUAL)
            device.set(v4l2_device.EXPOSURE_ABSOLUTE, round(value))
        if wanted.gain:
            gain = self.within('gain', *self._limits('gain', v4l2_device.GAIN))
            if device.limits(v4l2_device.AUTOGAIN):
                device.set(v4l2_device.AUTOGAIN, 0)
            device.set(v4l2_device.GAIN, round(gain))

    def _limits(self, name: str, control: int) -> tuple[int, int]:
        assert self._device is not None
        limits = self._device.limits(control)
        if limits is None:
            self.refuse(name)
            raise AssertionError
        return limits

    def _format(self) -> CameraFormat:
        """Return the format; the clock is known only with a frame, so the first is captured."""
        device = self._device
        assert device is not None
        automatic = device.get(v4l2_device.EXPOSURE_AUTO)
        exposure = device.get(v4l2_device.EXPOSURE_ABSOLUTE)
        fixed = automatic in (None, v4l2_device.EXPOSURE_MANUAL) and exposure is not None
        self._exposure = exposure / _PER_MS * 1e-3 if fixed and exposure else 0.0
        patience = 3.0 + 2 * self._exposure
        first = device.capture(patience)
        if first is None:
            raise InputError(self.wanted.source, 'expected a camera that delivers frames; it '
                                                 'delivers none')
        layout = self._layout
        return CameraFormat(
            layout.height, layout.width, self._encoding, layout.pixel_format,
            Clock.HOST if first.monotonic else Clock.DEVICE, frame_rate=device.frame_rate(),
            least_delay=self._exposure, patience=patience,
            offset=(self.wanted.offset_x_px, self.wanted.offset_y_px))

    def _exposed(self, captured: Captured) -> float:
        """Return the start of the exposure: drivers stamp the start or the end of a frame."""
        if captured.time <= 0:
            return math.nan
        return captured.time - (0.0 if captured.start else self._exposure)

    def _image(self, data: memoryview) -> np.ndarray | None:
        """Return the picture in `data`, a view if possible; None if it is incomplete."""
        layout, name = self._layout, self._layout.pixel_format
        if name in _COMPRESSED:
            return _decompressed(data)
        try:
            if name in _LUMA:
                step, first = _LUMA[name]
                pairs = picture(data, 'mono8', layout.height, step * layout.width, layout.stride)
                return pairs[:, first::step]
            return picture(data, self._encoding, layout.height, layout.width, layout.stride)
        except ValueError:
            return None


def _decompressed(data: memoryview) -> np.ndarray | None:
    import cv2

    try:
        found: np.ndarray | None = cv2.imdecode(
            np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)
    except cv2.error:
        return None
    return found
