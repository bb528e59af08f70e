"""Display units: the core computes in SI; files, plots and screens name their unit.

A name that carries a unit ends in one of the suffixes below: `x_um`, `field_mT`, `tau_s`.
"""

from __future__ import annotations

import math
from decimal import Decimal
from functools import cache
from typing import TypeVar

import numpy as np

MU_0 = 1.25663706127e-6
"""Vacuum permeability [N/A²], CODATA 2022."""

BOLTZMANN = 1.380649e-23
"""Boltzmann constant [J/K], exact since the SI of 2019."""

Number = TypeVar('Number', float, np.ndarray)

# Suffix → (value of one such unit in SI, symbol). The longest matching suffix counts.
_SUFFIXES: dict[str, tuple[float, str]] = {
    '_um': (1e-6, 'µm'),
    '_mm': (1e-3, 'mm'),
    '_m': (1.0, 'm'),
    '_um_s': (1e-6, 'µm/s'),
    '_um_s_mT': (1e-3, 'µm/s/mT'),
    '_um2': (1e-12, 'µm²'),
    '_um2_s': (1e-12, 'µm²/s'),
    '_um3_s': (1e-18, 'µm³/s'),
    '_um5_s': (1e-30, 'µm⁵/s'),
    '_um_s_hz': (1e-6, 'µm/s/Hz'),
    '_mT': (1e-3, 'mT'),
    '_T': (1.0, 'T'),
    '_A': (1.0, 'A'),
    '_W': (1.0, 'W'),
    '_ohm': (1.0, 'Ω'),
    '_pN': (1e-12, 'pN'),
    '_ng': (1e-12, 'ng'),
    '_mPa_s': (1e-3, 'mPa·s'),
    '_K': (1.0, 'K'),
    '_s': (1.0, 's'),
    '_ms': (1e-3, 'ms'),
    '_hz': (1.0, 'Hz'),
    '_rad': (1.0, 'rad'),
    '_deg': (math.pi / 180, '°'),
    '_per_s': (1.0, '1/s'),
    '_A_per_s': (1.0, 'A/s'),
    '_mT_per_s': (1e-3, 'mT/s'),
    '_mT_per_A': (1e-3, 'mT/A'),
    '_rad_per_s': (1.0, 'rad/s'),
    '_rad_s': (1.0, 'rad/s'),
    '_per_s_mT': (1e3, '1/s/mT'),
    '_px': (1.0, 'px'),
}
_BY_LENGTH = sorted(_SUFFIXES, key=len, reverse=True)


@cache
def suffix(name: str) -> str:
    """Return the unit suffix of `name`, or '' if it has none: `suffix('wx_um_s') == '_um_s'`.

    Parameters
    ----------
    name : str
        Name of the quantity, which ends in its unit.

    Returns
    -------
    str
        The suffix, or ''.
    """
    return next((s for s in _BY_LENGTH if name.endswith(s)), '')


def bare(name: str) -> str:
    """Return `name` without its unit: `bare('tau_s') == 'tau'`.

    Parameters
    ----------
    name : str
        Name of the quantity.

    Returns
    -------
    str
        Its name alone.
    """
    return name.removesuffix(suffix(name))


def symbol(name: str) -> str:
    """Return the symbol of the unit that `name` carries: `symbol('wx_um_s') == 'µm/s'`.

    Parameters
    ----------
    name : str
        Name of the quantity, which ends in its unit.

    Returns
    -------
    str
        The symbol, '' for no unit.
    """
    ending = suffix(name)
    return _SUFFIXES[ending][1] if ending else ''


def to_si(name: str, value: Number) -> Number:
    """Convert `value` from the unit of its `name` to SI: `to_si('x_um', 2.0) == 2e-6`.

    Parameters
    ----------
    name : str
        Name of the quantity, which ends in its unit.
    value : Number
        A number or an array, in the unit of the name.

    Returns
    -------
    Number
        The same in SI.
    """
    ending = suffix(name)
    return value * _SUFFIXES[ending][0] if ending else value


def from_si(name: str, value: Number) -> Number:
    """Convert `value` from SI to the unit of its `name`: `from_si('x_um', 2e-6) == 2.0`.

    Parameters
    ----------
    name : str
        Name of the quantity, which ends in its unit.
    value : Number
        A number or an array, in SI.

    Returns
    -------
    Number
        The same in the unit of the name.
    """
    ending = suffix(name)
    return value / _SUFFIXES[ending][0] if ending else value


def exact_si(name: str, value: Decimal | float | str) -> float:
    """Convert `value` from the unit of its `name` to SI, rounded once: 3.7 µm is the float 3.7e-6.

    Raises ArithmeticError for a text that is not a number.

    Parameters
    ----------
    name : str
        Name of the quantity, which ends in its unit.
    value : Decimal or float or str
        A number or its text, in the unit of the name.

    Returns
    -------
    float
        The same in SI.
    """
    return float(Decimal(str(value)) * _factor(name))


def exact_display(name: str, value: float) -> Decimal:
    """Convert `value` from SI to the unit of its `name`, exactly: inverse of `exact_si`.

    Parameters
    ----------
    name : str
        Name of the quantity, which ends in its unit.
    value : float
        A number in SI.

    Returns
    -------
    Decimal
        The same in the unit of the name.
    """
    return Decimal(repr(value)) / _factor(name)


@cache
def _factor(name: str) -> Decimal:
    return Decimal(repr(to_si(name, 1.0)))
