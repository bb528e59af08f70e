"""Spread of estimates between sessions, in addition to the error of each session.

Session i gives y_i = μ + a_i + e_i with a known variance s_i² of e_i; a_i, its own deviation, has
the variance τ² between sessions. τ² is where Cochran's Q with weights 1/(s_i² + τ²) has its
expectation k − 1 (Paule and Mandel 1982), its interval where Q has the tails of χ² (Q-profile,
Viechtbauer 2007): exact for normal estimates. The mean has Hartung and Knapp's interval (2001).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.special import chdtrc, chdtri, stdtr, stdtrit

_TAIL = 0.025
"""Probability of each tail of a 95 % interval, by definition."""


@dataclass(frozen=True)
class Spread:
    """Mean and spread between sessions of one quantity, in its own unit.

    Values are infinite or NaN if the sessions are too few to determine them.

    Attributes
    ----------
    count : int
        Number of sessions.
    mean : float
        Mean.
    mean_std : float
        Standard deviation of the mean.
    mean_low : float
        Lower end of its 95 % interval.
    mean_high : float
        Upper end.
    between : float
        Standard deviation between sessions.
    between_low : float
        Lower end of its 95 % interval.
    between_high : float
        Upper end.
    within : float
        Usual standard deviation of the estimate of one session.
    p_value : float
        Probability of so much scatter without a spread between sessions.
    """

    count: int
    mean: float
    mean_std: float
    mean_low: float
    mean_high: float
    between: float
    between_low: float
    between_high: float
    within: float
    p_value: float


def spread(values: np.ndarray, stds: np.ndarray) -> Spread | None:
    """Return mean and spread of values; values that are not finite or have no error are left out.

    Parameters
    ----------
    values : ndarray, shape (K,)
        Values.
    stds : ndarray, shape (K,)
        Standard deviations of the values.

    Returns
    -------
    Spread or None
        None if no value remains.
    """
    known = np.isfinite(values) & np.isfinite(stds) & (stds > 0)
    y, s = values[known], stds[known]
    k = len(y)
    if not k:
        return None
    within = float(np.sqrt(np.median(s**2)))
    if k == 1:
        half = 1.96 * float(s[0])
        return Spread(1, float(y[0]), float(s[0]), float(y[0]) - half, float(y[0]) + half,
                      np.nan, 0.0, np.inf, within, np.nan)
    variance = between_variance(y, s)
    low, high = (_variance_where(y, s, float(chdtri(k - 1, tail)))
                 for tail in (_TAIL, 1 - _TAIL))
    mean, std = mean_of(y, s, variance)
    half = std * float(-stdtrit(k - 1, _TAIL))
    return Spread(k, mean, std, mean - half, mean + half, float(np.sqrt(variance)),
                  float(np.sqrt(low)), float(np.sqrt(high)), within,
                  float(chdtrc(k - 1, _q(y, s, 0.0))))


def between_variance(values: np.ndarray, stds: np.ndarray) -> float:
    """Return Paule and Mandel's variance between values, beyond that of their errors.

    Parameters
    ----------
    values : ndarray, shape (K,)
        Values.
    stds : ndarray, shape (K,)
        Standard deviations of the values.

    Returns
    -------
    float
        The variance.
    """
    return _variance_where(values, stds, len(values) - 1)


def mean_of(values: np.ndarray, stds: np.ndarray, variance: float) -> tuple[float, float]:
    """Return the weighted mean of values.

    Parameters
    ----------
    values : ndarray, shape (K,)
        Values.
    stds : ndarray, shape (K,)
        Standard deviations of the values.
    variance : float
        Variance between the values.

    Returns
    -------
    tuple[float, float]
        The mean, and its standard deviation by Hartung and Knapp, not below that of the weights
        alone.
    """
    weight = 1 / (stds**2 + variance)
    mean = float((weight * values).sum() / weight.sum())
    ratio = _q(values, stds, variance) / max(len(values) - 1, 1)
    return mean, float(np.sqrt(max(ratio, 1.0) / weight.sum()))


def _q(y: np.ndarray, s: np.ndarray, variance: float) -> float:
    """Return Cochran's Q, which decreases with `variance`."""
    weight = 1 / (s**2 + variance)
    mean = (weight * y).sum() / weight.sum()
    return float((weight * (y - mean) ** 2).sum())


