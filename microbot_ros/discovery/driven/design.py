"""The commands that tell most: sequences of fields, by what they are expected to decide.

Two explanations of all that was seen, a and b, expect displacements μ_a and μ_b. What a plan tells
them apart by is the expected growth of

    S = ½ min ‖W(μ_a − μ_b)‖²,

W whitening, the minimum over v and φ of every particle and over b's parameters, of the past and
the plan together, since what the past has fixed a plan need not fix again. The log likelihood
ratio of the two grows by S if a holds, and but for second order by the same if b does.
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
from microbot_ros.estimation.likelihood.prepared_session import PreparedSession, distances
from microbot_ros.model.effects import EFFECTS
from microbot_ros.model.first_order import simulate
from microbot_ros.model.increments import as_vectors
from microbot_ros.model.model import Model, ParticleParameters

STEP = 0.2
"""Seconds between the frames of a plan that is tried out."""

RECENT = 2.0
"""Seconds within which a particle must have been seen last to count as present."""

RANDOM, PROPOSED, IMPROVED = 3, 24, 24
"""Random steps and plans of other kinds that are drawn; changes tried on the best of them."""

MARGIN = 10e-6
"""Distance from the edge of the view [m] that particles should keep."""

STRAY = 20.0
"""What a plan pays for the part of its time that particles would spend out of view or touching."""

APART = 3.0
"""Radii between the centres of spheres that are not to touch: what contact does is in no list."""

LONGEST = 20.0
"""Times its own duration for which a plan is thought ahead."""

FAINT = 10.0 / 2 / 60
"""Log evidence a second that usual plans bring, for an effect that has not shown yet."""

LITTLE = 0.02
"""Strength, in fit coordinates, at which it is asked what a plan shows of an effect."""

AGE, RECOVERY = 60.0, 0.5
"""Seconds in which something ages, and in which it recovers from a switch."""

SHOWN = (0.1e-6) ** -2
"""Information [s²/m²] about a velocity that is there before anything was seen: 0.1 µm/s."""

STARVED = 0.2
"""Part of what plans usually show of what is in no list below which a plan pays for hiding it."""


@dataclass(frozen=True)
class Range:
    """What a rig can be asked for.

    The strongest `field` [T]; the `workspace` that is in view; `frequency` [Hz], lowest and
    highest of a rolling field, None for particles that swim by themselves.
    """

    field: float
    workspace: Workspace
    frequency: tuple[float, float] | None = None


@dataclass(frozen=True)
class Question:
    """Two explanations to be told apart: `first` and `second`, fits to the same data.

    `missing` is the log evidence that is still to come until it is decided, above 0, and `weight`
    what its answer is worth beside others.
    """

    first: ModelFit
    second: ModelFit
    missing: float
    weight: float = 1.0


@dataclass(frozen=True)
class Search:
    """Effects that have not shown yet: how likely each is, `odds` by name, and what is `missing`.

    Of their strength nothing is known: a plan is held against what plans usually show of them.
    """

    odds: Mapping[str, float]
    missing: float


@dataclass(frozen=True)
class Design:
    """The `plan` chosen.

    `best` (Q,): what each question is expected to gain by the best plan for it alone of all that
    were tried; `worth`: how many times as long random steps are expected to take, at most
    LONGEST, as far as plans are thought ahead.
    """

    plan: Plan
    best: np.ndarray
    worth: float = 1.0


def random_steps(rng: np.random.Generator, duration: float, limits: Range) -> Plan:
    """For a `duration` [s]: directions from the circle, each held for 0.3 to 6 s, by `rng`.

    At full, half and quarter field of the `limits`.
    """
    count = int(duration / 0.3) + 1
    hold = np.exp(rng.uniform(np.log(0.3), np.log(6.0), count))
    return Plan(
        rng.uniform(-np.pi, np.pi, count), limits.field * rng.choice([1.0, 0.5, 0.25], count),
        hold, _frequencies(rng, count, limits)).lasting(duration)


def choose_plan(fit: ModelFit, questions: Sequence[Question], search: Search | None,
                begin: float, duration: float, limits: Range, rng: np.random.Generator) -> Design:
    """The plan of `duration` [s] that answers `questions` soonest, from `begin` [s] on.

    On the clock of the session of a `fit`, the present explanation of it. What is still in
    `search` of counts by its odds; None: it is only asked what gains most, by weight. Plans of
    several kinds are drawn by `rng`; the best is then changed as long as that makes it better.
    ValueError where no particle is in view.
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


