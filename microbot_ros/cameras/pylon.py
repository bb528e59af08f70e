"""Camera kind `pylon`: Basler cameras and their emulator (PYLON_CAMEMU=1)."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

from microbot_ros.cameras.camera import CameraDriver, CameraFormat, CameraFrame, Clock, optional
from microbot_ros.cameras.pixels import GENICAM, encoding_of, picture
from microbot_ros.common.errors import InputError

_BUFFERS = 32  # choice: 0.3 s of frames at 100 frames/s
_NO_NUMBER = 2**64 - 1  # the block ID of transports that have none
_EMULATOR = 'BaslerCamEmu'


class PylonCamera(CameraDriver):
    """Basler camera, by serial number, user-defined name or IP address."""

    wraps_after = 65535  # GigE Vision without extended block IDs

    def open(self) -> CameraFormat:
        self._device: Any = None
        self._result: Any = None
        self._pylon = optional('pypylon.pylon', 'pylon')
        self._errors = optional('pypylon.genicam', 'pylon').GenericException
        try:
            with self._told():
                self._device = self._pylon.InstantCamera(self._found())
                self._device.Open()
                self._set_up()
                found = self._format()
                self._device.MaxNumBuffer.Value = _BUFFERS
                self._device.StartGrabbing(self._pylon.GrabStrategy_OneByOne)
                return found
        except InputError:
            self.close()
            raise

    def read(self, timeout: float) -> CameraFrame | None:
        self._release()
        with self._told():
            result = self._device.RetrieveResult(
                max(1, round(timeout * 1e3)), self._pylon.TimeoutHandling_Return)
            arrived = time.monotonic()
            if not (result and result.IsValid()):
                return None
            self._result = result
            if not result.GrabSucceeded():
                return None
            image = picture(result.GetMemoryView(), self._encoding, result.Height, result.Width,
                            result.GetStride()[1] if result.PaddingX else 0)
            ticks, number = result.TimeStamp, result.BlockID
            if number == _NO_NUMBER:
                number = result.ImageNumber
            return CameraFrame(number, image, arrived,
                               ticks / self._ticks_per_s if ticks else math.nan)

    def close(self) -> None:
        if self._device is None:
            return
        # A disconnected camera cannot be stopped.
        with suppress(self._errors):
            self._release()
            self._device.StopGrabbing()
        with suppress(self._errors):
            self._device.DestroyDevice()
        self._device = None

    def _release(self) -> None:
        if self._result is not None:
            self._result.Release()
            self._result = None

    @contextmanager
    def _told(self) -> Iterator[None]:
        try:
            yield
        except self._errors as error:
            reason = str(error).split(' : ')[0].splitlines()[0]
            raise InputError(self.wanted.source, f'pylon says: {reason}') from None

    def _found(self) -> Any:
        """Create the one device with the name in `source`; InputError for none or several."""
        factory = self._pylon.TlFactory.GetInstance()
        devices = factory.EnumerateDevices()
        names = [(each.GetSerialNumber(), each.GetUserDefinedName(), each.GetFullName(),
                  each.GetIpAddress() if each.IsIpAddressAvailable() else '')
                 for each in devices]
        here = [each for each, known in zip(devices, names, strict=True)
                if self.wanted.source and self.wanted.source in known]
        if len(here) != 1:
            listed = ', '.join(f'{each.GetSerialNumber()} ({each.GetModelName()})'
                               for each in devices) or 'none'
            raise InputError(self.wanted.source or 'camera', 'expected the serial number, '
                                                             'name or IP address of one '
                                                             'Basler camera as source; found: '
                                                             f'{listed}')
        return factory.CreateDevice(here[0])

    def _set_up(self) -> None:
        wanted = self.wanted
        if wanted.pixel_format:
            pixel_format = self._device.PixelFormat
            pixel_format.Value = self.one_of('pixel_format', list(pixel_format.Symbolics))
        self._region()
        if wanted.exposure_ms:
            self._off('ExposureAuto')
            self._set('exposure_ms', wanted.exposure_ms * 1e3, 'ExposureTime', 'ExposureTimeAbs')
        if wanted.gain:
            self._off('GainAuto')
            self._set('gain', wanted.gain, 'Gain', 'GainRaw')
        if wanted.frame_rate_hz:
            self._device.AcquisitionFrameRateEnable.TrySetValue(True)
            self._set('frame_rate_hz', wanted.frame_rate_hz, 'AcquisitionFrameRate',
                      'AcquisitionFrameRateAbs')
        if wanted.trigger:
            self._trigger()

    def _region(self) -> None:
        """Set the region, with the offset at zero first: the size limits depend on it."""
        sizes = (('width_px', 'Width'), ('height_px', 'Height'))
        offsets = (('offset_x_px', 'OffsetX'), ('offset_y_px', 'OffsetY'))
        if not any(name in self.wanted.asked for name, _ in (*sizes, *offsets)):
            return
        for _, node in offsets:
            self._device.GetNodeMap().GetNode(node).Value = 0
        for name, node in (*sizes, *offsets):
            if name in self.wanted.asked:
                self._set(name, getattr(self.wanted, name), node)

    def _trigger(self) -> None:
        device = self._device
        if 'FrameStart' in device.TriggerSelector.Symbolics:
            device.TriggerSelector.Value = 'FrameStart'
        # Nothing here would send a software trigger.
        lines = [name for name in device.TriggerSource.Symbolics if name != 'Software']
        device.TriggerSource.Value = self.one_of('trigger', lines)
        device.TriggerMode.Value = 'On'

    def _set(self, name: str, value: float, *nodes: str) -> None:
        """Set the first available node to `value`, the setting `name` in the node's unit."""
        node = self._node(*nodes)
        if node is None:
            self.refuse(name)
            return
        scale = value / getattr(self.wanted, name)
        self.within(name, node.Min / scale, node.Max / scale)
        node.Value = value if isinstance(node.Min, float) else round(value)

    def _node(self, *names: str) -> Any:
        for name in names:
            node = self._device.GetNodeMap().GetNode(name)
            if node is not None and node.IsReadable():
                return node
        return None

    def _off(self, name: str) -> None:
        if (node := self._node(name)) is not None:
            node.TrySetValue('Off')

    def _value(self, *names: str) -> float:
        """Return the value of the first of the nodes `names` that exists; NaN if none does."""
        node = self._node(*names)
        return math.nan if node is None else node.Value

    def _sensor(self) -> tuple[int, int] | None:
        size = self._node('SensorHeight', 'HeightMax'), self._node('SensorWidth', 'WidthMax')
        return None if None in size else (size[0].Value, size[1].Value)

    def _format(self) -> CameraFormat:
        device = self._device
        self._encoding = encoding_of(device.PixelFormat.Value, GENICAM, self.wanted.source)
        ticks = self._value('GevTimestampTickFrequency')
        self._ticks_per_s = 1e9 if math.isnan(ticks) else float(ticks)
        automatic = self._node('ExposureAuto')
        fixed = automatic is None or automatic.Value == 'Off'
        exposure = self._value('ExposureTime', 'ExposureTimeAbs') if fixed else 0.0
        readout = self._value('SensorReadoutTime', 'ReadoutTimeAbs')
        rate = self._value('ResultingFrameRate', 'ResultingFrameRateAbs')
        clock = Clock.DEVICE
        if device.GetDeviceInfo().GetDeviceClass() == _EMULATOR:
            clock = Clock.NONE
        return CameraFormat(
            device.Height.Value, device.Width.Value, self._encoding, device.PixelFormat.Value,
            clock, frame_rate=None if math.isnan(rate) else rate,
            least_delay=sum(us * 1e-6 for us in (exposure, readout) if us > 0),
            offset=(device.OffsetX.Value, device.OffsetY.Value), sensor=self._sensor(),
            patience=math.inf if self.wanted.trigger else 3.0 + 2 * max(exposure, 0.0) * 1e-6)
