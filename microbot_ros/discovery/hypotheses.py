"""What could still be: models on what was seen so far, and how the odds between them stand.

The evidence for an effect is a Bayes factor against the model without it. v, φ and D of both have
the same flat prior and are taken at their maximum (`estimation.likelihood`). The effect's
strengths x, in fit coordinates, are normal about nothing with a standard deviation s that is
itself not known: in the range that the effect declares (`Effect.prior`), all orders of magnitude
alike. With x̂ the maximum, H its information beside all that
is fitted besides and LR the likelihood ratio, the integral over x (Laplace's method, exact where
x acts linearly) gives for each s

    log B = ½ LR − ½ log |1 + s² H| − ½ x̂ᵀ H (1 + s² H)⁻¹ x̂.

A shape (a place, a width, a frequency) is spread evenly over the independent ones it was looked
for at, `Effect.trials`, and within each over a peak that is narrower the more it rises:
− log(trials) − ½ d log(1 + LR) for d numbers.

Where headings remember noise and no radius tells their rotational diffusion, it is fitted too and
pays for that (`ModelFit.price_of_turning`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import compress, product

import numpy as np
from scipy.special import logsumexp, softmax

from microbot_ros.discovery.learned.learn import Finding, learn_term
from microbot_ros.discovery.processes import Run, serially
from microbot_ros.discovery.search import CandidateFit, compare, search, without
from microbot_ros.estimation.likelihood.model_fit import (
    ModelFit,
    fit_sessions,
    fit_with_noise,
    unsteady,
)
from microbot_ros.estimation.likelihood.prepared_session import PreparedSession
from microbot_ros.model.effects import EFFECTS
from microbot_ros.model.model import Model

FALSE = 0.01
"""Chance of a name where nothing is missing, and of a name in place of a rival."""

RIVAL = float(np.log(1 / FALSE))
"""Log odds against each rival from which a name is alone."""

PER_DECADE = 2
"""Standard deviations of a prior that are averaged over, for each order of magnitude: a choice."""

FEW = 2
"""Effects beside which speeds are first looked at: what stands in for speeds that fluctuate comes
after what is there, as a rule."""

MOST = 5
"""Effects in a model. Rollers on a rig need a delay, a ratio of coils, a dead band, a response to
the drive and a drift. With 3 one or two of these stay unexplained and make the verdict `unnamed`.
"""

WORTH = 1.0
"""Gain in log odds from which an effect is taken into the model, to look on beside it."""

LIKELIER = 0.5
"""Log odds by which a rival must be ahead, to take an effect's place: twins stay where they are.
"""

CLEARLY = 3.0
"""The same for a rival whose shape was not seen."""


UNLIKELY = 0.01
"""Probability below which another model does not widen an interval: a choice. What differs by two
standard deviations would widen it by 2 %, with twice of it by 4 %."""

LOOKS = 4 * MOST
"""Models that a search looks at, at most: twice as many as it takes to add each effect and to
exchange it once."""

REPEATED = 0.02
"""Relative difference of parameters, or part of their typical size, up to which a model with the
same effects is the same: a choice. A lag leaves out other rows than one that is shorter by a
third, so that the same set of effects may be better when it comes again."""


def likelier_than_not() -> float:
    """Log evidence from which an effect, any of the library, is rather there than not."""
    return float(np.log(len(EFFECTS)))


def log_bayes_factor(found: CandidateFit, wider: float = 1.0) -> float:
    """Return the natural log of the Bayes factor for an effect, against the fit without it.

    The prior of its strengths is `wider` by a factor than the effect declares it.
    """
    return _log_evidence(found.fit, [found.id], found.likelihood_ratio, wider) - _price(found)


def joint_log_bayes_factor(fit: ModelFit, rest: ModelFit, found: Sequence[CandidateFit]) -> float:
    """Return the natural log of the Bayes factor for all effects `found` together.

    Those that a `fit` has and the `rest` has not. Where effects explain the same, the odds of
    each beside the others say too little of all of them, and multiplied they say too much.
    """
    return (_log_evidence(fit, [one.id for one in found], rest.cost - fit.cost)
            - sum(map(_price, found)))


def _widths(name: str) -> np.ndarray:
    """Standard deviations (S,) of the prior of an effect's strengths, in fit coordinates."""
    low, high = EFFECTS[name].prior
    return np.geomspace(low, high, 1 + round(PER_DECADE * np.log10(high / low)))


def _log_evidence(fit: ModelFit, names: Sequence[str], likelihood_ratio: float,
                  wider: float = 1.0) -> float:
    """Log of the likelihood ratio averaged over strengths of the effects `names` of a `fit`."""
    information, _, visible = fit.normal
    parameters = fit.model.parameters
    own = np.array([name in names and not p.shape for name, p in parameters]) & visible
    rest = np.array([name not in names for name, _ in parameters]) & visible
    x = fit.model.vector()[own]
    cross = information[np.ix_(own, rest)]
    left = information[np.ix_(own, own)] - cross @ np.linalg.pinv(
        information[np.ix_(rest, rest)], hermitian=True) @ cross.T
    power, axes = np.linalg.eigh(left)
    left = axes * np.maximum(power, 0.0) @ axes.T
    group = np.array([names.index(name) for name, _ in compress(parameters, own)], int)
    logs = []
    for widths in product(*map(_widths, names)):
        spread = (wider * np.array(widths)[group]) ** 2
        wide = np.eye(len(x)) + spread[:, None] * left
        logs.append(-0.5 * (np.linalg.slogdet(wide)[1] + x @ left @ np.linalg.solve(wide, x)))
    return float(max(likelihood_ratio, 0.0) / 2 + logsumexp(logs) - np.log(len(logs)))