# What a plan is worth ---------------------------------------------------------------------------

@dataclass(frozen=True)
class _Outcome:
    """What is expected of a plan that was tried in a `trial`, and seen as a `session`.

    Which part of their time particles are `astray` and `touching`; the rest when it is asked for.
    """

    trial: _Trial
    session: PreparedSession
    astray: float
    touching: float

    @cached_property
    def gains(self) -> np.ndarray:
        """By how much S (Q,) of every question grows."""
        return self.trial.gains(self.session)

    @cached_property
    def search(self) -> np.ndarray:
        """Information (E,) about each effect in search."""
        return self.trial.sought(self.session)

    @cached_property
    def shown(self) -> float:
        """How much it would add to what is known of what is in no list."""
        return self.trial.shown(self.session)

    @property
    def spoilt(self) -> float:
        """What it costs, as a factor, that particles are where nothing is to be learned."""
        return 1 + STRAY * (self.astray + self.touching)


@dataclass(frozen=True)
class _Price:
    """What a plan costs: the seconds until all is answered, as far as these can be foreseen.

    The longest question and the mean by weight; more for hiding what is in no list, beside what
    plans of that `duration` [s] usually show of it, and for particles astray or touching.
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
        # Where nothing is asked, what is in no list is all there is to look for.
        useful = min(shown / STARVED, 1.0) if trial.questions else shown
        return spent * outcome.spoilt / max(useful, 1e-3)


@dataclass(frozen=True)
class _Divergence:
    """What a plan costs where all that counts is how far apart it sets what may be true: the
    inverse of its gains by weight (Box and Hill 1967); more for particles astray or touching."""

    trial: _Trial

    def __call__(self, outcome: _Outcome) -> float:
        apart = float(self.trial.weight @ outcome.gains)
        return outcome.spoilt / max(apart, 1e-9)


@dataclass(frozen=True)
class _Trial:
    """Plans tried out on the particles that are in view, all questions at once.

    `tracks` of those particles in the session of `fit`, that `start` (N, 2) [m] where they were
    last; `past`: for each question the inner products (N, M, M) of its columns over what was seen;
    `little`: for each strength of the effects in `search` their place there and the model with a
    little of it, `seen` (N, M, M) the inner products of what these do, `known` (N, M, M) those of
    what may be in no list.
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
        # Where it is counts, though chance may have turned it in a way that nothing foretells.
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
        """What is expected of a `plan`."""
        commands = plan.commands(self.begin)
        times = self.begin + np.arange(0.0, plan.duration, STEP)
        known = self.fit.session_fits[0]
        particles = ParticleParameters.from_velocity_phasor(
            known.session.ids[self.tracks], known.velocity_phasor[self.tracks])
        # Where they come by is what matters, not to the last micrometre.
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
        """By how much S (Q,) of every question grows in a trial."""
        gains = []
        for question, columns, past, before in zip(
                self.questions, _columns(self.questions, trial, self.tracks), self.past,
                self._apart_before, strict=True):
            total = past.copy()
            total[self.tracks] += _gram(question.second.session_fits[0], trial, columns)
            gains.append(max(_separation(total) - before, 0.0))
        return np.array(gains)

    def shown(self, trial: PreparedSession) -> float:
        """How much a trial would add to what is known of smooth velocities in no list: the log
        of the information, what was hardly known before counts most."""
        total = self.known.copy()
        total[self.tracks] += _covered(self.fit, trial, self.tracks, self.limits.workspace)
        return float(np.log(_power(total) / self._power_before).sum())

    @cached_property
    def _power_before(self) -> np.ndarray:
        return _power(self.known)

    def sought(self, trial: PreparedSession) -> np.ndarray:
        """Information (E,) that a trial adds about the effects in search, what v and φ leave."""
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
    """For each of the `questions` what tells the two apart, v and φ of the second, and its
    parameters: (T, N, 3 + P) [m].

    In a `session`, which has the `tracks` of the one that all were fitted to.
    """
    fits = {id(fit): fit for q in questions for fit in (q.first, q.second)}
    here = {key: _expected(fit, fit.model, session, tracks) for key, fit in fits.items()}
    changes = {key: _changes(fits[key], here[key], session, tracks)
               for key in {id(q.second) for q in questions}}
    return [np.stack([here[id(q.first)] - here[id(q.second)], *changes[id(q.second)]], axis=-1)
            for q in questions]


