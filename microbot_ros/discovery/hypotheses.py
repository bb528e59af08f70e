"""Models that may explain the recordings so far, and the odds between them.

The evidence for an effect is a Bayes factor against the model without it. v, φ and D of both
models have the same flat prior and are taken at their maximum (`estimation.likelihood`). The
effect's strengths x, in fit coordinates, have a normal prior of mean 0. Its standard deviation s
is unknown: log-uniform in the range that the effect declares (`Effect.prior`). With x̂ the
maximum, H the information on x beside all other fitted parameters and LR the likelihood ratio, the
integral over x (Laplace's method, exact where x acts linearly) gives for each s

    log B = ½ LR − ½ log |1 + s² H| − ½ x̂ᵀ H (1 + s² H)⁻¹ x̂.

A shape (a place, a width, a frequency) has a uniform prior over the independent values at which it
was tried, `Effect.trials`. Within each, the posterior is a peak that narrows as it rises, which
costs − log(trials) − ½ d log(1 + LR) for d shape parameters.

Where headings have memory and no radius fixes their rotational diffusion, this is fitted too, at a
cost in log odds (`ModelFit.price_of_turning`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import compress, product

import numpy as np
from scipy.special import logsumexp, softmax

from microbot_ros.discovery.learned.learn import Finding, learn_term, with_term
from microbot_ros.discovery.processes import Run, serially
from microbot_ros.discovery.search import CandidateFit, compare, search, without
from microbot_ros.estimation.likelihood.interruptions import interrupted
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
"""Target probability of a name where nothing is missing, and of a name in place of a rival.

Choice: half of it needs 0.7 more log evidence for every name, twice of it 0.7 less.
"""

RIVAL = float(np.log(1 / FALSE))
"""Log odds against each rival above which a name is the only one, from FALSE."""

PER_DECADE = 2
"""Standard deviations of a prior per decade over which the evidence is averaged.

Choice: the evidence varies slowly with the standard deviation; more only cost time.
"""

FEW = 2
"""Number of effects in the model before fluctuating speeds are first considered.

Choice: with fewer, fluctuations of speed may explain an effect that is not in the model yet; with
more, effects may enter that only stand in for fluctuations.
"""

MOST = 5
"""Maximum number of effects in a model.

Rollers on a rig need a delay, a ratio of coils, a dead band, a response to the drive and a drift.
With 3, one or two of these remain unexplained and make the verdict `unnamed`.
"""

WORTH = 1.0
"""Log odds that an effect must add to be taken into the model.

Choice: a smaller value adds effects that the next step drops again, a larger one stops early.
"""

LIKELIER = 0.5
"""Log odds by which a rival must lead to replace an effect, so that equal ones do not alternate.

Choice: far below RIVAL, so that no name depends on it.
"""

CLEARLY = 3.0
"""LIKELIER for a rival whose shape the recording does not show.

Choice: a smaller value replaces effects by the flank of a wider shape, a larger one keeps some
that are wrong.
"""


UNLIKELY = 0.01
"""Probability below which another model does not widen an interval.

Choice: a parameter that differs by two standard deviations would widen the interval by 2 %, with
twice this value by 4 %.
"""

LOOKS = 4 * MOST
"""Maximum number of models that a search visits.

Choice: twice the number needed to add each effect and to exchange it once.
"""

ALIKE = 0.05
"""Difference in −2 log likelihood up to which two fits of one model are the same.

Choice: a few times the gain at which a fit ends (`joint.ENOUGH`), and far below what a parameter
changes.
"""

REPEATED = 0.02
"""Difference of parameters, relative or as a fraction of their typical size, up to which two
models with the same effects are the same.

