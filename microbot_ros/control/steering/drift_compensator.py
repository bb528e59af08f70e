"""Track the driven particle: position, response to the field, and drift."""

from __future__ import annotations

import cmath
import math

import numpy as np

from microbot_ros.control.contract import ControllerInput
from microbot_ros.control.steering.courses import field_along
from microbot_ros.control.steering.drift_observer import DriftObserver

UNKNOWN_ANSWER = 10e-6
"""Choice: prior standard deviation of an unknown response to the field [m/s]."""
EXPECTED_DRIFT = 1e-6
"""Choice: prior standard deviation of the drift [m/s]."""
WELL_ENOUGH = 0.2
"""Choice: relative standard deviation of the response below which it is used."""
SET_BACK = 1.0
"""Choice: step back in time [s] beyond which the clock was set back, as in the estimation."""


class DriftCompensator:
    """Steers one particle at a time along courses over ground, against a learned drift.

    Its speed, φ and drift come from a filter; the estimates in the input only initialise it. For
    `rolling` particles the response is the gain [m/s/Hz].

    Parameters
    ----------
    rolling : bool
        Whether particles roll.
    """

    def __init__(self, rolling: bool = False) -> None:
        self._rolling = rolling
        self._particle = -1
        self._observer: DriftObserver | None = None
        self._seen = -math.inf

    def look(self, inputs: ControllerInput, row: int) -> complex:
        """Return the position [m] of a `row` of `inputs` when a command given now takes effect.

        Parameters
        ----------
        inputs : ControllerInput
            Input of the tick.
        row : int
            Row of the particle.

        Returns
        -------
        complex
            Position, complex [m].
        """
        exposed, record = inputs.t - inputs.age, inputs.record
        measured = complex(*inputs.position[row].tolist())
        sigma = float(inputs.sigma[row])
        sigma = sigma if sigma > 0 else 1e-7
        observer, since = self._observer, self._seen
        if observer is None or self._particle != inputs.ids[row]:
            observer = self._observer = _start(inputs, row, measured)
            self._particle, self._seen = int(inputs.ids[row]), exposed
        elif exposed < since - SET_BACK:
            observer.jump(0.0, measured, sigma)
            self._seen = exposed
        elif exposed > since:
            if record.reaches(since):
                shared = record.shared(since, exposed, self._rolling)
                observer.update(shared, exposed - since, measured, sigma)
            else:
                observer.jump(exposed - since, measured, sigma)
            self._seen = exposed
        acts = inputs.t + inputs.delay
        shared = record.shared(self._seen, acts, self._rolling)
        return observer.ahead(shared, acts - self._seen)

    @property
    def ready(self) -> bool:
        """Whether the response of the particle is known."""
        observer = self._observer
        return observer is not None and (
            observer.answer_std <= WELL_ENOUGH * abs(observer.answer))

    @property
    def answer(self) -> complex:
        """Velocity phasor c = v e^{iφ} of the last particle [m/s, or m/s/Hz]."""
        assert self._observer is not None
        return self._observer.answer

    @property
    def drift(self) -> complex:
        """Drift of the particle [m/s]."""
        assert self._observer is not None
        return self._observer.drift

    def steer(self, inputs: ControllerInput, course: float, strength: float) -> np.ndarray:
        """Return the field (2,) of `strength` [T] for a `course` [rad] over ground, for `inputs`.

        The drift is compensated, as far as the particle is faster.

        Parameters
        ----------
        inputs : ControllerInput
            Input of the tick.
        course : float
            Course over ground [rad].
        strength : float
            Strength of the field [T].

        Returns
        -------
        ndarray, shape (2,)
            Field [T].
        """
        across = (self.drift * cmath.exp(-1j * course)).imag / abs(self.answer)
        heading = course - math.asin(min(max(across, -1.0), 1.0))
        return field_along(inputs, heading - cmath.phase(self.answer), strength)


def _start(inputs: ControllerInput, row: int, measured: complex) -> DriftObserver:
    speed, phi = float(inputs.speed[row]), float(inputs.phi[row])
    std = math.hypot(float(inputs.speed_std[row]), speed * float(inputs.phi_std[row]))
    if std <= UNKNOWN_ANSWER and math.isfinite(phi):
        return DriftObserver(measured, cmath.rect(speed, phi), std, EXPECTED_DRIFT)
    return DriftObserver(measured, 0j, UNKNOWN_ANSWER, EXPECTED_DRIFT)
