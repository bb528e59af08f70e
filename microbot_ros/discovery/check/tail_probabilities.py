"""How likely χ² is to be as large by chance, however unlikely that is."""

from __future__ import annotations

import math


def log_chi_square_tail(chi_square: float, dof: int) -> float:
    """Natural log of P(χ² > `chi_square`) for `dof`, exact where P itself underflows."""
    from scipy.special import gammaincc, gammaln

    a, z = dof / 2, max(chi_square, 0.0) / 2
    chi_square_tail = float(gammaincc(a, z))
    if chi_square_tail > 1e-280:
        return math.log(chi_square_tail)
    # The asymptotic series of the incomplete gamma function (DLMF 8.11.2).
    series = 1 + (a - 1) / z * (1 + (a - 2) / z)
    return (a - 1) * math.log(z) - z - float(gammaln(a)) + math.log(series)


def chi_square_tail(chi_square: float, dof: int) -> float:
    """P(χ² > `chi_square`) for `dof` degrees of freedom."""
    return math.exp(log_chi_square_tail(chi_square, dof))


def log_of_any(log_p: float, trials: float) -> float:
    """Log of 1 − (1 − p)^`trials` from `log_p`: one such by chance among independent trials."""
    if log_p < -30:
        return log_p + math.log(trials)
    if log_p >= 0:
        return 0.0
    return math.log(-math.expm1(trials * math.log1p(-math.exp(log_p))))


def peak_tail_probability(power: float, dof: int, cycles: float) -> float:
    """P of a periodogram's highest peak, χ² of `dof` 2 or 4 at one frequency, to exceed `power`.

    `cycles` is bandwidth times duration. By the rate at which so smooth a process crosses a level
    upwards (Davies 1987; for periodograms Baluev 2008): W z^{(k−1)/2} e^{−z}/Γ(k/2), z = power/2.
    """
    z = power / 2
    crossings = cycles * math.sqrt(math.pi / 3) * z ** ((dof - 1) / 2) / math.gamma(dof / 2)
    return min(1.0, crossings * math.exp(-z) + chi_square_tail(power, dof))