Choice: a lag excludes other rows than one that is a third shorter, so the same set of effects may
be better on its second visit."""


def likelier_than_not() -> float:
    """Return the log Bayes factor at which an effect is as likely as not, given the whole library.

    Returns
    -------
    float
        Natural log of the number of effects in the library.
    """
    return float(np.log(len(EFFECTS)))


def log_bayes_factor(found: CandidateFit, wider: float = 1.0) -> float:
    """Return the natural log of the Bayes factor for an effect, against the fit without it.

    Parameters
    ----------
    found : CandidateFit
        Fit with the effect, and its likelihood ratio.
    wider : float, optional
        Factor on the standard deviation of the prior that the effect declares.

    Returns
    -------
    float
        Log Bayes factor, less the cost of a shape and of a freed rotational diffusion.
    """
    return _log_evidence(found.fit, [found.id], found.likelihood_ratio, wider) - _price(found)


def joint_log_bayes_factor(fit: ModelFit, rest: ModelFit, found: Sequence[CandidateFit]) -> float:
    """Return the natural log of the Bayes factor for several effects together.

    Where effects explain the same data, the odds of each beside the others understate the odds of
    all, and their product overstates them.

    Parameters
    ----------
    fit : ModelFit
        Fit with the effects.
    rest : ModelFit
        Fit of the same rows without them.
    found : sequence of CandidateFit
        The effects by which the fits differ.

    Returns
    -------
    float
        Log Bayes factor, less the cost of shapes and of freed rotational diffusions.
    """
    return (_log_evidence(fit, [one.id for one in found], rest.cost - fit.cost)
            - sum(map(_price, found)))


def prior_widths(name: str) -> np.ndarray:
    """Return the prior standard deviations of an effect's strengths.

    Parameters
    ----------
    name : str
        Id of the effect.

    Returns
    -------
    ndarray, shape (S,)
        Ascending, in fit coordinates.
    """
    low, high = EFFECTS[name].prior
    return np.geomspace(low, high, 1 + round(PER_DECADE * np.log10(high / low)))


def _log_evidence(fit: ModelFit, names: Sequence[str], likelihood_ratio: float,
                  wider: float = 1.0) -> float:
    """Return the log of the likelihood ratio averaged over the strengths of effects `names`."""
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
    for widths in product(*map(prior_widths, names)):
        spread = (wider * np.array(widths)[group]) ** 2
        wide = np.eye(len(x)) + spread[:, None] * left
        logs.append(-0.5 * (np.linalg.slogdet(wide)[1] + x @ left @ np.linalg.solve(wide, x)))
    return float(max(likelihood_ratio, 0.0) / 2 + logsumexp(logs) - np.log(len(logs)))


def _price(found: CandidateFit) -> float:
    """Return the cost in log odds of a shape, and of a rotational diffusion freed with it."""
    shapes = sum(p.shape for p in EFFECTS[found.id].parameters())
    return found.price_of_turning + float(
        np.log(found.trials) + shapes / 2 * np.log1p(max(found.likelihood_ratio, 0.0)))


@dataclass(frozen=True)
class Candidate:
    """A fit with an effect, `found`, and its `evidence`: the log Bayes factor for the effect."""

    found: CandidateFit
    evidence: float

    @classmethod
    def of(cls, found: CandidateFit) -> Candidate:
        """Compute the evidence of a fit.

        Parameters
        ----------
        found : CandidateFit
            Fit with the effect.

        Returns
        -------
        Candidate
            The fit with its log Bayes factor.
        """
        return cls(found, log_bayes_factor(found))

    @property
    def id(self) -> str:
        """Name of the effect."""
        return self.found.id


@dataclass(frozen=True)
class Slot:
    """An effect of the model and the effects that may replace it.

    Attributes
    ----------
    rest : ModelFit
        Fit of the model's other effects.
    own : Candidate
        The effect, beside `rest`.
    rivals : tuple of Candidate
        Other effects beside `rest`, largest evidence first.
    """

    rest: ModelFit
    own: Candidate
    rivals: tuple[Candidate, ...]

    def behind(self, rival: Candidate) -> float:
        """Return by how much log evidence a rival is behind the effect.

        The flank of a wide spot explains whatever a drift explains. A rival with more parameters,
        or with a shape that the recording does not show, therefore counts in three cases only: it
        explains more by these parameters, it is likelier, or the effect depends on place itself.

        Parameters
        ----------
        rival : Candidate
            One of `rivals`.

        Returns
        -------
        float
            Difference of log evidence, negative if the rival is likelier; infinite if it does not
            count.
        """
        behind = self.own.evidence - rival.evidence
        own, other = self.own.found, rival.found
        more = max(other.dof - own.dof, 0)
        told = EFFECTS[self.own.id].needs_position or (other.shape_seen and (
            not more or other.likelihood_ratio - own.likelihood_ratio >= 2 * more))
        return behind if behind < 0 or told else np.inf

    @property
    def within_reach(self) -> tuple[Candidate, ...]:
        """Rivals from which the data do not distinguish the effect: less than RIVAL behind."""
        return tuple(one for one in self.rivals if self.behind(one) < RIVAL)


@dataclass(frozen=True)
class Hypotheses:
    """Models that may explain the recordings so far.

    Attributes
    ----------
    start : ModelFit
        Fit of the first-order model.
    fit : ModelFit
        Fit of the current model, which may have no effect.
    slots : tuple of Slot
        One for each effect of the current model.
    more : tuple of Candidate
        Effects that the model might have besides, largest evidence first.
    """

    start: ModelFit
    fit: ModelFit
    slots: tuple[Slot, ...]
    more: tuple[Candidate, ...]
    _terms: dict[int, tuple[ModelFit, Finding | None]] = field(default_factory=dict, repr=False)

    def term_beside(self, fit: ModelFit,
                    report: Callable[[str], None] = lambda _: None) -> Finding | None:
        """Return the term that is learned beside a fit. It is computed once for each fit.

        Parameters
        ----------
        fit : ModelFit
            Fit whose residuals are searched.
        report : callable, optional
            Receives one line of progress.

        Returns
        -------
        Finding or None
            The likeliest term; None if none is likelier than no term.
        """
        if id(fit) not in self._terms:
            self._terms[id(fit)] = fit, learn_term(fit, report)
        return self._terms[id(fit)][1]

    def within_reach(self) -> list[tuple[ModelFit, float]]:
        """Return the other models that may be true.

        These are the model without one of its effects, with a rival in its place, or with one more
        effect that is likelier than not.

        Returns
        -------
        list of (ModelFit, float)
            Each model with its probability, above UNLIKELY.
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
        """Names of all effects that are likelier than not, beside any of the models."""
        return frozenset(self.names) | {
            one.id for group in (self.more, *(slot.rivals for slot in self.slots))
            for one in group if one.evidence > likelier_than_not()}

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects of the current model."""
        return tuple(slot.own.id for slot in self.slots)

    @property
    def evidence(self) -> float:
        """Log odds for all effects of the model together, less the cost of their choice."""
        if not self.slots:
            return 0.0
        # On the same rows, since a lag excludes rows that it cannot explain.
        rest = fit_with_noise(self.fit.under(self.start.model))
        return joint_log_bayes_factor(self.fit, rest, [s.own.found for s in self.slots]) - (
            len(self.slots) * likelier_than_not())

    def odds(self) -> dict[str, float]:
        """Return the probability of each effect of the library, and of no effect.

        The probabilities of effects that compete for one slot, and of no effect in it, add up to
        1. No effect has the prior weight of all of them together.

        Returns
        -------
        dict of str to float
            Probabilities by name of the effect; that of no effect under ''.
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