def _price(found: CandidateFit) -> float:
    """Return what the choice of a shape costs, and a rotational diffusion that is freed with it.
    """
    shapes = sum(p.shape for p in EFFECTS[found.id].parameters())
    return found.price_of_turning + float(
        np.log(found.trials) + shapes / 2 * np.log1p(max(found.likelihood_ratio, 0.0)))


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

        The flank of a wide spot explains whatever a drift does. So one with more numbers than the
        effect has, or without a shape that shows, is a rival only where it explains more by these
        numbers, or is likelier, or where the effect depends on place itself.
        """
        behind = self.own.evidence - rival.evidence
        own, other = self.own.found, rival.found
        more = max(other.dof - own.dof, 0)
        told = EFFECTS[self.own.id].needs_position or (other.shape_seen and (
            not more or other.likelihood_ratio - own.likelihood_ratio >= 2 * more))
        return behind if behind < 0 or told else np.inf

    @property
    def within_reach(self) -> tuple[Candidate, ...]:
        """The rivals that the effect can't be told from."""
        return tuple(one for one in self.rivals if self.behind(one) < RIVAL)


@dataclass(frozen=True)
class Hypotheses:
    """What could be behind what was seen so far.

    `start`: the fit of the first-order model; `fit` of the model that is taken for now, which may
    be without an effect; a slot for each of its effects; `more`: what could be there besides, the
    likeliest first.
    """

    start: ModelFit
    fit: ModelFit
    slots: tuple[Slot, ...]
    more: tuple[Candidate, ...]
    _terms: dict[int, tuple[ModelFit, Finding | None]] = field(default_factory=dict, repr=False)

    def term_beside(self, fit: ModelFit,
                    report: Callable[[str], None] = lambda _: None) -> Finding | None:
        """Return the term that is learned beside a `fit`; it is looked for once.

        `report` is told what is being done.
        """
        if id(fit) not in self._terms:
            self._terms[id(fit)] = fit, learn_term(fit, report)
        return self._terms[id(fit)][1]

    def within_reach(self) -> list[tuple[ModelFit, float]]:
        """Return other models that may be true, each with its probability, from UNLIKELY on.

        The model without one of its effects, with a rival in its place, or with one effect more
        that is rather there than not.
        """
        price = likelier_than_not()
        others = [(slot.rest, price - slot.own.evidence) for slot in self.slots]
        others += [(one.found.fit, -slot.behind(one))
                   for slot in self.slots for one in slot.within_reach]
        others += [(one.found.fit, one.evidence - price) for one in self.more
                   if one.evidence > price]
        share = softmax([0.0, *(log for _, log in others)])[1:]
        return [(fit, float(p)) for (fit, _), p in zip(others, share, strict=True)
                if p > UNLIKELY]

    @property
    def credible(self) -> frozenset[str]:
        """Every effect that is rather there than not, beside any of the models."""
        return frozenset(self.names) | {
            one.id for group in (self.more, *(slot.rivals for slot in self.slots))
            for one in group if one.evidence > likelier_than_not()}

    @property
    def names(self) -> tuple[str, ...]:
        """The effects of the model that is taken for now."""
        return tuple(slot.own.id for slot in self.slots)

    @property
    def evidence(self) -> float:
        """Log odds for all effects of the model together, the choice among the library paid."""
        if not self.slots:
            return 0.0
        # On the same rows: what a lag can't explain is left out.
        rest = fit_with_noise(self.fit.under(self.start.model))
        return joint_log_bayes_factor(self.fit, rest, [s.own.found for s in self.slots]) - (
            len(self.slots) * likelier_than_not())

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


def fit_first_order(sessions: Sequence[PreparedSession]) -> ModelFit:
    """Return the fit of the first-order model to `sessions` of one rig."""
    return fit_sessions(Model.baseline(sessions[0].conditions, sessions[0].commands), sessions)


def add_effects(fit: ModelFit, sessions: Sequence[PreparedSession],
                names: Iterable[str]) -> ModelFit:
    """Return the fit to `sessions` with the effects among `names` that are added beside a `fit`.

    As `consider` adds them, one after the other, without a look at what could be in their place.
    """
    while len(fit.model.effects) < MOST:
        likely = [one for one in _others(fit, serially, names) if _is_worth_adding(one)]
        if not likely:
            break
        fit = fit_sessions(likely[0].found.fit.model, sessions)
    return fit


def _is_worth_adding(one: Candidate) -> bool:
    return one.evidence >= likelier_than_not() + WORTH


