"""Controllers in the fine simulated world: how near, how fast, how safely switched."""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterator

import numpy as np

from bench._closed_loop import FIELD, Loop
from bench._switches import switched
from bench.figure import Figure
from microbot_ros.control.contract import Controller, ControllerInput, Goals
from microbot_ros.control.planning.route import Route
from microbot_ros.control.planning.shared import as_complex, best_displacement, floor
from microbot_ros.control.plugins.ensemble import Ensemble
from microbot_ros.control.plugins.path_following import PathFollowing
from microbot_ros.control.plugins.predictive import Predictive, PredictiveParameters
from microbot_ros.control.plugins.waypoint import Waypoint
from microbot_ros.control.steering.drift_compensator import DriftCompensator
from microbot_ros.model.effects.velocity.hydrodynamic_slowdown import HydrodynamicSlowdown
from microbot_ros.model.effects.velocity.uniform_drift import UniformDrift
from microbot_ros.model.model import Model

ISSUE = 7


def figures() -> Iterator[Figure]:
    """Every figure of the controllers."""
    spent: list[float] = []
    yield from _path(spent)
    yield from _goals(spent)
    yield _ensemble(spent)
    yield from _predictive()
    yield Figure(ISSUE, 'time per tick, all but predictive, p99', _p99(spent), 'ms', '≤ 1',
                 'processor time', _p99(spent) <= 1)
    yield from _switches()


def _p99(spent: list[float]) -> float:
    return float(np.percentile(spent, 99)) * 1e3


# Figure of eight -----------------------------------------------------------------------------

EIGHT = np.linspace(0, 2 * np.pi, 401)
EIGHT_PATH = np.column_stack((40e-6 * np.sin(EIGHT), 20e-6 * np.sin(2 * EIGHT)))
EIGHT_PATH[-1] = EIGHT_PATH[0]
DRIFT = cmath.rect(0.5e-6, 0.7)


class _Knowing(DriftCompensator):
    """Told the true position now, the true answer to the field and the drift."""

    ready = True  # type: ignore[assignment]
    answer = cmath.rect(4e-6, -1.09)  # type: ignore[assignment]
    drift = DRIFT  # type: ignore[assignment]

    def __init__(self, loop: Loop) -> None:
        super().__init__()
        self._loop = loop

    def look(self, inputs: ControllerInput, row: int) -> complex:
        return complex(*self._loop.world.position[row])


def _cross_track(seed: int, *, knowing: bool, spent: list[float]) -> float:
    """Mean square [m²] of the distance from the path."""
    late = {'age': 0.0, 'delay': 0.0} if knowing else {}
    loop = Loop(EIGHT_PATH[:1].copy(), np.array([4e-6]), np.array([-1.09]), {
        'uniform_drift': {'wx_um_s': DRIFT.real * 1e6, 'wy_um_s': DRIFT.imag * 1e6}},
        seed=seed, told=False, **late)
    controller = PathFollowing()
    if knowing:
        controller._compensator = _Knowing(loop)
    route, off, along = Route(EIGHT_PATH), [], [0.0]

    def note(t: float) -> None:
        place = complex(*loop.world.position[0])
        along[0] = route.nearest(place, along[0], 1e-5)
        point, way = route.at(along[0])
        if t > 20:
            off.append(((place - point) * way.conjugate()).imag)

    loop.run(controller, 120, note, path=EIGHT_PATH)
    spent += loop.spent
    return float(np.mean(np.square(off)))


def _path(spent: list[float]) -> list[Figure]:
    seeds = range(3)
    ours = math.sqrt(np.mean([
        _cross_track(k, knowing=False, spent=spent) for k in seeds]))
    best = math.sqrt(np.mean([
        _cross_track(k, knowing=True, spent=[]) for k in seeds]))
    return [Figure(
        ISSUE, 'figure of eight, RMS cross-track', ours / best, '×', '≤ 1.3',
        f'the same law knowing the truth without delay: {best * 1e6:.3f} µm', ours <= 1.3 * best)]


# Goals ---------------------------------------------------------------------------------------

GOALS = ((30, 0), (-25, 40), (10, -12), (-60, -20))


def _goals(spent: list[float]) -> list[Figure]:
    """The slowest of several goals, from rest to within the arrival distance."""
    still = max(_slowness(goal, 0j, seed, spent) for seed, goal in enumerate(GOALS))
    drifting = max(_slowness(goal, DRIFT, seed, spent) for seed, goal in enumerate(GOALS))
    return [
        Figure(ISSUE, 'one particle to goals, slowest', still, '×', '≤ 1.15', 'distance / v',
               still <= 1.15),
        Figure(ISSUE, 'one particle to goals in a drift of 0.5 µm/s, slowest', drifting, '×',
               '≤ 1.15', 'distance / speed made good, knowing the drift', drifting <= 1.15),
    ]


def _slowness(goal_um: tuple[float, float], drift: complex, seed: int,
              spent: list[float]) -> float:
    """Time to a goal over that of a particle that swims straight there, crabbed perfectly."""
    goal, arrived, v = 1e-6 * np.array([goal_um]), [], 4e-6
    loop = Loop(np.zeros((1, 2)), np.array([v]), np.array([2.2]), {
        'uniform_drift': {'wx_um_s': drift.real * 1e6, 'wy_um_s': drift.imag * 1e6}}, seed=seed)
    distance = float(np.hypot(*goal[0])) - 2e-6
    along = drift * cmath.exp(-1j * cmath.phase(complex(*goal_um)))
    ideal = distance / (along.real + math.sqrt(v**2 - along.imag**2))

    def note(t: float) -> None:
        if np.hypot(*(loop.world.position - goal)[0]) <= 2e-6:
            arrived.append(t)

    loop.run(Waypoint(), 1.5 * ideal, note, goals=Goals(goal))
    spent += loop.spent
    return (arrived[0] if arrived else math.inf) / ideal