class _Memory:
    """Candidates beside every fit that a search meets, each fitted once.

    What is left of a model without one of its effects is often a model from before.

    Parameters
    ----------
    run : Run
        Distributes the candidates.
    """

    def __init__(self, run: Run) -> None:
        self._run = run
        self._beside: list[tuple[ModelFit, dict[str, Candidate | None]]] = []

    def candidates(self, fit: ModelFit, names: Iterable[str]) -> tuple[Candidate, ...]:
        """Return the candidates among `names` beside a `fit`, largest evidence first."""
        names = list(names)
        known = next((found for one, found in self._beside if _alike(one, fit)), None)
        if known is None:
            known = {}
            self._beside.append((fit, known))
        new = [name for name in names if name not in known]
        fitted = map(Candidate.of, filter(_possible, search(fit, new, self._run)))
        known |= dict.fromkeys(new) | {one.id: one for one in fitted}
        found = (known[name] for name in names)
        return tuple(sorted(filter(None, found), key=lambda one: -one.evidence))

    def others(self, fit: ModelFit, names: Iterable[str] = EFFECTS) -> tuple[Candidate, ...]:
        """Return the candidates among `names` beside all effects of a `fit`."""
        present = [effect.id for effect in fit.model.effects]
        return self.candidates(fit, [name for name in names if name not in present])

    def slots(self, fit: ModelFit) -> tuple[Slot, ...]:
        """Return the effects of a `fit`, each with its rivals."""
        present = [effect.id for effect in fit.model.effects]
        slots = []
        for name in present:
            rest = without(fit, name)
            rivals = self.candidates(rest, [one for one in EFFECTS if one not in present])
            slots.append(Slot(rest, Candidate.of(compare(fit, rest, name)), rivals))
        return tuple(slots)


