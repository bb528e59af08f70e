"""Design of experiments: sequences of fields, by what they are expected to decide.

Two explanations of all data, a and b, expect displacements μ_a and μ_b. A plan distinguishes them
by the expected growth of

    S = ½ min ‖W(μ_a − μ_b)‖²,

W whitening. The minimum is over v and φ of every particle and over the parameters of b, for past
and plan together, since a plan need not determine again what the past did. The log likelihood
ratio of the two grows by S if a is true, and to first order by the same if b is.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from microbot_ros.control.contract import Workspace
from microbot_ros.discovery.driven.plan import Plan
from microbot_ros.estimation.likelihood.expected_displacement import ExpectedDisplacement
from microbot_ros.estimation.likelihood.joint import (
    SessionFit,
    Whitening,
    eliminate,
    eliminate_shared,
    inner,
)
from microbot_ros.estimation.likelihood.model_fit import ModelFit, difference_steps
from microbot_ros.estimation.likelihood.prepared_session import PreparedSession, nearest
from microbot_ros.model.effects import EFFECTS
from microbot_ros.model.first_order import simulate
from microbot_ros.model.increments import as_vectors
from microbot_ros.model.model import Model, ParticleParameters

STEP = 0.2
"""Interval of frames of a simulated plan [s].

Choice: shorter than most holds; simulation time is inverse to it.
"""

RECENT = 2.0
"""Time [s] since a particle was last seen up to which it counts as present.

Choice: longer than gaps of tracking, shorter than an experiment.
"""

RANDOM, PROPOSED, IMPROVED = 3, 24, 24
"""Number of random-step plans and of other plans (`PROPOSED`) drawn, and of changes tried on the
best (`IMPROVED`).

Choice: each costs one simulation while the rig waits; with fewer, plans are less informative."""

MARGIN = 10e-6
"""Distance [m] that particles should keep from the edge of the view.

Choice: one or two diameters, so that the tracker sees whole particles.
"""

STRAY = 20.0
"""Factor on the cost of a plan per fraction of time that particles are out of view or touching.

Choice: a plan that loses 5 % of the time must be twice as informative.
"""

APART = 3.0
"""Distance of centres, in radii, below which spheres count as touching: contact is in no effect.

Measured: where plans let particles touch, a slowdown was not named in six minutes; with three
radii it is named after 0.8 min (docs/decisions/asking.md).
"""

LONGEST = 20.0
"""Longest time, in durations of a plan, for which the cost of a question is extrapolated.

Choice: beyond it, plans that do not help a question are equal.
"""

FAINT = 10.0 / 2 / 60
"""Log evidence per second that usual plans bring for an effect that is not visible yet.

Choice: ½ · 10 per minute, as a weak effect of the library brings.
"""

LITTLE = 0.02
"""Strength, in fit coordinates, at which a plan's information on an effect is evaluated.

Choice: small enough for the effect to act linearly, large beside rounding.
"""

AGE, RECOVERY = 60.0, 0.5
"""Time [s] in which a particle's speed ages, and in which it recovers from a switch (`RECOVERY`).

Choice: typical scales of unknown velocities that depend on time.
"""

SHOWN = (0.1e-6) ** -2
"""Prior information [s²/m²] on an unknown velocity: a standard deviation of 0.1 µm/s.

Measured: counted from here, plans separate a channel's flow from a drift by 5.6 in log likelihood
after 160 s instead of 0.8 (docs/decisions/asking.md).
"""

STARVED = 0.2
"""Fraction of the usual information on unlisted velocities below which a plan costs more.

