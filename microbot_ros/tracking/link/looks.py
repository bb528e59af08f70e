"""What particles are told apart by, beside their places."""

from __future__ import annotations

import numpy as np

from microbot_ros.common.compiled import numba

LOOKS_SPREAD = 0.25
"""Standard deviation of ln(contrast) and ln(radius) of one particle from frame to frame."""

_OTHER_KIND = 0.9
"""What another kind counts among the looks: e⁻⁶, so that one mistaken for another is kept."""


@numba.njit(cache=True)
def looks(contrast, radius, kind):  # type: ignore[no-untyped-def]
    """Traits (N, 3) that tell particles apart: logarithms of `contrast` and `radius`, and `kind`.
    """
    traits = np.empty((len(contrast), 3))
    traits[:, 0], traits[:, 1] = np.log(contrast), np.log(radius)
    traits[:, 2] = _OTHER_KIND * kind
    return traits
