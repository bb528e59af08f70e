"""How the report writes numbers, intervals, chances, limits and names."""

from __future__ import annotations

import inspect
from importlib.metadata import version

import numpy as np

from microbot_ros import __version__
from microbot_ros.common.units import from_si, suffix, symbol
from microbot_ros.discovery.result import Estimate, Limit
from microbot_ros.model.effects import EFFECTS

LEAST = 1e-300
"""Chances below and odds above 1/LEAST are beyond what floating point can tell apart."""

_RAISED = str.maketrans('-0123456789', '⁻⁰¹²³⁴⁵⁶⁷⁸⁹')


def number(x: float) -> str:
    """`x` in two digits: 0.03, 4.2·10⁻⁹ with its power, larger ones whole up to 99 999."""
    if not np.isfinite(x):
        return 'beyond computing' if x > 0 else '–'
    if x == 0 or 0.001 <= abs(x) < 1e5:
        text = f'{x:.2g}' if abs(x) < 100 else f'{x:.0f}'
    else:
        digits, exponent = f'{x:.1e}'.split('e')
        text = digits.removesuffix('.0') + _power(int(exponent))
    return text.replace('-', '−')


def _power(exponent: int) -> str:
    return f'·10{exponent}'.replace(str(exponent), str(exponent).translate(_RAISED))


def interval(name: str, estimate: Estimate) -> str:
    """An `estimate` with its 95 % interval in the unit of its `name`: `0.41 ± 0.06 µm/s`.

    Where that would mislead, with its ends: `2.2 (1.5 to 4.3) mT`.
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
    """As many digits of the value as the interval gives sense to, six at most."""
    digits = min(max(0, 1 - int(np.floor(np.log10(half)))), 6)
    return f'{value:.{digits}f} ± {half:.{digits}f}'


def chance(p: float) -> str:
    """A p-value `p` as people write it: `p = 0.03`, `p < 10⁻³⁰⁰` where it can't be computed."""
    return f'p = {number(p)}' if p > LEAST else 'p < 10⁻³⁰⁰'


def odds(log_evidence: float) -> str:
    """How many times as likely something is, of its `log_evidence`."""
    return (f'{number(float(np.exp(log_evidence)))} times' if log_evidence < -np.log(LEAST) else
            'more than 10³⁰⁰ times')


def words(identifier: str) -> str:
    """An `identifier` such as `uniform_drift` as people write it."""
    return identifier.replace('_', ' ')


def listed(identifiers: list[str]) -> str:
    """One or more `identifiers` as people list them: `a`, `a and b`, `a, b and c`."""
    *head, last = map(words, identifiers)
    return f'{", ".join(head)} and {last}' if head else last


def bare(name: str) -> str:
    """The `name` of a parameter without its unit: `tau_s` is `tau`."""
    return words(name.removesuffix(suffix(name)))


def term(effect_id: str) -> list[str]:
    """What the effect `effect_id` adds to the equations, in paragraphs."""
    return (inspect.getdoc(EFFECTS[effect_id]) or '').replace('`', '').split('\n\n')


def limit(found: Limit) -> str:
    """Where a parameter may still be, as `found`: `up to 0.1 µm/s`, `900 s or longer`."""
    parameter, unit = found.parameter, symbol(found.parameter.name)
    if not np.isfinite(found.upper_limit):
        return 'not bounded by these data'
    null_value = float(parameter.display_units(parameter.null_value))
    value = float(parameter.display_units(found.upper_limit))
    if parameter.inverse:
        return f'{number(value)} {unit} or longer'
    if null_value:
        return f'within {null_value:g} ± {number(abs(value - null_value))} {unit}'.strip()
    return f'up to {number(abs(value))} {unit}'.strip()


def versions() -> dict[str, str]:
    """What computed the report."""
    return {'microbot_ros': __version__} | {
        package: version(package) for package in ('numpy', 'scipy', 'numba')}