def consider(sessions: Sequence[PreparedSession], taken: Sequence[str] = (),
             report: Callable[[str], None] = lambda _: None,
             run: Run = serially) -> Hypotheses:
    """Return the hypotheses on `sessions` of one rig, which share the effects.

    Effects are added while the odds are for them, dropped where they are not any more, and
    exchanged for rivals that became likelier, from the effects `taken` at a look before on. The
    search ends where a set of effects would come again, with the likeliest that was visited. Where
    the model that is found leaves velocities that fluctuate, the search goes on from it with these
    in the noise of all fits.
    `report` is told what is being done; `run` shares the candidates.
    """
    known = _search(sessions, taken, FEW, report, run)
    plain = known.fit
    for effect in plain.model.effects:
        if effect.overrides('alignment_rate'):  # a filter has room for one memory
            plain = without(plain, effect.id)
    restless = unsteady(sessions, plain, known.fit)
    if restless is None:
        return known if len(known.slots) < FEW else _search(
            sessions, known.names, MOST, report, run)
    report('looking again beside speeds that fluctuate')
    return _search(restless, [effect.id for effect in plain.model.effects], MOST, report, run)


def _search(sessions: Sequence[PreparedSession], taken: Sequence[str], most: int,
            report: Callable[[str], None], run: Run) -> Hypotheses:
    """Return the hypotheses on `sessions`, of `most` effects, as for `consider`."""
    start = fit = fit_first_order(sessions)
    for name in taken:
        again = [one for one in _candidates(fit, [name], run) if one.evidence > 0]
        fit = fit_sessions(again[0].found.fit.model, sessions) if again else fit
    looked: list[Hypotheses] = []
    while len(looked) < LOOKS:
        report('looking beside ' + (', '.join(e.id for e in fit.model.effects)
                                    or 'the first-order model'))
        slots = _slots(fit, run)
        better = _exchange(slots, [one.names for one in looked])
        more = _others(fit, run) if better is None else ()
        looked.append(Hypotheses(start, fit, slots, more))
        if more and len(slots) < most and _is_worth_adding(more[0]):
            better = more[0].found.fit.model
        if better is None:
            break
        fit = fit_sessions(better, sessions)
        if any(_same(one.fit.model, fit.model) for one in looked):
            break
    known = looked[-1] if better is None else _likeliest(looked)
    return known if known.more else replace(known, more=_others(known.fit, run))


def _likeliest(looked: Sequence[Hypotheses]) -> Hypotheses:
    """Return the hypotheses of the largest evidence, of those whose effects are all possible."""
    possible = [one for one in looked if all(_possible(slot.own.found) for slot in one.slots)]
    return max(possible or looked, key=lambda one: one.evidence)


def _same(one: Model, other: Model) -> bool:
    """Return whether models have the same effects with nearly the same parameters."""
    first, second = (dict(zip(model.parameters, model.vector(), strict=True))
                     for model in (one, other))
    return first.keys() == second.keys() and np.allclose(
        [first[key] for key in second], list(second.values()), rtol=REPEATED, atol=REPEATED)


def _others(fit: ModelFit, run: Run, names: Iterable[str] = EFFECTS) -> tuple[Candidate, ...]:
    """Return the candidates among `names` beside all effects of a `fit`."""
    present = [effect.id for effect in fit.model.effects]
    return _candidates(fit, [name for name in names if name not in present], run)


def _slots(fit: ModelFit, run: Run) -> tuple[Slot, ...]:
    present = [effect.id for effect in fit.model.effects]
    slots = []
    for name in present:
        rest = without(fit, name)
        rivals = _candidates(rest, [other for other in EFFECTS if other not in present], run)
        slots.append(Slot(rest, Candidate.of(compare(fit, rest, name)), rivals))
    return tuple(slots)


def _exchange(slots: Sequence[Slot], visited: Sequence[tuple[str, ...]]) -> Model | None:
    """The model with an effect less that is not worth it, or with a likelier rival in its place.

    No rival that leads to a set of effects that was `visited`: two that are each likelier than the
    other, beside the noise of the other, may both be there.
    """
    for slot in slots:
        if slot.own.evidence < likelier_than_not() or not _possible(slot.own.found):
            return slot.rest.model
    for slot in slots:
        for rival in slot.rivals:
            model = rival.found.fit.model
            known = any({e.id for e in model.effects} == {*names} for names in visited)
            if not known and slot.behind(rival) < (
                    -LIKELIER if rival.found.shape_seen else -CLEARLY):
                return model
    return None


def _candidates(fit: ModelFit, names: Iterable[str], run: Run) -> tuple[Candidate, ...]:
    """What could be there beside a `fit`, among `names`, the likeliest first."""
    found = (Candidate.of(one) for one in search(fit, names, run) if _possible(one))
    return tuple(sorted(found, key=lambda one: -one.evidence))


def _possible(found: CandidateFit) -> bool:
    """Whether an effect without a shape is inside its physical bounds: at one it is another thing.
    """
    return found.has_shape or found.shape_seen