def _alike(one: ModelFit, other: ModelFit) -> bool:
    """Return whether two fits are the same, to the accuracy of a maximum."""
    return (one.count == other.count and abs(one.cost - other.cost) < ALIKE
            and _same(one.model, other.model))


def fit_first_order(sessions: Sequence[PreparedSession]) -> ModelFit:
    """Return the fit of the first-order model to sessions of one rig.

    Parameters
    ----------
    sessions : sequence of PreparedSession
        At least one; the first determines propulsion and reference field.

    Returns
    -------
    ModelFit
        Fit without effects.
    """
    return fit_sessions(Model.baseline(sessions[0].conditions, sessions[0].commands), sessions)


def add_effects(fit: ModelFit, sessions: Sequence[PreparedSession],
                names: Iterable[str]) -> ModelFit:
    """Add the effects that the data support to a fit, one after the other.

    As `consider` adds them, without a search for rivals.

    Parameters
    ----------
    fit : ModelFit
        Fit to begin with.
    sessions : sequence of PreparedSession
        Sessions to which each model is fitted.
    names : iterable of str
        Effects that may be added.

    Returns
    -------
    ModelFit
        Fit with at most MOST effects.
    """
    memory = _Memory(serially)
    while len(fit.model.effects) < MOST:
        likely = [one for one in memory.others(fit, names) if _is_worth_adding(one)]
        if not likely:
            break
        fit = fit_sessions(likely[0].found.fit.model, sessions)
    return fit


def _is_worth_adding(one: Candidate) -> bool:
    return one.evidence >= likelier_than_not() + WORTH


def consider(sessions: Sequence[PreparedSession], taken: Sequence[str] = (),
             report: Callable[[str], None] = lambda _: None,
             run: Run = serially) -> Hypotheses:
    """Search for the effects that the data support, and for their rivals.

    Effects are added while the odds favour them, dropped when the odds no longer do, and exchanged
    for rivals that became likelier. The search ends when a set of effects repeats, and returns the
    likeliest model that it visited. Rows in which that model shows interruptions are left out, and
    the search continues. If the model leaves fluctuating velocities, it continues with these in
    the noise of all fits. Neither happens if a learned term explains the same.

    Parameters
    ----------
    sessions : sequence of PreparedSession
        Sessions of one rig, which share the effects.
    taken : sequence of str, optional
        Effects of an earlier search, from which this one starts.
    report : callable, optional
        Receives one line of progress for each model.
    run : Run, optional
        Distributes the candidates.

    Returns
    -------
    Hypotheses
        Current model, rivals and further candidates.
    """
    memory = _Memory(run)
    known = _search(sessions, taken, FEW, report, memory)
    sessions, known = _uninterrupted(sessions, known, report, memory)
    plain = _without_memory(known.fit)
    found = unsteady(sessions, plain, known.fit)
    if found is None or _explained_by_term(sessions, plain, known, found[1], report):
        return known if len(known.slots) < FEW else _search(
            sessions, known.names, MOST, report, memory)
    report('looking again beside speeds that fluctuate')
    return _search(found[0], [effect.id for effect in plain.model.effects], MOST, report, memory)


def _uninterrupted(sessions: Sequence[PreparedSession], known: Hypotheses,
                   report: Callable[[str], None], memory: _Memory,
                   ) -> tuple[Sequence[PreparedSession], Hypotheses]:
    """Return the sessions without interruptions, and the hypotheses on what is left.

    Interruptions are looked for beside the current model, and in place of all its effects. Both
    results are as before if nothing is found, or if fluctuating speeds or a learned term are
    likelier beside the current model.
    """
    beside = [(known.fit, known.names, known.evidence)]
    if known.slots:
        beside.append((known.start, (), 0.0))
    found = [(one[1] + evidence, one[0], names) for fit, names, evidence in beside
             if (one := interrupted(sessions, fit))]
    if not found:
        return sessions, known
    most, rest, names = max(found, key=lambda one: one[0])
    restless = unsteady(sessions, _without_memory(known.fit), known.fit)
    term = known.term_beside(known.fit, report)
    others = restless[1] if restless else 0.0, term.log_evidence if term else 0.0
    if known.evidence + max(others) > most:
        return sessions, known
    report('looking again without interruptions')
    return rest, _search(rest, names, FEW, report, memory)


