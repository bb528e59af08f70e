"""Formats of numbers, intervals, probabilities, limits and names in the report."""

from __future__ import annotations

import inspect
from importlib.metadata import version

import numpy as np

from microbot_ros import __version__
from microbot_ros.common import units
from microbot_ros.common.units import from_si, symbol
from microbot_ros.discovery.result import Estimate, Limit
from microbot_ros.model.effects import EFFECTS

LEAST = 1e-300
"""Smallest printed p-value, and inverse of the largest printed odds: near the least double."""

_RAISED = str.maketrans('-0123456789', '⁻⁰¹²³⁴⁵⁶⁷⁸⁹')
"""Superscripts of exponents."""


def number(x: float) -> str:
    """Return a number in two digits.

    Parameters
    ----------
    x : float
        The number.

    Returns
    -------
    str
        As 0.03, 4.2·10⁻⁹ or 4321; whole from 100 to 99 999, `beyond computing` for ∞, else `–`.
    """
    if not np.isfinite(x):
        return 'beyond computing' if x > 0 else '–'
    if x == 0 or 0.001 <= abs(x) < 1e5:
        text = f'{x:.2g}' if abs(x) < 100 else f'{x:.0f}'
    else:
        digits, exponent = f'{x:.1e}'.split('e')
        text = digits.removesuffix('.0') + _power(int(exponent))
    return text.replace('-', '−')


def _power(exponent: int) -> str:
    return f'·10{str(exponent).translate(_RAISED)}'


def interval(name: str, estimate: Estimate) -> str:
    """Return an estimate with its 95 % interval, as `0.41 ± 0.06 µm/s`.

    If ± would mislead, the ends are given: `2.2 (1.5 to 4.3) mT`.

    Parameters
    ----------
    name : str
        Name whose suffix gives the unit.
    estimate : Estimate
        Estimate, SI.

    Returns
    -------
    str
        `–` if the value is not finite.
    """
    value, low, high = (
        float(from_si(name, x)) for x in (estimate.value, estimate.low, estimate.high))
    half = (high - low) / 2
    if not np.isfinite(value):
        return '–'
    if not estimate.is_even and not np.isnan(half):
        ends = ' to '.join(number(end) if np.isfinite(end) else '∞' for end in (low, high))
        return f'{number(value)} ({ends}) {symbol(name)}'.strip()
    if not (np.isfinite(half) and half > 0):
        return f'{number(value)} {symbol(name)}'.strip()
    text = _within(value, half)
    exponent = int(np.floor(np.log10(max(abs(value), half))))
    if not -2 <= exponent < 5:
        text = f'({_within(value / 10.0**exponent, half / 10.0**exponent)}){_power(exponent)}'
    return f'{text} {symbol(name)}'.strip().replace('-', '−')


def _within(value: float, half: float) -> str:
    """Return value ± half-width with as many digits as the interval justifies, at most six."""
    digits = min(max(0, 1 - int(np.floor(np.log10(half)))), 6)
    return f'{value:.{digits}f} ± {half:.{digits}f}'


def chance(p: float) -> str:
    """Return a p-value as text.

    Parameters
    ----------
    p : float
        The p-value.

    Returns
    -------
    str
        As `p = 0.03`, or `p < 10⁻³⁰⁰` up to LEAST.
    """
    return f'p = {number(p)}' if p > LEAST else 'p < 10⁻³⁰⁰'


def odds(log_evidence: float) -> str:
    """Return the odds of a log Bayes factor as text.

    Parameters
    ----------
    log_evidence : float
        Natural log of the odds.

    Returns
    -------
    str
        As `230 times`, or `more than 10³⁰⁰ times`.
    """
    return (f'{number(float(np.exp(log_evidence)))} times' if log_evidence < -np.log(LEAST) else
            'more than 10³⁰⁰ times')


def words(identifier: str) -> str:
    """Return an identifier in words.

    Parameters
    ----------
    identifier : str
        As `uniform_drift`.

    Returns
    -------
    str
        As `uniform drift`.
    """
    return identifier.replace('_', ' ')


def listed(identifiers: list[str]) -> str:
    """Return several identifiers as a list in words.

    Parameters
    ----------
    identifiers : list of str
        At least one.

    Returns
    -------
    str
        As `a`, `a and b` or `a, b and c`.
    """
    *head, last = map(words, identifiers)
    return f'{", ".join(head)} and {last}' if head else last


def bare(name: str) -> str:
    """Return the name of a parameter without its unit, in words.

    Parameters
    ----------
    name : str
        As `tau_s`.

    Returns
    -------
    str
        As `tau`.
    """
    return words(units.bare(name))


def term(effect_id: str) -> list[str]:
    """Return the docstring of an effect: what it adds to the equations.

    Parameters
    ----------
    effect_id : str
        Id of the effect.

    Returns
    -------
    list of str
        Paragraphs.
    """
    return (inspect.getdoc(EFFECTS[effect_id]) or '').replace('`', '').split('\n\n')


def limit(found: Limit) -> str:
    """Return the upper limit of a parameter as text.

    Parameters
    ----------
    found : Limit
        The limit, SI.

    Returns
    -------
    str
        As `up to 0.1 µm/s` or `900 s or longer`.
    """
    parameter, unit = found.parameter, symbol(found.parameter.name)
    if not np.isfinite(found.limit):
        return 'not bounded by these data'
    null_value = float(parameter.display_units(parameter.null_value))
    value = float(parameter.display_units(found.limit))
    if parameter.inverse:
        return f'{number(value)} {unit} or longer'
    if null_value:
        return f'within {null_value:g} ± {number(abs(value - null_value))} {unit}'.strip()
    return f'up to {number(abs(value))} {unit}'.strip()


def versions() -> dict[str, str]:
    """Return the versions of the software that computed the report.

    Returns
    -------
    dict of str to str
        Version by package.
    """
    return {'microbot_ros': __version__} | {
        package: version(package) for package in ('numpy', 'scipy', 'numba')}