Choice: half of it lets plans hide these; twice of it slows the decision between named effects.
"""


@dataclass(frozen=True)
class Range:
    """What a rig may be commanded.

    Attributes
    ----------
    field : float
        Largest field [T].
    workspace : Workspace
        Area in view.
    frequency : (float, float) or None
        Lowest and highest frequency of a rolling field [Hz]; None for swimmers.
    """

    field: float
    workspace: Workspace
    frequency: tuple[float, float] | None = None


@dataclass(frozen=True)
class Question:
    """Two explanations to be distinguished.

    Attributes
    ----------
    first, second : ModelFit
        Fits to the same data.
    missing : float
        Log evidence until the question is decided, above 0.
    weight : float
        Importance relative to other questions.
    """

    first: ModelFit
    second: ModelFit
    missing: float
    weight: float = 1.0


@dataclass(frozen=True)
class Search:
    """Effects that are not visible yet.

    Their strength is unknown, so plans are compared with what usual plans show of them.

    Attributes
    ----------
    odds : mapping of str to float
        Probability of each effect.
    missing : float
        Log evidence until one is named.
    """

    odds: Mapping[str, float]
    missing: float


@dataclass(frozen=True)
class Design:
    """A chosen plan.

    Attributes
    ----------
    plan : Plan
        The plan.
    best : ndarray, shape (Q,)
        Expected gain of each question by the best plan for it alone, of all plans tried.
    worth : float
        How many times as long random steps are expected to take, at most LONGEST.
    """

    plan: Plan
    best: np.ndarray
    worth: float = 1.0


def random_steps(rng: np.random.Generator, duration: float, limits: Range) -> Plan:
    """Return a plan of random steps.

    Directions are uniform on the circle, each held for 0.3 to 6 s, at full, half or quarter field.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of randomness.
    duration : float
        Duration [s].
    limits : Range
        What the rig may be commanded.

    Returns
    -------
    Plan
        Of exactly that duration.
    """
    count = int(duration / 0.3) + 1
    hold = np.exp(rng.uniform(np.log(0.3), np.log(6.0), count))
    return Plan(
        rng.uniform(-np.pi, np.pi, count), limits.field * rng.choice([1.0, 0.5, 0.25], count),
        hold, _frequencies(rng, count, limits)).lasting(duration)


def choose_plan(fit: ModelFit, questions: Sequence[Question], search: Search | None,
                begin: float, duration: float, limits: Range, rng: np.random.Generator) -> Design:
    """Return the plan that is expected to answer the questions soonest.

    Plans of several kinds are drawn at random; the best is then changed while that improves it.

    Parameters
    ----------
    fit : ModelFit
        Current explanation of all data, one session.
    questions : sequence of Question
        Explanations to be distinguished.
    search : Search or None
        Effects not visible yet, weighted by their odds. None: only the total gain counts, by
        weight.
    begin : float
        Start of the plan [s], on the clock of the session.
    duration : float
        Duration [s].
    limits : Range
        What the rig may be commanded.
    rng : numpy.random.Generator
        Source of randomness.

    Returns
    -------
    Design
        The best of all plans tried.

    Raises
    ------
    ValueError
        If no particle is in view.
    """
    trial = _Trial.of(fit, questions, search or Search({}, 1.0), begin, limits)
    drawn = [random_steps(rng, duration, limits) for _ in range(RANDOM)]
    drawn += [_draw(rng, duration, limits) for _ in range(PROPOSED)]
    tried = [trial.score(plan) for plan in drawn]
    price: _Price | _Divergence = _Price.of(trial, tried, duration) if search else (
        _Divergence(trial))
    costs = [price(one) for one in tried]
    best = int(np.argmin(costs))
    plan, cost = drawn[best], costs[best]
    for k in range(IMPROVED):
        other = _change(rng, plan, drawn[int(rng.integers(len(drawn)))], limits, k)
        score = trial.score(other)
        tried.append(score)
        if price(score) < cost:
            plan, cost = other, price(score)
    return Design(plan, np.max([one.gains for one in tried], axis=0),
                  min(float(np.median(costs[:RANDOM])) / cost, LONGEST))


# Value of a plan --------------------------------------------------------------------------------

@dataclass(frozen=True)
class _Outcome:
    """What is expected of a plan that was tried in a `trial`, and simulated as a `session`.

    Fractions of time that particles are `astray` and `touching`; the rest is computed when needed.
    """

    trial: _Trial
    session: PreparedSession
    astray: float
    touching: float

    @cached_property
    def gains(self) -> np.ndarray:
        """Growth of S (Q,) for every question."""
        return self.trial.gains(self.session)

    @cached_property
    def search(self) -> np.ndarray:
        """Information (E,) on each effect in search."""
        return self.trial.sought(self.session)

    @cached_property
    def shown(self) -> float:
        """Information gained on velocities that are in no list."""
        return self.trial.shown(self.session)

    @property
    def spoilt(self) -> float:
        """Factor on the cost for particles that are astray or touching."""
        return 1 + STRAY * (self.astray + self.touching)


@dataclass(frozen=True)
class _Price:
    """Cost of a plan: expected seconds until all questions are answered.

    The longest question plus the weighted mean. It is higher for plans that show less than usual
    plans of this `duration` [s] of velocities in no list, and for particles astray or touching.
    """

    trial: _Trial
    duration: float
    usual_search: np.ndarray
    usual_shown: float

    @classmethod
    def of(cls, trial: _Trial, drawn: Sequence[_Outcome], duration: float) -> _Price:
        return cls(trial, duration, np.median([one.search for one in drawn], axis=0),
                   float(np.median([one.shown for one in drawn])))

    def __call__(self, outcome: _Outcome) -> float:
        trial, longest = self.trial, LONGEST * self.duration
        asked = np.minimum(
            trial.missing * self.duration / np.maximum(outcome.gains, 1e-9), longest)
        share = np.where(self.usual_search > 0, outcome.search / np.where(
            self.usual_search > 0, self.usual_search, 1.0), 1.0)
        sought = np.minimum(trial.search.missing / (FAINT * np.maximum(share, 1e-9)), longest)
        odds = np.array(list(trial.search.odds.values()))
        weight = np.concatenate([trial.weight, odds])
        spent = self.duration + float(asked[trial.weight >= 1].max(initial=0.0))
        spent += float(weight @ np.concatenate([asked, sought]) / max(weight.sum(), 1e-9))
        shown = outcome.shown / max(self.usual_shown, 1e-30)
        # Without a question, only velocities in no list remain to be found.
        useful = min(shown / STARVED, 1.0) if trial.questions else shown
        return spent * outcome.spoilt / max(useful, 1e-3)


@dataclass(frozen=True)
class _Divergence:
    """Cost of a plan where only the divergence of explanations counts (Box and Hill 1967).

    The inverse of its weighted gains; higher for particles astray or touching.
    """

    trial: _Trial

    def __call__(self, outcome: _Outcome) -> float:
        apart = float(self.trial.weight @ outcome.gains)
        return outcome.spoilt / max(apart, 1e-9)


@dataclass(frozen=True)
class _Trial:
    """Simulation of plans with the particles in view, for all questions at once.

    `tracks` are those particles in the session of `fit`, which `start` (N, 2) [m] where they were
    last seen. `past` has the inner products (N, M, M) of each question's columns over the data.
    `little` has for each strength of the effects in `search` the index of the effect and the model
    with a little of it; `seen` (N, M, M) the inner products of what these do, `known` (N, M, M)
    those of velocities in no list.
    """

    fit: ModelFit
    questions: Sequence[Question]
    search: Search
    little: Sequence[tuple[int, Model]]
    seen: np.ndarray
    known: np.ndarray
    tracks: np.ndarray
    start: np.ndarray
    begin: float
    limits: Range
    past: Sequence[np.ndarray]
    missing: np.ndarray
    weight: np.ndarray

    @classmethod
    def of(cls, fit: ModelFit, questions: Sequence[Question], search: Search, begin: float,
           limits: Range) -> _Trial:
        present = fit.session_fits[0].session
        recent = present.times > present.times[-1] - RECENT
        # Its position counts, even if its heading cannot be predicted.
        seen = np.where(present.z[recent] != 0, present.z[recent], np.nan)
        tracks = np.flatnonzero(np.isfinite(seen).any(axis=0))
        if not tracks.size:
            raise ValueError('no particle is in view')
        seen = seen[:, tracks]
        last = len(seen) - 1 - np.isfinite(seen[::-1]).argmax(axis=0)
        little = _little(fit.model, search.odds)
        everywhere = slice(None)
        return cls(
            fit, questions, search, little,
            _gram(fit.session_fits[0], present, _strengths(fit, little, present, everywhere)),
            _covered(fit, present, everywhere, limits.workspace), tracks,
            as_vectors(seen[last, np.arange(len(tracks))]), begin, limits,
            [_gram(q.second.session_fits[0], present, columns)
             for q, columns in zip(questions, _columns(questions, present, everywhere),
                                   strict=True)],
            np.array([q.missing for q in questions]), np.array([q.weight for q in questions]))

    def score(self, plan: Plan) -> _Outcome:
        """Return what is expected of a `plan`."""
        commands = plan.commands(self.begin)
        times = self.begin + np.arange(0.0, plan.duration, STEP)
        known = self.fit.session_fits[0]
        particles = ParticleParameters.from_velocity_phasor(
            known.session.ids[self.tracks], known.velocity_phasor[self.tracks])
        # A path that is off by some micrometres is accurate enough.
        plain = replace(self.fit.model, effects=tuple(
            e for e in self.fit.model.effects if not e.needs_position))
        places = simulate(plain, particles, commands, times, self.start)
        z = places[..., 0] + 1j * places[..., 1]
        trial = replace(
            known.session, ids=known.session.ids[self.tracks], times=times, z=z,
            pieces=np.ones(z.shape, int), causal_positions=places, commands=commands,
            jumps=np.zeros(len(self.tracks), int))
        astray = 1 - float(self.limits.workspace.holds(places, MARGIN).mean())
        return _Outcome(self, trial, astray, _touching(z, known.session.conditions.radius))

    def gains(self, trial: PreparedSession) -> np.ndarray:
        """Return the growth of S (Q,) for every question in a trial."""
        gains = []
        for question, columns, past, before in zip(
                self.questions, _columns(self.questions, trial, self.tracks), self.past,
                self._apart_before, strict=True):
            total = past.copy()
            total[self.tracks] += _gram(question.second.session_fits[0], trial, columns)
            gains.append(max(_separation(total) - before, 0.0))
        return np.array(gains)

    def shown(self, trial: PreparedSession) -> float:
        """Return the information that a trial adds on smooth velocities in no list.

        The log of the information: velocities that were hardly known before count most.
        """
        total = self.known.copy()
        total[self.tracks] += _covered(self.fit, trial, self.tracks, self.limits.workspace)
        return float(np.log(_power(total) / self._power_before).sum())

    @cached_property
    def _power_before(self) -> np.ndarray:
        return _power(self.known)

    def sought(self, trial: PreparedSession) -> np.ndarray:
        """Return the information (E,) that a trial adds on effects in search, beside v and φ."""
        fit = self.fit.session_fits[0]
        total = self.seen.copy()
        total[self.tracks] += _gram(
            fit, trial, _strengths(self.fit, self.little, trial, self.tracks))
        added = (np.diagonal(eliminate(total).sum(axis=0)) - self._sought_before)[1:]
        result = np.zeros(len(self.search.odds))
        np.add.at(result, [place for place, _ in self.little], np.maximum(added, 0.0))
        return result

    @cached_property
    def _sought_before(self) -> np.ndarray:
        return np.diagonal(eliminate(self.seen).sum(axis=0))

    @cached_property
    def _apart_before(self) -> list[float]:
        return [_separation(past) for past in self.past]


def _columns(questions: Sequence[Question], session: PreparedSession,
             tracks: np.ndarray | slice) -> list[np.ndarray]:
    """Return columns (T, N, 3 + P) [m] for each of the `questions`.

    The difference of the two, v and φ of the second, and its parameters, in a `session` that has
    the `tracks` of the one that all were fitted to.
    """
    fits = {id(fit): fit for q in questions for fit in (q.first, q.second)}
    here = {key: _expected(fit, fit.model, session, tracks) for key, fit in fits.items()}
    changes = {key: _changes(fits[key], here[key], session, tracks)
               for key in {id(q.second) for q in questions}}
    return [np.stack([here[id(q.first)] - here[id(q.second)], *changes[id(q.second)]], axis=-1)
            for q in questions]


def _expected(fit: ModelFit, model: Model, session: PreparedSession, tracks: np.ndarray | slice,
              ) -> np.ndarray:
    """Return displacements (T, N) [m] by a `model`, of the particles of a `fit`."""
    own = fit.session_fits[0].velocity_phasor[tracks]
    return ExpectedDisplacement.of(model, session.timeline).at(own)


def _changes(fit: ModelFit, here: np.ndarray, session: PreparedSession,
             tracks: np.ndarray | slice) -> list[np.ndarray]:
    """Return derivatives of the displacements `here` (T, N) [m] by v, φ and each parameter."""
    expected = ExpectedDisplacement.of(fit.model, session.timeline)
    changes = [np.broadcast_to(one, here.shape) for one in (expected.along, expected.across)]
    x = fit.model.vector()
    for k, step in enumerate(difference_steps(fit.model)):
        x[k] += step
        moved = _expected(fit, fit.model.with_vector(x), session, tracks)
        changes.append((moved - here) / step)
        x[k] -= step
    return changes


def _little(model: Model, names: Iterable[str]) -> list[tuple[int, Model]]:
    """Return, per strength of effects `names`, its effect's index and a model with a little."""
    return [(place, model.with_effect(replace(
        EFFECTS[name].null(), **{p.field: p.from_fit(min(LITTLE, p.fit_bounds[1]))})))
        for place, name in enumerate(names)
        for p in EFFECTS[name].parameters() if not p.shape]


