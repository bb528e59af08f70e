"""Whether one half of the recordings foretells the other by an effect.

Where an effect stands in for another cause, as for one that changes in time or differs between
particles, what one half says of it may be worse for the other half than no effect at all.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.special import logsumexp

from microbot_ros.discovery.hypotheses import prior_widths
from microbot_ros.estimation.likelihood.joint import eliminate, inner
from microbot_ros.estimation.likelihood.model_fit import ModelFit

CONTRADICTED = -3.0
"""Log odds for an effect in one half, given the other, below which it is not established.

Choice: odds of 20 to 1. Of 71 true names in simulated recordings the least had −3.8, −1.2 and
−0.4. Of 24 effects that stood in for another cause five had −6 or less, three −0.4 to −0.2 and the
others 3 and more. A smaller value keeps more of these, 0 loses true ones that one half hardly
shows.
"""


def foretold(fit: ModelFit, name: str) -> float:
    """Return the evidence for an effect in one half of the recordings, given the other half.

    It is log B of both halves less log B of one, with Bayes factors for the effect. Every track
    has its own v and φ in each half. Other effects and shapes stay as fitted. The likelihood is a
    parabola about the fit.

    Parameters
    ----------
    fit : ModelFit
        Fit with the effect.
    name : str
        Id of the effect.

    Returns
    -------
    float
        The least over halves of the time and, of several particles, halves of the particles. Near
        0 where one half cannot show the effect.
    """
    own = np.array([one == name and not p.shape for one, p in fit.model.parameters])
    x, widths = fit.model.vector()[own], prior_widths(name)
    least = np.inf
    for halves in _halves(fit, own):
        both, *each = (_log_bayes_factor(products, x, widths)
                       for products in (halves.sum(axis=0), *halves))
        least = min(least, both - max(each))
    return least


def _halves(fit: ModelFit, own: np.ndarray) -> Iterator[np.ndarray]:
    """Yield inner products (2, 1 + S, 1 + S) of residual and S derivatives in two halves.

    First halves of the time, then, of several particles, every other one. Derivatives are by the
    `own` parameters, with v and φ eliminated.
    """
    size = 1 + np.count_nonzero(own)
    in_time, among_particles = np.zeros((2, 2, size, size))
    count = 0
    for p, jacobian in zip(fit.session_fits, fit.jacobian, strict=True):
        columns = np.concatenate([p.white / np.sqrt(p.diffusion), jacobian[..., own]], axis=-1)
        middle = len(columns) // 2
        in_time += [eliminate(inner(part)).sum(axis=0)
                    for part in (columns[:middle], columns[middle:])]
        particles, number = np.unique(p.session.ids, return_inverse=True)
        tracks = eliminate(inner(columns))
        among_particles += [tracks[(count + number) % 2 == k].sum(axis=0) for k in (0, 1)]
        count += len(particles)
    yield in_time
    if count > 1:
        yield among_particles


def _log_bayes_factor(products: np.ndarray, x: np.ndarray, widths: np.ndarray) -> float:
    """Return the log Bayes factor for strengths fitted as `x` (S,), with priors of `widths`.

    `products` (1 + S, 1 + S) are those of residual and derivatives in a part of the data.
    """
    information, slope = products[1:, 1:], products[1:, 0]
    from_zero = slope + information @ x
    logs = []
    for width in widths:
        wide = np.eye(len(x)) + width**2 * information
        logs.append(0.5 * (width**2 * from_zero @ np.linalg.solve(wide, from_zero)
                           - np.linalg.slogdet(wide)[1]))
    return float(logsumexp(logs) - np.log(len(logs)))
