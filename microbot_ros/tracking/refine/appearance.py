"""Learned picture of a particle, shared by search and fit."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from microbot_ros.tracking.refine.fit import TABLE_STEP


@dataclass(frozen=True)
class Appearance:
    """Typical particle, as radial profiles about its centre.

    Attributes
    ----------
    table : (1, K) or (3, K) array
        f₀, or with a visible cap f₀, f₁, f₂, in steps of `TABLE_STEP` px, scaled such that the
        largest magnitude of f₀ is 1; a particle adds a·[f₀ + f₁ cos(φ−θ) + f₂ cos 2(φ−θ)] to the
        background.
    reach_px, diameter_px : float
        Radius beyond which f₀ vanishes, and width at half contrast.
    contrast_grey, min_contrast_grey : float
        Typical a, and the least that counts.
    round : bool
        False if the particles are too irregular for one picture.
    """

    table: np.ndarray
    reach_px: float
    diameter_px: float
    contrast_grey: float
    min_contrast_grey: float
    round: bool

    @property
    def capped(self) -> bool:
        """Whether the picture shows a cap, so that θ can be measured."""
        return len(self.table) > 1

    @cached_property
    def dark(self) -> bool:
        """Whether particles are, on the whole, darker than their background."""
        radius = np.arange(self.table.shape[1])
        return bool(np.sum(self.table[0] * radius) < 0)

    def draw_round(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return f₀ at offsets (`u`, `v`) [px] from the centre.

        Parameters
        ----------
        u : ndarray
            Offsets along the columns, of any shape [px].
        v : ndarray
            Offsets along the rows, of the same shape [px].

        Returns
        -------
        ndarray
            Values of f₀, of the same shape.
        """
        radii = np.arange(self.table.shape[1]) * TABLE_STEP
        return np.interp(np.hypot(u, v), radii, self.table[0], right=0.0)

    def describe(self) -> list[str]:
        """Return sentences that describe the appearance.

        Returns
        -------
        list of str
            The sentences.
        """
        kind = 'round' if self.round else 'of any shape, followed by their outline'
        cap = 'the cap shows' if self.capped else 'no cap shows'
        return [
            f'particles are {"dark" if self.dark else "bright"}, {kind}; {cap}',
            f'diameter {self.diameter_px:.1f} px at half contrast',
            f'contrast {self.contrast_grey:.0f} grey levels, '
            f'at least {self.min_contrast_grey:.0f} counts',
        ]