def _strengths(fit: ModelFit, little: Sequence[tuple[int, Model]], session: PreparedSession,
               tracks: np.ndarray | slice) -> np.ndarray:
    """Return columns (T, N, 3 + L) [m]: zero, v and φ, and a little of each strength."""
    phasor, timeline = fit.session_fits[0].velocity_phasor[tracks], session.timeline
    expected = ExpectedDisplacement.of(fit.model, timeline)
    here = expected.at(phasor)
    moved = [ExpectedDisplacement.of(model, timeline).at(phasor) - here for _, model in little]
    columns = [np.zeros(1), expected.along, expected.across, *moved]
    return np.stack([np.broadcast_to(one, session.z.shape) for one in columns], axis=-1).astype(
        complex)


def _gram(fit: SessionFit, session: PreparedSession, columns: np.ndarray) -> np.ndarray:
    """Return inner products (N, M, M) of `columns` (T, N, M) [m], in units of a fit's noise."""
    plain = Whitening(fit.whitening.noise_ratio)
    return inner(plain.apply(session, np.ascontiguousarray(columns))[0]) / fit.diffusion


def _touching(z: np.ndarray, radius: float | None) -> float:
    """Return the fraction of time that particles at z (T, N) [m] are nearer than APART.

    0 if their `radius` [m] is not known.
    """
    if radius is None:
        return 0.0
    return float((nearest(z) < APART * radius).mean())


