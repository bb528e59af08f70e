"""Effects that recur over an archive: their sessions, and the spread of their parameters.

Session i estimates the parameters of an effect as y_i ± s_i, and the effect has the likelihood
ratio exp(LR_i/2) there. A share π of the sessions has the effect, with parameters that are normal
about μ with variances τ² between sessions; the others do not have it. The odds of session i are
then

    π/(1 − π) · exp(LR_i/2) · Π √(s_i²/(s_i² + τ²)) · exp(−(y_i − μ)²/2(s_i² + τ²))

with π, μ, τ² fitted to all sessions in alternation (two-groups model, Efron 2008; empirical
Bayes). So a weak session is judged with the knowledge of the others, and "absent" means that an
effect of that size would have been seen.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import bdtrc, chdtri

from microbot_ros.archive.conclusions.random_effects import Spread, spread
from microbot_ros.common.units import bare, symbol
from microbot_ros.discovery.report.words import listed
from microbot_ros.model.effects import EFFECTS
from microbot_ros.model.parameter import Parameter

SURE = 0.95
"""Probability from which an effect is called present in a session; one minus it for absent.
Choice: the usual 95 %."""

BY_CHANCE = 0.01
"""Probability per session of a wrong name, as guaranteed by `discover`."""

WORTH = float(np.log(20))
"""Gain in log likelihood over all sessions, less the price of parameters, that an effect must
bring. Choice: odds of 20 to 1."""

VARIES = 0.01
"""Probability below which a parameter is said to vary between sessions. Choice: the 1 % of the
other tests."""

_ROUNDS = 50
"""Largest number of alternations. Choice: ends a case that does not converge; more cost little."""

Results = Mapping[str, dict[str, Any]]
"""Result of a job by session."""


@dataclass(frozen=True)
class Recurring:
    """An effect over an archive.

    Attributes
    ----------
    id : str
        Its id.
    probability : dict of str to float
        Probability that it is present, by session.
    unseen : tuple of str
        Sessions that cannot show it.
    parameters : dict of str to Spread
        Spread of each parameter between the sessions that have it, in the unit of its name; if the
        effect vanishes at infinity that of the reciprocal. Angles of a shape are left out.
    estimates : dict[str, dict[str, tuple[float, float]]]
        {parameter: {session: (value, standard deviation)}} in the same units, of the sessions that
        determine it.
    """

    id: str
    probability: dict[str, float]
    unseen: tuple[str, ...]
    parameters: dict[str, Spread]
    estimates: dict[str, dict[str, tuple[float, float]]]

    @property
    def present(self) -> list[str]:
        """Sessions that have it."""
        return [name for name, p in self.probability.items() if p >= SURE]

    @property
    def absent(self) -> list[str]:
        """Sessions that would show it if they had it."""
        return [name for name, p in self.probability.items() if p <= 1 - SURE]

    @property
    def undecided(self) -> list[str]:
        """Sessions that do not decide."""
        told = {*self.present, *self.absent}
        return [*(name for name in self.probability if name not in told), *self.unseen]

    @property
    def varying(self) -> list[str]:
        """Parameters that differ between sessions by more than their errors."""
        return [name for name, found in self.parameters.items()
                if found.p_value * len(self.parameters) < VARIES]

    def unit(self, name: str) -> str:
        """Return the unit in which a parameter is given here.

        Parameters
        ----------
        name : str
            Name of the parameter.

        Returns
        -------
        str
            The unit.
        """
        of = next(p for p in EFFECTS[self.id].parameters() if p.name == name)
        return f'1/({symbol(name)})' if of.inverse else symbol(name)

    def sentence(self) -> str:
        """Return the sessions of the effect, and whether its parameters are common, as text.

        Returns
        -------
        str
            The sentence.
        """
        known = len(self.probability) + len(self.unseen)
        where = ('in the only session' if len(self.present) == known == 1 else
                 f'in all {known} sessions' if len(self.present) == known else
                 f'in {len(self.present)} of {known} sessions')
        if self.undecided:
            where += f' ({len(self.undecided)} cannot decide)'
        if len(self.present) < 2:
            return f'{self.id} {where}.'
        how = 'with common parameters'
        if self.varying:
            vary = 'varies' if len(self.varying) == 1 else 'vary'
            how = f'its {listed(list(map(bare, self.varying)))} {vary} by session'
        return f'{self.id} {where}, {how}.'


def candidates_for_all(results: Results) -> list[str]:
    """Return the effects to measure in every complete session.

    These are effects that are established in more sessions than by chance. Proxies do not count as
    names.

    Parameters
    ----------
    results : Results
        Results of `discover` by session.

    Returns
    -------
    list of str
        Ids of the effects.
    """
    known = [one for one in results.values() if is_complete(one)]
    named = Counter(effect['id'] for one in known for effect in one['result']['effects']
                    if effect['status'] == 'established')
    return sorted(name for name, count in named.items()
                  if len(known) < 3 or bdtrc(count - 1, len(known), BY_CHANCE) < BY_CHANCE)


def is_complete(result: dict[str, Any]) -> bool:
    """Return whether a result explains its session: only then do its effects count.

    Parameters
    ----------
    result : dict of str to object
        Result of `discover`.

    Returns
    -------
    bool
        Whether it does.
    """
    return 'result' in result and result['result'].get('verdict') != 'unnamed'


def proxies(results: Results) -> dict[str, list[str]]:
    """Return the sessions in which each effect only stands for an unnamed one.

    Parameters
    ----------
    results : Results
        Results of `discover` by session.

    Returns
    -------
    dict of str to list of str
        Sessions by effect, the effect with most sessions first.
    """
    found: dict[str, list[str]] = {}
    for session, one in results.items():
        for effect in one.get('result', {}).get('effects', ()):
            if effect['status'] == 'proxy':
                found.setdefault(effect['id'], []).append(session)
    return dict(sorted(found.items(), key=lambda item: -len(item[1])))


def common_reference(results: Results) -> float:
    """Return the field at which alignment times are stated: that of most sessions.

    Parameters
    ----------
    results : Results
        Results of `discover` by session.

    Returns
    -------
    float
        Field [T].
    """
    return Counter(one['reference_field'] for one in results.values()
                   if 'reference_field' in one).most_common(1)[0][0]


def recurring_effects(measured: Results) -> list[Recurring]:
    """Return the effects that an archive as a whole has, the most certain first.

    Parameters
    ----------
    measured : Results
        Results of `measure` by session.

    Returns
    -------
    list of Recurring
        The effects.
    """
    names = sorted({name for one in measured.values() for name in one.get('effects', {})})
    found = [both for name in names if (both := _recurring(name, measured))]
    return [one for _, one in sorted(found, key=lambda both: -both[0])]


def _recurring(effect: str, measured: Results) -> tuple[float, Recurring] | None:
    """Return an effect and its gain over all sessions; None if the gain is too small."""
    told = {name: one['effects'].get(effect) for name, one in measured.items()
            if 'effects' in one}
    parameters = EFFECTS[effect].parameters()
    asked = {name: np.array([one['parameters'][p.name] for p in parameters], float)
             for name, one in told.items() if one}
    for x_std in asked.values():
        x_std[_undetermined(parameters, x_std[:, 1]), 1] = np.inf
    seen = {name: told[name] for name, x_std in asked.items() if np.isfinite(x_std[:, 1]).any()}
    if not seen:
        return None
    both = np.array([asked[name] for name in seen])
    ratio = np.array([one['likelihood_ratio'] for one in seen.values()])
    angle = np.array([p.is_angle for p in parameters])
    probability, gain = _two_groups(both[..., 0], both[..., 1], ratio, angle)
    if gain < WORTH:
        return None
    estimates: dict[str, dict[str, tuple[float, float]]] = {}
    spreads: dict[str, Spread] = {}
    has = probability >= SURE if (probability >= SURE).any() else probability >= 0.5
    for k, parameter in enumerate(parameters):
        if parameter.is_angle:
            continue
        values, stds = _in_units(parameter, both[:, k, 0], both[:, k, 1])
        estimates[parameter.name] = {name: (float(v), float(s)) for name, v, s in zip(
            seen, values, stds, strict=True) if np.isfinite(s)}
        if (one := spread(values[has], stds[has])) is not None:
            spreads[parameter.name] = one
    return gain, Recurring(
        effect, dict(zip(seen, probability.tolist(), strict=True)),
        tuple(name for name in told if name not in seen), spreads, estimates)


def _undetermined(parameters: tuple[Parameter, ...], std: np.ndarray) -> np.ndarray:
    """Return which parameters (P,) a session does not determine, by their `std` (P,).

    Those are null, or tell no more than that the parameter is within its bounds: a uniform
    distribution there has a standard deviation of their distance over √12.
    """
    bounds = np.array([parameter.fit_bounds for parameter in parameters])
    wide: np.ndarray = np.isnan(std) | (std >= np.ptp(bounds, axis=1) / np.sqrt(12))
    return wide


def _in_units(parameter: Parameter, x: np.ndarray, std: np.ndarray,
              ) -> tuple[np.ndarray, np.ndarray]:
    """Return fit coordinates (K,) in units for people; of a reciprocal the reciprocal."""
    unit = float(parameter.display_units(1.0))
    if parameter.inverse:
        return x / (parameter.scale * unit), std / (parameter.scale * unit)
    return (parameter.null_value + x * parameter.scale) * unit, std * parameter.scale * unit


def _two_groups(x: np.ndarray, std: np.ndarray, ratio: np.ndarray, angle: np.ndarray,
                ) -> tuple[np.ndarray, float]:
    """Return the probability (N,) that each session has the effect, and the gain over no effect.

    It uses estimates `x` (N, P) with `std` (N, P) and the likelihood `ratio` (N,). An `angle` (P,)
    has a uniform prior.
    """
    count = len(x)
    # An angle is known to its error, as a part of a turn.
    blind = np.minimum(np.log(std[:, angle] / np.sqrt(2 * np.pi)), 0.0).sum(axis=1)
    y, s = x[:, ~angle], std[:, ~angle]
    probability = np.where(ratio > chdtri(max(x.shape[1], 1), 1e-3), 1.0, 0.0)
    if not probability.any():
        probability[:] = 1.0
    gain = -np.inf
    for _ in range(_ROUNDS):
        has = probability >= 0.5
        # Laplace's rule of succession: a session that tells nothing is not decided by the others
        # of a small archive.
        share = (float(probability.sum()) + 1) / (count + 2)
        log_bayes = ratio / 2 + blind + _fitting(y, s, has)
        log_odds = np.log(share / (1 - share)) + log_bayes
        before, probability = probability, 1 / (1 + np.exp(-np.clip(log_odds, -700, 700)))
        gain = float(np.logaddexp(np.log(share) + log_bayes, np.log1p(-share)).sum())
        if np.abs(probability - before).max() < 1e-6 or not (probability >= 0.5).any():
            break
    # Mean and spread of each parameter, and the share, were fitted.
    return probability, gain - (2 * y.shape[1] + 1) / 2 * np.log(count)


def _fitting(y: np.ndarray, s: np.ndarray, has: np.ndarray) -> np.ndarray:
    """Return the log (N,) of how well estimates agree with those of sessions with the effect.

    It is relative to their agreement with themselves. `y` and `s` (N, P); `has` (N,), at least
    one.
    """
    result = np.zeros(len(y))
    for values, stds in zip(y.T, s.T, strict=True):
        of = spread(values[has], stds[has])
        if of is None:
            continue  # determined in no session that has it
        # One session does not determine the spread: take the size of the effect.
        between = of.between if np.isfinite(of.between) else abs(of.mean)
        # An infinite error brings nothing, and costs nothing.
        beyond = between**2 + of.mean_std**2
        result -= np.log1p(beyond / stds**2) / 2 + (values - of.mean)**2 / 2 / (stds**2 + beyond)
    return result
