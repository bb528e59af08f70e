"""Filter that learns the response of one particle to the field, and its drift."""

from __future__ import annotations

import math

import numpy as np

from microbot_ros.common.compiled import numba


class DriftObserver:
    """Kalman filter for dp/dt = c u + w, all complex: speed, angle and drift at once.

    State: position p [m], velocity phasor c = v e^{iφ} [m/s], drift w [m/s]; c and w wander
    slowly. Since no direction is preferred, one Hermitian 3 × 3 covariance serves x and y; its
    entries are variances per coordinate. The drift takes the role of integral action of a path
    follower, in the frame in which it is constant: that of the workspace, not of the path.

    Parameters
    ----------
    position : complex [m]
        Initial position.
    answer, answer_std : complex, float [m/s]
        Initial velocity phasor and its standard deviation.
    drift_std : float [m/s]
        Initial standard deviation of the drift.
    """

    WANDER = np.array([0.3e-6**2, 0.05e-6**2, 0.1e-6**2])
    """Choice: growth of the variance per second, Brownian motion [m²/s], of c and w [m²/s³]."""

    def __init__(self, position: complex, answer: complex, answer_std: float,
                 drift_std: float) -> None:
        self._state = np.array([position, answer, 0], complex)
        self._covariance = np.diag([1e-12, answer_std**2, drift_std**2]).astype(complex)

    def update(self, shared: complex, dt: float, measured: complex, sigma: float) -> None:
        """Process the position `measured` ± `sigma` [m], `dt` [s] after the measurement before.

        `shared` is ∫u dt [s] in between.

        Parameters
        ----------
        shared : complex
            ∫u dt since the last measurement [s].
        dt : float
            Time since the last measurement [s].
        measured : complex
            Measured position, complex [m].
        sigma : float
            Standard deviation of each coordinate [m].
        """
        _update(self._state, self._covariance, shared, dt, measured, sigma, self.WANDER)

    def jump(self, dt: float, measured: complex, sigma: float) -> None:
        """Process `measured` and `sigma` after `dt` [s] in which the field is unknown.

        Parameters
        ----------
        dt : float
            Time since the last measurement [s].
        measured : complex
            Measured position, complex [m].
        sigma : float
            Standard deviation of each coordinate [m].
        """
        self._state[0] = measured
        kept = self._covariance + np.diag(self.WANDER * dt)
        kept[0, :] = kept[:, 0] = 0
        kept[0, 0] = sigma**2
        self._covariance = kept

    @property
    def answer(self) -> complex:
        """Velocity phasor c = v e^{iφ} [m/s]."""
        return complex(self._state[1])

    @property
    def answer_std(self) -> float:
        """Standard deviation of each coordinate of c [m/s]."""
        return math.sqrt(self._covariance[1, 1].real)

    @property
    def drift(self) -> complex:
        """Drift w [m/s]."""
        return complex(self._state[2])

    def ahead(self, shared: complex, dt: float) -> complex:
        """Return the position `dt` [s] after the last measurement, with ∫u dt = `shared`.

        Parameters
        ----------
        shared : complex
            ∫u dt since the last measurement [s].
        dt : float
            Time since the last measurement [s].

        Returns
        -------
        complex
            Position, complex [m].
        """
        return complex(self._state[0] + self._state[1] * shared + self._state[2] * dt)


@numba.njit('void(c16[::1], c16[:, ::1], c16, f8, c16, f8, f8[::1])', cache=True)
def _update(state, covariance, shared, dt, measured, sigma, wander):  # type: ignore[no-untyped-def]
    """Apply `DriftObserver.update` in place."""
    state[0] += shared * state[1] + dt * state[2]
    for k in range(3):
        covariance[0, k] += shared * covariance[1, k] + dt * covariance[2, k]
    for k in range(3):
        covariance[k, 0] += shared.conjugate() * covariance[k, 1] + dt * covariance[k, 2]
    for k in range(3):
        covariance[k, k] += wander[k] * dt
    row = covariance[0].copy()
    gain = covariance[:, 0] / (row[0].real + sigma**2)
    off = measured - state[0]
    for k in range(3):
        state[k] += gain[k] * off
        for m in range(3):
            covariance[k, m] -= gain[k] * row[m]
