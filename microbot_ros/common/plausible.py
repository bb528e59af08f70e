"""Plausible ranges of input numbers: anything beyond is a mistake and would overflow later.

The ranges are wide and the same wherever a number enters: by its name, or else by its unit.
"""

from __future__ import annotations

import math

import numpy as np

from microbot_ros.common.units import suffix, symbol

LONGEST_S = 1e7
"""Choice: longest session or simulation [s], four months."""

# Choices, orders of magnitude beyond any rig; in the unit of the name.
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
# Choices: largest absolute value of any other number, by unit; none for units not listed.
_SIZES = {
    '_um': 1e7, '_mm': 1e4, '_m': 10.0, '_px': 1e7, '_um_s': 1e7, '_mT': 1e5, '_T': 100.0,
    '_A': 1e4, '_hz': 1e7, '_rad': 1e7, '_deg': 1e9,
}

def plausible_range(name: str) -> tuple[float, float]:
    """Return the smallest and largest plausible number `name`, in the unit of the name.

    Parameters
    ----------
    name : str
        Name of the quantity, which ends in its unit.

    Returns
    -------
    tuple[float, float]
        Smallest and largest number.
    """
    size = _SIZES.get(suffix(name), math.inf)
    return _RANGES.get(name, (-size, size))


def implausible(name: str, values: np.ndarray) -> np.ndarray:
    """Return which of the `values` (...) of `name`, in its unit, are implausible.

    Parameters
    ----------
    name : str
        Name of the quantity, which ends in its unit.
    values : ndarray
        Numbers, of any shape.

    Returns
    -------
    ndarray
        Whether each is implausible, of the same shape.
    """
    low, high = plausible_range(name)
    return ~((low <= values) & (values <= high))


def check_plausible(name: str, value: object) -> None:
    """Raise ValueError, naming the expected range, for an implausible finite number `name`.

    `value` may also be a nested sequence of numbers; anything else passes.

    Parameters
    ----------
    name : str
        Name of the quantity, which ends in its unit.
    value : object
        A number, or a nested sequence of numbers.
    """
    if isinstance(value, list | tuple):
        for item in value:
            check_plausible(name, item)
    elif isinstance(value, int | float) and not isinstance(value, bool):
        low, high = plausible_range(name)
        # Infinity is checked elsewhere: some numbers may be infinite.
        if not low <= value <= high and math.isfinite(value):
            raise ValueError(expected_range(name))


def expected_range(name: str) -> str:
    """Return a phrase with the plausible range of `name`, for messages.

    Parameters
    ----------
    name : str
        Name of the quantity, which ends in its unit.

    Returns
    -------
    str
        The phrase.
    """
    low, high = plausible_range(name)
    return f'expected {low:g} to {high:g} {symbol(name)}'.rstrip()
