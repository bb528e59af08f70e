"""The frames of a camera, each once, with its moment of exposure; what is lost is counted."""

from __future__ import annotations

import time

from microbot_ros.cameras.camera import ENCODINGS, CameraDriver, CameraFrame, Clock
from microbot_ros.cameras.exposure_clock import ExposureClock
from microbot_ros.common.errors import InputError


class FrameStream:
    """An opened `camera`, watched: every frame comes once, and as its `format` says.

    `lost` frames were exposed before the newest and did not arrive; `repeated` ones came again. A
    frame is a repeat where it has the number of the one before, or that one's stamp by a clock.
    Raises InputError where the camera can't be opened.
    """

    def __init__(self, camera: CameraDriver) -> None:
        self.lost = self.repeated = 0
        self._missing = 0
        self._camera = camera
        self.format = camera.open()
        form = self.format
        kind, values = ENCODINGS[form.encoding]
        self._shape = (form.height, form.width) + ((values,) if values > 1 else ())
        self._dtype = kind
        self._clock = ExposureClock(form.least_delay, form.clock is Clock.HOST)
        self._number: int | None = None
        self._exposed = float('nan')
        self._heard = time.monotonic()

    def read(self, timeout: float) -> tuple[CameraFrame, float] | None:
        """The next frame and when its exposure began [s, monotonic]; None where none came within
        `timeout` [s], or a repeat.

        InputError where the camera is lost, has fallen silent or gives frames of another size;
        EndOfFrames at the end of a film.
        """
        frame = self._camera.read(timeout)
        if frame is None:
            silent = time.monotonic() - self._heard
            if silent > self.format.patience:
                raise InputError(self._name, f'gave no frame for {silent:.1f} s')
            return None
        self._heard = frame.arrived
        self._check(frame)
        new = self._is_new(frame)
        self.lost = max(self._missing, self._camera.dropped)
        if not new:
            self.repeated += 1
            return None
        return frame, self._clock.moment(frame.exposed, frame.arrived)

    def close(self) -> None:
        """Give back the camera."""
        self._camera.close()

    @property
    def _name(self) -> str:
        return self._camera.wanted.source

    def _check(self, frame: CameraFrame) -> None:
        if frame.image.shape != self._shape or frame.image.dtype != self._dtype:
            found, expected = ('×'.join(map(str, shape[1::-1])) for shape in (
                frame.image.shape, self._shape))
            raise InputError(self._name, f'frame {frame.number} is {found} {frame.image.dtype}, '
                             f'expected {expected} {self.format.encoding}')

    def _is_new(self, frame: CameraFrame) -> bool:
        """Whether it is; those between it and the one before are counted as lost."""
        before, self._number = self._number, frame.number
        stamp, self._exposed = self._exposed, frame.exposed
        if before is None:
            return True
        step = frame.number - before
        wraps = self._camera.wraps_after
        if step < 0 and -step > wraps / 2:
            step += wraps
        if step < 0:
            self._camera.report(f'{self._name}: frame numbers went back from {before} to '
                                f'{frame.number}; what was lost between them is not known')
            return True
        if step == 0 or (self.format.clock is not Clock.NONE and frame.exposed == stamp):
            return False
        self._missing += step - 1
        return True