def _separation(gram: np.ndarray) -> float:
    """Return ½ of the first column's power beside v, φ and shared parameters."""
    left = eliminate(gram).sum(axis=0)
    return max(float(eliminate_shared(left, len(left) - 1)[0, 0]), 0.0) / 2


def _covered(fit: ModelFit, session: PreparedSession, tracks: np.ndarray | slice,
             view: Workspace) -> np.ndarray:
    """Return inner products (N, M, M) of zero, v and φ, a drift, and velocities in no list.

    These are smooth velocities that depend on place in the `view` (10 of them), heading (3),
    strength, age or the time since a switch, in a `session` that has the `tracks` of the fitted
    one.
    """
    expected = ExpectedDisplacement.of(fit.model, session.timeline)
    own = np.diff(expected.at(fit.session_fits[0].velocity_phasor[tracks]), axis=0)
    moving = np.abs(own) > 0
    heading = np.where(moving, own / np.where(moving, np.abs(own), 1.0), 0)
    begin, times = fit.session_fits[0].session.times[0], session.times[:-1]
    commands = session.commands
    since = times - commands.t[np.maximum(commands.index_at(times), 0)]
    level = np.hypot(*commands.field_at(times).T) / max(fit.model.reference_field, 1e-30)
    x, y = _across(view, session.causal_positions[:-1])
    one = np.ones_like(heading)
    columns = [one, 1j * one, *(way * part for part in (x, y, x * y, x * x, y * y)
                                for way in (1, 1j)),
               heading**2, heading.conj() ** 2, heading**3, heading * level[:, None],
               heading * ((times - begin) / AGE)[:, None],
               heading * np.exp(-since / RECOVERY)[:, None]]
    interval = np.diff(session.times)[:, None]
    moved = [np.concatenate([np.zeros((1, part.shape[1])), np.cumsum(part * interval, axis=0)])
             for part in columns]
    every = [np.zeros(1), expected.along, expected.across, *moved]
    return _gram(fit.session_fits[0], session, np.stack(
        [np.broadcast_to(part, session.z.shape) for part in every], axis=-1).astype(complex))


