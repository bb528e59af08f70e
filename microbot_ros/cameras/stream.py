"""Frames of a camera, each once, with its exposure time; lost frames are counted."""

from __future__ import annotations

import time

from microbot_ros.cameras.camera import ENCODINGS, CameraDriver, CameraFrame, Clock
from microbot_ros.cameras.exposure_clock import ExposureClock
from microbot_ros.common.errors import InputError


class FrameStream:
    """Frames of a `camera`, opened here and checked against its `format`.

    `lost` counts frames exposed before the newest that did not arrive, `repeated` those delivered
    again: with the number, or on a real clock the stamp or the pixels, of the previous one. Raises
    InputError if the camera cannot be opened.

    Parameters
    ----------
    camera : CameraDriver
        The camera.
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
        self._pixels = b''
        self._heard = time.monotonic()

    def read(self, timeout: float) -> tuple[CameraFrame, float] | None:
        """Return the next frame and the start of its exposure on the monotonic clock [s].

        None if no frame arrives within `timeout` [s], or a repeated one. Raises InputError if the
        camera is lost, silent or gives frames of another size; EndOfFrames at the end of a file.

        Parameters
        ----------
        timeout : float
            Longest time to wait [s].

        Returns
        -------
        tuple[CameraFrame, float] or None
            Frame and start of its exposure [s], or None.
        """
        frame = self._camera.read(timeout)
        if frame is None:
            silent = time.monotonic() - self._heard
            if silent > self.format.patience:
                raise InputError(self._name, f'no frame for {silent:.1f} s')
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
        """Release the camera."""
        self._camera.close()

    @property
    def _name(self) -> str:
        return self._camera.wanted.source

    def _check(self, frame: CameraFrame) -> None:
        if frame.image.shape != self._shape or frame.image.dtype != self._dtype:
            found, expected = ('×'.join(map(str, shape[1::-1])) for shape in (
                frame.image.shape, self._shape))
            raise InputError(self._name, f'frame {frame.number} is {found} '
                                         f'{frame.image.dtype}, expected {expected} '
                                         f'{self.format.encoding}')

    def _is_new(self, frame: CameraFrame) -> bool:
        """Return whether the frame is new, and count the frames missing before it as lost."""
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
                                f'{frame.number}; frames lost in between are not counted')
            return True
        if step == 0 or (self.format.clock is not Clock.NONE and frame.exposed == stamp):
            return False
        self._missing += step - 1
        return not self._is_frozen(frame)

    def _is_frozen(self, frame: CameraFrame) -> bool:
        """Return whether a device delivers the same picture again: noise is never equal."""
        if self.format.clock is Clock.NONE:
            return False  # a file may hold equal pictures
        before, self._pixels = self._pixels, frame.image.tobytes()
        return self._pixels == before and frame.image.min() < frame.image.max()
