"""How large numbers from outside can be: what no rig has is a mistake, and would overflow later.

Limits are wide, and the same wherever a number comes in: by its name, or else by its unit.
"""

from __future__ import annotations

import math

import numpy as np

from microbot_ros.common.units import suffix, symbol

LONGEST_S = 1e7
"""Four months [s]: how long a session or a simulation can be."""

# In the unit of the name.
_RANGES: dict[str, tuple[float, float]] = {
    'radius_um': (1e-3, 1e4),
    'viscosity_mPa_s': (1e-4, 1e8),
    'temperature_K': (1.0, 1e4),
    'frame_rate_hz': (1e-6, 1e6),
    'pixel_size_um': (1e-5, 1e4),
    'reference_field_mT': (1e-6, 1e5),
    'duration_s': (1e-6, LONGEST_S),
    'dwell_s': (1e-4, LONGEST_S),
    'period_s': (1e-4, LONGEST_S),
    'patience_s': (1e-4, LONGEST_S),
    't_s': (-1e10, 1e10),  # may count from 1970
}
# The largest size of any other number, by its unit; no limit where there is none here.
_SIZES = {
    '_um': 1e7, '_mm': 1e4, '_m': 10.0, '_px': 1e7, '_um_s': 1e7, '_mT': 1e5, '_T': 100.0,
    '_A': 1e4, '_hz': 1e7, '_rad': 1e7, '_deg': 1e9,
}

def plausible_range(name: str) -> tuple[float, float]:
    """The least and the largest that a number of that `name` can be, in the unit of the name."""
    size = _SIZES.get(suffix(name), math.inf)
    return _RANGES.get(name, (-size, size))


def implausible(name: str, values: np.ndarray) -> np.ndarray:
    """Which of the `values` (...) under a `name`, in the unit of the name, no rig has."""
    low, high = plausible_range(name)
    return ~((low <= values) & (values <= high))


def check_plausible(name: str, value: object) -> None:
    """ValueError, naming what was expected, for a finite number under a `name` that no rig has.

    The `value` may also be a sequence of numbers, or of sequences; anything else passes.
    """
    if isinstance(value, list | tuple):
        for item in value:
            check_plausible(name, item)
    elif isinstance(value, int | float) and not isinstance(value, bool):
        low, high = plausible_range(name)
        # What is not finite is judged elsewhere: some numbers may be infinite.
        if not low <= value <= high and math.isfinite(value):
            raise ValueError(expected_range(name))


def expected_range(name: str) -> str:
    """What is expected of a number of that `name`, for people."""
    low, high = plausible_range(name)
    return f'expected {low:g} to {high:g} {symbol(name)}'.rstrip()
