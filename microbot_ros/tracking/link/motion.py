"""Motion of particles between frames, learned from the tracks."""

from __future__ import annotations

import math

import numpy as np

from microbot_ros.common.compiled import numba

_MEMORY = 2000.0
"""Choice: displacements over which the motion is averaged."""

_PRIOR = 30.0
"""Choice: weight of the first guess, in displacements."""


_PERSISTENCE = 30.0
"""Choice: frames over which a velocity is expected to change."""


class Motion:
    """Random steps on top of a persistent velocity: variances per coordinate, learned online.

    Successive displacements d of a particle with velocity variance V, random step variance S per
    second and localisation variance σ² have ⟨d²⟩ = V dt² + S dt + 2σ² and ⟨d d′⟩ = V dt² − σ² (A.
    J. Berglund, Physical Review E 82, 011917, 2010, with a velocity added). Both follow from two
    averages, so that Brownian spheres and swimmers need no setting. `diameter_px` of the particles
    sets the prior.

    Parameters
    ----------
    diameter_px : float
        Diameter of the particles [px].
    """

    def __init__(self, diameter_px: float) -> None:
        self._same = (0.2 * diameter_px) ** 2
        self._next = (0.15 * diameter_px) ** 2
        self._noise = 0.0
        self._weight = _PRIOR
        self._least = (0.02 * diameter_px) ** 2

    def learn(self, step: np.ndarray, previous: np.ndarray, sigma: np.ndarray) -> None:
        """Add displacements `step` (N, 2) [px], those of the `previous` frame, and `sigma`.

        Parameters
        ----------
        step : ndarray, shape (N, 2)
            Displacements [px].
        previous : ndarray, shape (N, 2)
            Displacements of the frame before [px].
        sigma : ndarray, shape (N,)
            Standard deviations of the positions [px].
        """
        if len(step) == 0:
            return
        # Limit long steps to three usual ones, so that one wrong link does not widen the gate.
        same, following, noise = _means(step, previous, sigma, 9 * self._same)
        self._weight = min(self._weight + len(step), _MEMORY)
        share = min(len(step) / self._weight, 1.0)
        self._same += share * (same - self._same)
        self._next += share * (following - self._next)
        self._noise += share * (noise - self._noise)

    @property
    def velocity_step(self) -> float:
        """Variance per coordinate [px²] of a frame's displacement by velocity."""
        return max(self._next + self._noise, 0.0)

    @property
    def random_step(self) -> float:
        """Variance per coordinate [px²] of the random part of a frame's displacement."""
        return max(self._same - self.velocity_step - 2 * self._noise, self._least)

    def keep(self, frames: float) -> float:
        """Return the share of a velocity that persists over `frames` usual intervals.

        Parameters
        ----------
        frames : float
            Number of usual intervals.

        Returns
        -------
        float
            The share.
        """
        return math.exp(-frames / _PERSISTENCE)


@numba.njit(cache=True)
def _means(step, previous, sigma, bound):  # type: ignore[no-untyped-def]
    """Return ⟨d²⟩ and ⟨d d′⟩ per coordinate, each limited to `bound`, and ⟨σ²⟩."""
    same = following = noise = 0.0
    for n in range(len(step)):
        same += min((step[n, 0]**2 + step[n, 1]**2) / 2, bound)
        both = (step[n, 0] * previous[n, 0] + step[n, 1] * previous[n, 1]) / 2
        following += min(max(both, -bound), bound)
        noise += sigma[n]**2
    return same / len(step), following / len(step), noise / len(step)
