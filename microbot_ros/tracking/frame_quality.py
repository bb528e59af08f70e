"""Problems of the pictures: light, saturation, missing frames."""

from __future__ import annotations

import numpy as np

_SAMPLES = 32
"""Choice: points across the shorter side at which the light is sampled."""

_FLICKER, _DRIFT = 0.1, 0.3
"""Choices: relative changes of the light that are reported, from recent and from learned light."""

_RECENT, _LEARNED = 0.1, 30
"""Choices: weight of a new frame in recent values; frames after which the light is learned."""

_SATURATED = 0.02
"""Choice: share of saturated pixels that is reported; nothing can be measured there."""

_LATE = 2.5
"""Choice: usual intervals from which a gap is reported: more than one frame was lost."""


class FrameQuality:
    """Tracks usual light and frame interval, and reports deviations."""

    def __init__(self) -> None:
        self._light = 0.0
        self._first_light = 0.0
        self._interval = 0.0
        self._frames = 0

    def look(self, image: np.ndarray, dt: float | None, jump_px: float) -> dict[str, str]:
        """Return problems of an `image` (H, W), `dt` [s] after the last: kind → sentence.

        `jump_px` is the jump of the whole picture, as found by the linker.

        Parameters
        ----------
        image : ndarray, shape (H, W)
            The picture.
        dt : float or None
            Time since the last frame [s]; None for the first.
        jump_px : float
            Jump of the whole picture [px].

        Returns
        -------
        dict of str to str
            Sentence by kind of problem.
        """
        said = self._see(image)
        self._frames += 1
        if dt is not None:
            if dt > _LATE * self._interval > 0:
                said['late'] = f'no frame for {dt:.3f} s, usually one every {self._interval:.3f} s'
            self._interval += _RECENT * (dt - self._interval) if self._interval else dt
        if jump_px:
            said['jump'] = f'the image jumped by {jump_px:.0f} px'
        return said

    def _see(self, image: np.ndarray) -> dict[str, str]:
        spacing = max(1, min(image.shape) // _SAMPLES)
        sample = image[::spacing, ::spacing].flatten()  # a copy: it is sorted in place
        middle = sample.size // 2
        sample.partition((0, middle, sample.size - 1))
        light, top = float(sample[middle]), np.iinfo(image.dtype).max
        full = 0.0 if sample[-1] < top else np.mean(sample == top)
        said = {}
        if full > _SATURATED:
            said['saturated'] = f'{100 * full:.0f} % of the image is saturated'
        if sample[0] == sample[-1]:
            said['blank'] = 'the image is blank'
        change = light / self._light - 1 if self._light else 0.0
        if abs(change) > _FLICKER:
            said['flicker'] = f'the light jumped by {100 * change:+.0f} %'
        self._light = self._light + _RECENT * (light - self._light) if self._frames else light
        if self._frames < _LEARNED:
            self._first_light = self._light
        drift = self._light / self._first_light - 1 if self._first_light else 0.0
        if abs(drift) > _DRIFT:
            said['drift'] = f'the light differs by {100 * drift:+.0f} % from the start'
        return said