def _expected(fit: ModelFit, model: Model, session: PreparedSession, tracks: np.ndarray | slice,
              ) -> np.ndarray:
    """Displacements (T, N) [m] by a `model`, of particles as they are by a `fit`."""
    own = fit.session_fits[0].velocity_phasor[tracks]
    return ExpectedDisplacement.of(model, session.timeline).at(own)


def _changes(fit: ModelFit, here: np.ndarray, session: PreparedSession,
             tracks: np.ndarray | slice) -> list[np.ndarray]:
    """What v, φ and each parameter change about the displacements `here` (T, N) [m] by a `fit`."""
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
    """For every strength of the effects `names`, their place and a `model` with a little of it."""
    return [(place, model.with_effect(replace(
        EFFECTS[name].null(), **{p.field: p.from_fit(min(LITTLE, p.fit_bounds[1]))})))
        for place, name in enumerate(names)
        for p in EFFECTS[name].parameters() if not p.shape]


def _strengths(fit: ModelFit, little: Sequence[tuple[int, Model]], session: PreparedSession,
               tracks: np.ndarray | slice) -> np.ndarray:
    """Nothing, v and φ, and what a little of each strength does: columns (T, N, 3 + L) [m]."""
    phasor, timeline = fit.session_fits[0].velocity_phasor[tracks], session.timeline
    expected = ExpectedDisplacement.of(fit.model, timeline)
    here = expected.at(phasor)
    moved = [ExpectedDisplacement.of(model, timeline).at(phasor) - here for _, model in little]
    columns = [np.zeros(1), expected.along, expected.across, *moved]
    return np.stack([np.broadcast_to(one, session.z.shape) for one in columns], axis=-1).astype(
        complex)


def _gram(fit: SessionFit, session: PreparedSession, columns: np.ndarray) -> np.ndarray:
    """Inner products (N, M, M) of `columns` (T, N, M) [m] of a `session`, in units of the noise of
    a `fit`."""
    plain = Whitening(fit.whitening.noise_ratio)
    return inner(plain.apply(session, np.ascontiguousarray(columns))[0]) / fit.diffusion


def _touching(z: np.ndarray, radius: float | None) -> float:
    """Part of their time that particles at places z (T, N) [m] spend nearer than APART to another.

    None of it where their `radius` [m] is not known.
    """
    if radius is None:
        return 0.0
    return float((distances(z).min(axis=2) < APART * radius).mean())


def _separation(gram: np.ndarray) -> float:
    """½ of what is left of the first column, v and φ of all and shared parameters projected off.
    """
    left = eliminate(gram).sum(axis=0)
    return max(float(eliminate_shared(left, len(left) - 1)[0, 0]), 0.0) / 2


def _covered(fit: ModelFit, session: PreparedSession, tracks: np.ndarray | slice,
             view: Workspace) -> np.ndarray:
    """Inner products (N, M, M) of nothing, v and φ, a drift, and what may be in no list.

    Those are smooth velocities that depend on place in the `view` (10 of them), heading (3),
    strength, age or the time since a switch; what they do in a `session` that has the `tracks` of
    the one that was fitted.
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
    """Where in the `view` places (T, N, 2) [m] are, (2, T, N): −1 at one edge, 1 at the other."""
    low, high = (np.where(np.isfinite(edge), edge, default) for edge, default in (
        (view.low, np.nanmin(places, axis=(0, 1))), (view.high, np.nanmax(places, axis=(0, 1)))))
    half = np.maximum(high - low, 1e-9) / 2
    return np.moveaxis(np.nan_to_num((places - (low + high) / 2) / half), -1, 0)


def _power(gram: np.ndarray) -> np.ndarray:
    """What v, φ and a drift leave of each of the columns after them, and what was known before."""
    return np.diagonal(eliminate_shared(eliminate(gram).sum(axis=0), 2))[1:] + SHOWN


# Drawing plans ----------------------------------------------------------------------------------

def _draw(rng: np.random.Generator, duration: float, limits: Range) -> Plan:
    """A plan of some kind: how long, how far and in which senses it turns are all drawn."""
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
    """From anywhere on the circle; by turns of one or two sizes; or to and fro."""
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
    """A plan with a part changed: one kind of change after the other."""
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