def _across(view: Workspace, places: np.ndarray) -> np.ndarray:
    """Return places (T, N, 2) [m] in units of the `view` (2, T, N): from −1 to 1 at its edges."""
    low, high = (np.where(np.isfinite(edge), edge, default) for edge, default in (
        (view.low, np.nanmin(places, axis=(0, 1))), (view.high, np.nanmax(places, axis=(0, 1)))))
    half = np.maximum(high - low, 1e-9) / 2
    return np.moveaxis(np.nan_to_num((places - (low + high) / 2) / half), -1, 0)


def _power(gram: np.ndarray) -> np.ndarray:
    """Return the power of each later column beside v, φ and a drift, plus prior information."""
    return np.diagonal(eliminate_shared(eliminate(gram).sum(axis=0), 2))[1:] + SHOWN


# Drawing plans ----------------------------------------------------------------------------------

def _draw(rng: np.random.Generator, duration: float, limits: Range) -> Plan:
    """Return a plan with random holds, turns, senses and field levels."""
    usual = np.exp(rng.uniform(np.log(0.4), np.log(duration / 3)))
    spread = rng.choice([1.0, 1.6, 4.0])
    count = int(duration / (usual / spread)) + 2
    hold = usual * np.exp(rng.uniform(-np.log(spread), np.log(spread), count))
    angle = _angles(rng, count)
    level = np.ones(count)
    if rng.random() < 0.6:
        lower = rng.uniform(0.15, 0.6, int(rng.integers(1, 3)))
        level = rng.choice(np.append(1.0, lower), count)
    return Plan(angle, limits.field * level, hold, _frequencies(rng, count, limits)).lasting(
        duration)