def _variance_where(y: np.ndarray, s: np.ndarray, q: float) -> float:
    """Return the variance between sessions at which Q is `q`; 0 if Q is less without variance."""
    if _q(y, s, 0.0) <= q:
        return 0.0
    high = float(np.var(y) + s.max() ** 2)
    while _q(y, s, high) > q:
        high *= 4
    # Variances in SI are tiny, so solve for the share of the largest.
    return high * float(brentq(lambda share: _q(y, s, share * high) - q, 0.0, 1.0, xtol=1e-12))


@dataclass(frozen=True)
class Trend:
    """A linear trend.

    Attributes
    ----------
    slope : float
        Slope per unit of time.
    std : float
        Its standard deviation.
    p_value : float
        Its probability without any trend.
    """

    slope: float
    std: float
    p_value: float


def trend(times: np.ndarray, values: np.ndarray, stds: np.ndarray) -> Trend | None:
    """Fit a straight line to values.

    Sessions scatter about it with a variance of their own, estimated by moments (DerSimonian and
    Laird 1986, for a regression), and the test is that of Knapp and Hartung (2003).

    Parameters
    ----------
    times : ndarray, shape (K,)
        Times.
    values : ndarray, shape (K,)
        Values.
    stds : ndarray, shape (K,)
        Standard deviations of the values.

    Returns
    -------
    Trend or None
        None with fewer than five sessions, or if all are at one time.
    """
    known = np.isfinite(times) & np.isfinite(values) & np.isfinite(stds) & (stds > 0)
    x, y, s = times[known], values[known], stds[known]
    if len(x) < 5 or np.ptp(x) == 0:
        return None
    columns = np.column_stack([np.ones(len(x)), x - x.mean()])
    variance = _residual_variance(columns, y, s)
    weight = 1 / (s**2 + variance)
    information = columns.T * weight @ columns
    line = np.linalg.solve(information, columns.T @ (weight * y))
    free = len(x) - 2
    ratio = max(float((weight * (y - columns @ line) ** 2).sum()) / free, 1.0)
    std = float(np.sqrt(ratio * np.linalg.inv(information)[1, 1]))
    return Trend(float(line[1]), std, float(2 * stdtr(free, -abs(line[1]) / std)))


def _residual_variance(columns: np.ndarray, y: np.ndarray, s: np.ndarray) -> float:
    weight = 1 / s**2
    information = columns.T * weight @ columns
    line = np.linalg.solve(information, columns.T @ (weight * y))
    q = float((weight * (y - columns @ line) ** 2).sum())
    absorbed = np.trace(np.linalg.solve(information, columns.T * weight**2 @ columns))
    return max(0.0, (q - (len(y) - columns.shape[1])) / float(weight.sum() - absorbed))


def unlike(values: np.ndarray, stds: np.ndarray) -> np.ndarray:
    """Return the probability that each value is as far from all the others by chance.

    Mean and spread are those of the others, which an outlier would distort. It is for one value at
    a time: a caller that tests K values must correct for it.

    Parameters
    ----------
    values : ndarray, shape (K,)
        Values.
    stds : ndarray, shape (K,)
        Standard deviations of the values.

    Returns
    -------
    ndarray, shape (K,)
        Probabilities; NaN for values that are not finite, and for fewer than five values.
    """
    chances = np.full(len(values), np.nan)
    known = np.flatnonzero(np.isfinite(values) & np.isfinite(stds) & (stds > 0))
    if len(known) < 5:
        return chances
    for one in known:
        rest = known[known != one]
        y, s = values[rest], stds[rest]
        variance = between_variance(y, s)
        mean, std = mean_of(y, s, variance)
        off = abs(values[one] - mean) / np.sqrt(stds[one] ** 2 + variance + std**2)
        chances[one] = 2 * stdtr(len(rest) - 1, -off)
    return chances