# Many particles ------------------------------------------------------------------------------

def _ensemble(spent: list[float]) -> Figure:
    """The worst of 2 to 10 particles: RMS error on arrival over the floor at the start.

    Each with four draws of noise, for what Brownian motion does in the meantime is chance.
    """
    ratios = []
    for count in range(2, 11):
        rng = np.random.default_rng(count)
        position = rng.uniform(-60e-6, 60e-6, (count, 2))
        goal = position + rng.uniform(-30e-6, 30e-6, (count, 2))
        speed, phi = rng.uniform(3e-6, 5e-6, count), rng.uniform(-np.pi, np.pi, count)
        velocity, wanted = speed * np.exp(1j * phi), as_complex(goal - position)
        ends = []
        for seed in range(4):
            loop = Loop(position, speed, phi, seed=seed)
            seconds = abs(best_displacement(velocity, wanted)) + 1
            ends.append(np.mean(np.square(_errors(loop, Ensemble(), goal, seconds)[-30:])))
            spent += loop.spent
        ratios.append(math.sqrt(np.mean(ends)) / floor(velocity, wanted))
    return Figure(ISSUE, 'ensemble of 2 to 10, worst final error', max(ratios), '×', '≤ 1.1',
                  'the floor of the first-order model', max(ratios) <= 1.1)


def _errors(loop: Loop, controller: Controller, goal: np.ndarray, seconds: float) -> list[float]:
    errors: list[float] = []

    def note(_: float) -> None:
        off = loop.world.position - goal
        errors.append(float(np.sqrt(np.mean(np.sum(off**2, axis=1)))))

    loop.run(controller, seconds, note, goals=Goals(goal))
    return errors


def _predictive() -> list[Figure]:
    """Two particles whose alignment times are 0.1 and 0.3 s, to goals one field can't serve."""
    ratios = []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        position = np.array([[-20e-6, 0], [20e-6, 0]])
        angle = rng.uniform(-np.pi, np.pi, 2)
        goal = position + 20e-6 * np.column_stack((np.cos(angle), np.sin(angle)))
        speed, phi = np.full(2, 4e-6), rng.uniform(-np.pi, np.pi, 2)
        loop = Loop(position, speed, phi, {'alignment_lag': {'tau_s': [0.1, 0.3]}}, seed=seed,
                    model=Model(FIELD))
        controller = Predictive()
        controller.configure(PredictiveParameters(alignment_times_s=[0.1, 0.3]))
        errors = _errors(loop, controller, goal, 35.0)
        lowest = floor(speed * np.exp(1j * phi), as_complex(goal - position))
        ratios.append(float(np.mean(errors[-300:])) / lowest)
    worst = max(ratios)
    return [Figure(ISSUE, 'two particles, lags 3:1, predictive, worst final error', worst, '×',
                   '≤ 0.5', 'the first-order floor', worst <= 0.5), _thinking()]


def _thinking() -> Figure:
    """The slowest of 2, 5 and 10 particles with an obstacle, lags of their own and two effects."""
    slowest = 0.0
    model = Model(FIELD, effects=(UniformDrift(0.3e-6, 0.1e-6), HydrodynamicSlowdown(1e-6)))
    for count in (2, 5, 10):
        rng = np.random.default_rng(count)
        position = rng.uniform(-60e-6, 60e-6, (count, 2))
        lags = np.linspace(0.1, 0.4, count).tolist()
        loop = Loop(position, rng.uniform(3e-6, 5e-6, count), rng.uniform(-np.pi, np.pi, count),
                    {'alignment_lag': {'tau_s': lags}}, model=model)
        controller = Predictive()
        controller.configure(PredictiveParameters(
            alignment_times_s=lags, obstacles_um=[0.0, 0.0, 8.0]))
        _errors(loop, controller, position + rng.uniform(-3e-5, 3e-5, (count, 2)), 10.0)
        slowest = max(slowest, _p99(loop.spent))
    return Figure(ISSUE, 'time per tick, predictive with 2, 5, 10 particles, worst p99', slowest,
                  'ms', '≤ 8', 'processor time', slowest <= 8)


# Switches ---------------------------------------------------------------------------------------

def _switches() -> list[Figure]:
    """1,000 switches at 100 Hz, two ticks each, among all controllers and faulty ones."""
    found = switched()
    tolerance = 1 + 1e-9
    stood = f'besides {found.stalled} while the machine stood still' if found.stalled else ''
    return [
        Figure(ISSUE, '1,000 swaps at 100 Hz: ticks missed', found.missed, '', '0', stood,
               found.missed == 0),
        Figure(ISSUE, '1,000 swaps: steepest step', found.steepest, '×', '≤ 1',
               'the declared slew', found.steepest <= tolerance),
        Figure(ISSUE, '1,000 swaps: strongest command', found.strongest, '×', '≤ 1', 'the limit',
               found.strongest <= tolerance),
    ]