def _without_memory(fit: ModelFit) -> ModelFit:
    """Return a fit without effects that give headings a memory: the noise filter has only one."""
    for effect in fit.model.effects:
        if effect.overrides('alignment_rate'):
            fit = without(fit, effect.id)
    return fit


def _explained_by_term(sessions: Sequence[PreparedSession], plain: ModelFit, known: Hypotheses,
                       evidence: float, report: Callable[[str], None]) -> bool:
    """Return whether a learned term is likelier than speeds that fluctuate, and leaves none.

    A speed that depends on place changes as the particle moves on, as a fluctuation does. The term
    has to lead by RIVAL, since a curve of time follows the fluctuations of a single particle.

    Parameters
    ----------
    sessions : sequence of PreparedSession
        The sessions.
    plain : ModelFit
        Current fit, without effects that give headings a memory.
    known : Hypotheses
        Hypotheses of steady speeds.
    evidence : float
        Log evidence for the fluctuations beside the current fit.
    report : callable
        Receives one line of progress.
    """
    found = known.term_beside(known.fit, report)
    if found is None or found.log_evidence < evidence + RIVAL:
        return False
    return unsteady(sessions, with_term(plain, found.term),
                    with_term(known.fit, found.term)) is None


def _search(sessions: Sequence[PreparedSession], taken: Sequence[str], most: int,
            report: Callable[[str], None], memory: _Memory) -> Hypotheses:
    """Return the hypotheses on `sessions` with at most `most` effects, as `consider` does."""
    start = fit = fit_first_order(sessions)
    for name in taken:
        again = [one for one in memory.candidates(fit, [name]) if one.evidence > 0]
        fit = fit_sessions(again[0].found.fit.model, sessions) if again else fit
    looked: list[Hypotheses] = []
    while len(looked) < LOOKS:
        report('looking beside ' + (', '.join(e.id for e in fit.model.effects)
                                    or 'the first-order model'))
        slots = memory.slots(fit)
        better = _exchange(slots, [one.names for one in looked])
        more = memory.others(fit) if better is None else ()
        looked.append(Hypotheses(start, fit, slots, more))
        if more and len(slots) < most and _is_worth_adding(more[0]):
            better = more[0].found.fit.model
        if better is None:
            break
        fit = fit_sessions(better, sessions)
        if any(_same(one.fit.model, fit.model) for one in looked):
            break
    known = looked[-1] if better is None else _likeliest(looked)
    return known if known.more else replace(known, more=memory.others(known.fit))


def _likeliest(looked: Sequence[Hypotheses]) -> Hypotheses:
    """Return the hypotheses of the largest evidence among those whose effects are all possible."""
    possible = [one for one in looked if all(_possible(slot.own.found) for slot in one.slots)]
    return max(possible or looked, key=lambda one: one.evidence)


def _same(one: Model, other: Model) -> bool:
    """Return whether models have the same effects with nearly the same parameters."""
    first, second = (dict(zip(model.parameters, model.vector(), strict=True))
                     for model in (one, other))
    return first.keys() == second.keys() and np.allclose(
        [first[key] for key in second], list(second.values()), rtol=REPEATED, atol=REPEATED)


def _exchange(slots: Sequence[Slot], visited: Sequence[tuple[str, ...]]) -> Model | None:
    """Return the model without an unsupported effect, or with a likelier rival in its place.

    A rival that leads to a set of effects in `visited` is skipped: two effects that are each
    likelier than the other, beside the other's noise, may both be present.
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


def _possible(found: CandidateFit) -> bool:
    """Return whether the strengths of an effect lie inside their physical bounds.

    On a bound it stands in for another cause. Bounds that are limits of a curve count as inside
    (`Effect.shape_seen`). A shape that is not seen does not make an effect impossible.
    """
    effect = found.fit.model.effect(found.id)
    return found.shape_seen or bool(found.has_shape and effect and effect.within_bounds())
