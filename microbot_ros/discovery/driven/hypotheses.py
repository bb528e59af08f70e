"""What could still be: models on what was seen so far, and how the odds between them stand.

The evidence for an effect is a Bayes factor against the model without it. v, φ and D of both have
the same flat prior and are taken at their maximum (`estimation.likelihood`). The effect's
strengths x, in fit coordinates, are normal about nothing with a standard deviation s that is
itself not known: one of SCALES, all alike. With x̂ the maximum, H its information beside all that
is fitted besides and LR the likelihood ratio, the integral over x (Laplace's method, exact where
x acts linearly) gives for each s

    log B = ½ LR − ½ log |1 + s² H| − ½ x̂ᵀ H (1 + s² H)⁻¹ x̂.

A shape (a place, a width, a frequency) is spread evenly over the independent ones it was looked
for at, `Effect.trials`, and within each over a peak that is narrower the more it rises:
− log(trials) − ½ d log(1 + LR) for d numbers.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from microbot_ros.discovery.search import CandidateFit, compare
from microbot_ros.discovery.stepwise_selection import CLEARLY, search, without
from microbot_ros.estimation.model_fit import ModelFit, fit_sessions
from microbot_ros.estimation.prepared_session import PreparedSession
from microbot_ros.model.effects import EFFECTS
from microbot_ros.model.model import Model

SCALES = np.geomspace(0.01, 10.0, 7)
"""Standard deviations of strengths, in fit coordinates, where a typical size is 1."""

MOST = 3
"""Effects in a model: what seems to need more needs another library."""

WORTH = 1.0
"""Gain in log odds from which an effect is taken into the model, to look on beside it."""

LIKELIER = 0.5
"""Log odds by which a rival must be ahead, to take an effect's place: twins stay where they are.
"""


def log_bayes_factor(found: CandidateFit) -> float:
    """Natural log of the odds that what was seen gives an effect, against the fit without it."""
    information, _, visible = found.fit.normal
    parameters = found.fit.model.parameters
    own = np.array([name == found.id and not p.shape for name, p in parameters]) & visible
    rest = np.array([name != found.id for name, _ in parameters]) & visible
    x = found.fit.model.vector()[own]
    cross = information[np.ix_(own, rest)]
    left = information[np.ix_(own, own)] - cross @ np.linalg.pinv(
        information[np.ix_(rest, rest)], hermitian=True) @ cross.T
    power, axes = np.linalg.eigh(left)
    power, along = np.maximum(power, 0.0), axes.T @ x
    spread = 1 + SCALES[:, None] ** 2 * power
    logs = -0.5 * (np.log(spread) + along**2 * power / spread).sum(axis=1)
    gain = max(found.likelihood_ratio, 0.0)
    shapes = sum(p.shape for name, p in parameters if name == found.id)
    return float(gain / 2 + logsumexp(logs) - np.log(len(SCALES)) - np.log(found.trials)
                 - shapes / 2 * np.log1p(gain))


@dataclass(frozen=True)
class Candidate:
    """A fit with an effect, `found`, and its `evidence`: the log Bayes factor for it."""

    found: CandidateFit
    evidence: float

    @classmethod
    def of(cls, found: CandidateFit) -> Candidate:
        """With the evidence of what was `found`."""
        return cls(found, log_bayes_factor(found))

    @property
    def id(self) -> str:
        """The effect's name."""
        return self.found.id


@dataclass(frozen=True)
class Slot:
    """An effect of the model, `own`, and what could stand in its place, the `rivals`.

    All of them beside the same `rest`, the model's other effects: the likeliest first.
    """

    rest: ModelFit
    own: Candidate
    rivals: tuple[Candidate, ...]

    def behind(self, rival: Candidate) -> float:
        """By how much log evidence a `rival` is behind; infinite if it is none.

        The flank of a wide spot explains whatever a drift does: with more numbers and nothing
        more explained, or without a shape that shows, it is a rival only where it is likelier, or
        of what depends on place itself.
        """
        behind = self.own.evidence - rival.evidence
        own, other = self.own.found, rival.found
        told = EFFECTS[self.own.id].needs_position or (
            other.shape_seen and other.likelihood_ratio - own.likelihood_ratio
            >= 2 * max(other.dof - own.dof, 0))
        return behind if behind < 0 or told else np.inf


