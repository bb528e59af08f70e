"""Tail probabilities of χ², exact also where they underflow."""

from __future__ import annotations

import math


def log_chi_square_tail(chi_square: float, dof: int) -> float:
    """Return the natural log of P(χ² > x), exact where P itself underflows.

    Uses the asymptotic series of the incomplete gamma function there (DLMF 8.11.2).

    Parameters
    ----------
    chi_square : float
        x.
    dof : int
        Degrees of freedom.

    Returns
    -------
    float
        log P.
    """
    from scipy.special import gammaincc, gammaln

    a, z = dof / 2, max(chi_square, 0.0) / 2
    chi_square_tail = float(gammaincc(a, z))
    if chi_square_tail > 1e-280:
        return math.log(chi_square_tail)
    # The asymptotic series of the incomplete gamma function (DLMF 8.11.2).
    series = 1 + (a - 1) / z * (1 + (a - 2) / z)
    return (a - 1) * math.log(z) - z - float(gammaln(a)) + math.log(series)


def chi_square_tail(chi_square: float, dof: int) -> float:
    """Return P(χ² > x).

    Parameters
    ----------
    chi_square : float
        x.
    dof : int
        Degrees of freedom.

    Returns
    -------
    float
        P.
    """
    return math.exp(log_chi_square_tail(chi_square, dof))


def log_of_any(log_p: float, trials: float) -> float:
    """Return log(1 − (1 − p)ⁿ), of at least one such event in n independent trials.

    Parameters
    ----------
    log_p : float
        Natural log of p.
    trials : float
        n.

    Returns
    -------
    float
        Natural log of the probability.
    """
    if log_p < -30:
        return log_p + math.log(trials)
    if log_p >= 0:
        return 0.0
    return math.log(-math.expm1(trials * math.log1p(-math.exp(log_p))))


def peak_tail_probability(power: float, dof: int, cycles: float) -> float:
    """Return the probability that the highest peak of a periodogram exceeds a power by chance.

    From the rate at which such a smooth process crosses a level upwards (Davies 1987; for
    periodograms Baluev 2008): W z^{(k−1)/2} e^{−z}/Γ(k/2) with z = power/2.

    Parameters
    ----------
    power : float
        The level, χ² of `dof` at one frequency.
    dof : int
        k: 2 or 4.
    cycles : float
        Bandwidth times duration.

    Returns
    -------
    float
        Probability, at most 1.
    """
    z = power / 2
    crossings = cycles * math.sqrt(math.pi / 3) * z ** ((dof - 1) / 2) / math.gamma(dof / 2)
    return min(1.0, crossings * math.exp(-z) + chi_square_tail(power, dof))