def _angles(rng: np.random.Generator, count: int) -> np.ndarray:
    """Return random angles, turns of one or two sizes, or reversals."""
    kind = rng.integers(4)
    if kind == 0:
        return rng.uniform(-np.pi, np.pi, count)
    turn = rng.choice(np.radians([15, 30, 60, 90, 120, 150, 165, 175]), 2)
    sense = rng.choice([-1.0, 1.0], count) if kind == 1 else np.resize([1.0, -1.0], count)
    turns = sense * (np.resize(turn, count) if kind < 3 else np.pi - 0.05)
    if kind == 3:  # there and back, along another line now and then
        turns += np.where(np.arange(count) % 4 == 3, rng.uniform(-np.pi, np.pi, count), 0.0)
    return rng.uniform(-np.pi, np.pi) + np.cumsum(turns)


def _frequencies(rng: np.random.Generator, count: int, limits: Range) -> np.ndarray | None:
    if limits.frequency is None:
        return None
    low, high = np.log(limits.frequency)
    return np.exp(rng.uniform(low, high, count))


def _change(rng: np.random.Generator, plan: Plan, other: Plan, limits: Range, k: int) -> Plan:
    """Return a plan with one part changed: the kinds of change in turn."""
    duration = plan.duration
    kind, count = k % 5, len(plan.hold)
    here = rng.random(count) < max(0.25, 1 / count)
    if kind == 0:
        return replace(plan, angle=plan.angle + here * rng.normal(0.0, 0.7, count))
    if kind == 1:
        level = np.where(here, limits.field * rng.choice([1.0, 1.0, 0.5, 0.3, 0.15], count),
                         plan.strength)
        return replace(plan, strength=level)
    if kind == 2:
        return replace(plan, hold=plan.hold * np.exp(here * rng.normal(0.0, 0.6, count))).lasting(
            duration)
    if kind == 3:
        return replace(plan, angle=plan.angle + rng.uniform(-np.pi, np.pi))
    cut = rng.uniform(0.2, 0.8) * duration
    return plan.lasting(cut).then(other.lasting(duration - cut))