@dataclass(frozen=True)
class Hypotheses:
    """What could be behind what was seen so far.

    `fit` of the model that is taken for now, which may be without an effect; a slot for each of
    its effects; `more`: what could be there besides, the likeliest first.
    """

    fit: ModelFit
    slots: tuple[Slot, ...]
    more: tuple[Candidate, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """The effects of the model that is taken for now."""
        return tuple(slot.own.id for slot in self.slots)

    def odds(self) -> dict[str, float]:
        """The probability of each effect of the library to be there, and of none ('').

        Where effects compete for a place these add up to 1 with that of nothing in it, which
        counts as much as all of them together before anything was seen.
        """
        none = np.log(max(len(self.more) + len(self.slots), 1))
        result: dict[str, float] = {}
        nothing = 1.0
        groups = [(slot.own, *slot.rivals) for slot in self.slots]
        groups += [] if self.slots else [self.more]
        for group in groups:
            logs = np.array([none, *(one.evidence for one in group)])
            share = np.exp(logs - logsumexp(logs))
            nothing = min(nothing, float(share[0]))
            for one, part in zip(group, share[1:], strict=True):
                result[one.id] = max(result.get(one.id, 0.0), float(part))
        return {'': nothing} | result


def consider(session: PreparedSession, taken: Sequence[str] = ()) -> Hypotheses:
    """The hypotheses on what was seen so far, from those `taken` at the look before on.

    Effects are added while the odds are for them, dropped where they are not any more, and
    exchanged for rivals that became likelier.
    """
    model = Model.baseline(session.conditions, session.commands)
    fit = fit_sessions(model, [session])
    for name in taken:
        again = [one for one in _candidates(fit, [name]) if one.evidence > 0]
        fit = fit_sessions(again[0].found.fit.model, [session]) if again else fit
    for _ in range(2 * MOST + 2):
        slots = _slots(fit)
        better = _exchange(slots)
        if better is None:
            present = [effect.id for effect in fit.model.effects]
            more = _candidates(fit, [name for name in EFFECTS if name not in present])
            price = np.log(len(EFFECTS)) + WORTH
            if not more or more[0].evidence < price or len(present) >= MOST:
                break
            better = more[0].found.fit.model
        fit = fit_sessions(better, [session])
    return Hypotheses(fit, slots, more)


def _slots(fit: ModelFit) -> tuple[Slot, ...]:
    present = [effect.id for effect in fit.model.effects]
    slots = []
    for name in present:
        rest = without(fit, name)
        rivals = _candidates(rest, [other for other in EFFECTS if other not in present])
        slots.append(Slot(rest, Candidate.of(compare(fit, rest, name)), rivals))
    return tuple(slots)


def _exchange(slots: Sequence[Slot]) -> Model | None:
    """The model with an effect less that is not worth it, or with a likelier rival in its place.
    """
    for slot in slots:
        if slot.own.evidence < np.log(len(EFFECTS)):
            return slot.rest.model
        for rival in slot.rivals:
            if slot.behind(rival) < (-LIKELIER if rival.found.shape_seen else -CLEARLY):
                return rival.found.fit.model
    return None


def _candidates(fit: ModelFit, names: Iterable[str]) -> tuple[Candidate, ...]:
    """What could be there beside a `fit`, among `names`, the likeliest first."""
    found = (Candidate.of(one) for one in search(fit, names))
    return tuple(sorted(found, key=lambda one: -one.evidence))
