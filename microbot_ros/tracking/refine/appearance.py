"""What a particle looks like: the learned picture that search and fit share."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from microbot_ros.tracking.refine.fit import TABLE_STEP


@dataclass(frozen=True)
class Appearance:
    """The typical particle, as radial profiles about its centre.

    `table` (1, K) or, where a cap shows, (3, K): f₀, f₁, f₂ in steps of `TABLE_STEP` px, scaled
    so that f₀ has the largest magnitude 1; a particle adds a·[f₀ + f₁ cos(φ−θ) + f₂ cos 2(φ−θ)]
    to the background. `reach_px` is the radius beyond which f₀ is nothing, `diameter_px` the
    width at half contrast. `contrast_grey` is the typical a, `min_contrast_grey` the least that
    counts. `round` is False where the particles are too irregular for one picture to fit.
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
        """f₀ at offsets (u, v) [px] from the centre."""
        radii = np.arange(self.table.shape[1]) * TABLE_STEP
        return np.interp(np.hypot(u, v), radii, self.table[0], right=0.0)

    def describe(self) -> list[str]:
        """What was found, in words."""
        kind = 'round' if self.round else 'of any shape, followed by their outline'
        cap = 'the cap shows' if self.capped else 'no cap shows'
        return [
            f'particles are {"dark" if self.dark else "bright"}, {kind}; {cap}',
            f'diameter {self.diameter_px:.1f} px at half contrast',
            f'contrast {self.contrast_grey:.0f} grey levels, '
            f'at least {self.min_contrast_grey:.0f} counts',
        ]
