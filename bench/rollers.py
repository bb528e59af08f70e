"""Many rollers to many goals, and a bead that one of them pushes, in physics that is finer than
what controllers know of: moments that slip, water that rollers stir, Brownian motion, contact.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench._rolling_loop import Rollers, RollingLoop
from bench.figure import Figure, sized
from microbot_ros.control.contract import ControllerInput, FieldCommand, Goals
from microbot_ros.control.manager import Outcome
from microbot_ros.control.planning.route import Route
from microbot_ros.control.planning.shared import as_complex, floor
from microbot_ros.control.plugins.pushing import Pushing, PushingParameters
from microbot_ros.control.plugins.swarm import Swarm, SwarmParameters

ISSUE = 19
SEEDS = sized(100, 8)
COUNT = 10
WALLS_UM = (0.0, -104.0, 0.0, -20.0, 0.0, 20.0, 0.0, 104.0)
"""A wall across the view, with a slit of 40 µm, that is 9 diameters."""
RADIUS = 2.3e-6
_PUSHES = sized(20, 3)
_NEAR = 5e-6
_KNOWN = 0.04
"""How well gain and φ are known: what the model node reaches."""


def figures() -> Iterator[Figure]:
    """All of them."""
    yield from _slit()
    yield from _pushed()


# Ten through a slit ----------------------------------------------------------------------------

@dataclass(frozen=True)
class Passage:
    """What came of one draw: `error` (N,) [m] 5 s after the controller said that all are there,
    who `touched` (N,), when it said so, how long it computed to plan, and the RMS [m] that is
    left to one field for all that does not tell them apart.
    """

    error: np.ndarray
    touched: np.ndarray
    took: float
    planned: float
    peer: float

    @property
    def arrived(self) -> bool:
        """Whether all are at their goals, and nobody met anything."""
        return bool((self.error <= _NEAR).all()) and not self.touched.any()


class _Timed(Swarm):
    """Sums up what the search for ways takes."""

    planned = 0.0

    def compute(self, inputs: ControllerInput) -> FieldCommand:
        begun = time.thread_time()
        command = super().compute(inputs)
        if command.progress.message == 'planning paths':
            self.planned += time.thread_time() - begun
        return command


def rollers(rng: np.random.Generator, count: int) -> Rollers:
    """So many that differ: step-outs from 6 to 36 Hz at even ratios, each off by up to a fifth of
    the way to the next; 2.4 to 3.6 µm per turn; φ within ± 0.5 rad.
    """
    ratio = 6 ** (1 / max(count - 1, 1))
    step_out = 6 * ratio ** (np.arange(count) + rng.uniform(-0.2, 0.2, count))
    return Rollers(rng.uniform(2.4e-6, 3.6e-6, count), rng.uniform(-0.5, 0.5, count),
                   rng.permutation(step_out), np.full(count, RADIUS))


def scatter(rng: np.random.Generator, count: int, left: float, right: float) -> np.ndarray:
    """So many places (`count`, 2) [m] between `left` and `right` [m], 24 µm apart."""
    places = np.empty((0, 2))
    while len(places) < count:
        place = np.array([rng.uniform(left, right), rng.uniform(-90e-6, 90e-6)])
        if (np.hypot(*(places - place).T) >= 24e-6).all():
            places = np.vstack([places, place])
    return places


def passage(seed: int, count: int = COUNT, seconds: float = 900.0) -> Passage:
    """From one side of the wall to the other, each to a place of its own."""
    rng = np.random.default_rng(seed)
    start, goal = (scatter(rng, count, *side) for side in ((-125e-6, -25e-6), (25e-6, 125e-6)))
    them = rollers(rng, count)
    controller = _Timed()
    controller.configure(SwarmParameters(walls_um=list(WALLS_UM)))
    loop = RollingLoop(them, start, seed, walls=1e-6 * np.array(WALLS_UM))
    done: list[float] = []

    def note(t: float, outcome: Outcome) -> bool:
        if outcome.command is not None and outcome.command.progress.done:
            done.append(t)
        return bool(done) and t > done[0] + 5

    loop.run(controller, seconds, note, goals=Goals(goal))
    gain = them.gain * np.exp(1j * them.phi)
    return Passage(np.hypot(*(loop.world.position - goal).T), loop.world.touched,
                   done[0] if done else math.inf, controller.planned,
                   floor(gain, as_complex(goal - start)))


def _slit() -> list[Figure]:
    made = [passage(seed) for seed in range(SEEDS)]
    whole = float(np.mean([one.arrived for one in made]))
    each = float(np.mean([one.error <= _NEAR for one in made]))
    touched = sum(one.touched.any() for one in made)
    low, high = share_interval(round(whole * SEEDS), SEEDS)
    took = float(np.median([one.took for one in made]))
    peer = float(np.median([one.peer for one in made]))
    planned = max(one.planned for one in made)
    what = f'{COUNT} rollers through a slit, {SEEDS} draws'
    return [
        Figure(ISSUE, f'{what}: all at their goals within 5 µm, none touched '
               f'({100 * low:.0f}–{100 * high:.0f} %; {took:.0f} s)', 100 * whole, '%', '≥ 90',
               f'one way for all by least squares: {peer * 1e6:.0f} µm off (RMS)', whole >= 0.9),
        Figure(ISSUE, f'{what}: rollers within 5 µm', 100 * each, '%', '≥ 90', '', each >= 0.9),
        Figure(ISSUE, f'{what}: draws in which any touched', touched, '', '0', '', touched == 0),
        Figure(ISSUE, f'{what}: longest plan', planned, 's', '≤ 30', 'processor time',
               planned <= 30),
    ]


def share_interval(hits: int, of: int) -> tuple[float, float]:
    """95 % of Clopper and Pearson, Biometrika 26, 404 (1934), for a share of `hits` in `of`."""
    from scipy.stats import beta
    low = beta.ppf(0.025, hits, of - hits + 1) if hits else 0.0
    high = beta.ppf(0.975, hits + 1, of - hits) if hits < of else 1.0
    return float(low), float(high)


# A bead along a path ---------------------------------------------------------------------------

_ALONG = np.linspace(0, 1, 201)
PATHS = {
    'straight': np.column_stack((200e-6 * _ALONG - 100e-6, 0 * _ALONG)),
    'an S': np.column_stack((200e-6 * _ALONG - 100e-6, 25e-6 * np.sin(math.tau * _ALONG))),
}


@dataclass(frozen=True)
class Push:
    """Mean distance of the bead from the path, how far from its end it was left [m], and whether
    it was said to be there.
    """

    error: float
    end: float
    done: bool


def push(seed: int, path: np.ndarray, seconds: float = 120.0, **parameters: Any) -> Push:
    """A bead from the beginning of a `path` (P, 2) [m] to its end, by a roller that lies around.

    The controller has `parameters` of its own.
    """
    rng = np.random.default_rng(seed)
    # The bead has no moment: it neither turns nor rolls.
    them = Rollers(np.array([rng.uniform(2.4e-6, 3.6e-6), 0.0]),
                   np.array([rng.uniform(-0.5, 0.5), 0.0]),
                   np.array([rng.uniform(10.0, 30.0), 0.0]), np.full(2, RADIUS))
    angle = rng.uniform(0, math.tau)
    start = path[0] + 15e-6 * np.array([math.cos(angle), math.sin(angle)])
    told = them.gain * (1 + _KNOWN * rng.normal(size=2)), them.phi + _KNOWN * rng.normal(size=2)
    loop = RollingLoop(them, np.array([start, path[0]]), seed, told=told)
    controller, route = Pushing(), Route(path)
    controller.configure(PushingParameters(particle=1, **parameters))
    off: list[float] = []
    along, done = 0.0, False

    def note(_: float, outcome: Outcome) -> bool:
        nonlocal along, done
        bead = complex(*loop.world.position[1])
        along = route.nearest(bead, along, 30e-6)
        off.append(abs(bead - route.at(along)[0]))
        done = outcome.command is not None and outcome.command.progress.done
        return done

    loop.run(controller, seconds, note, path=path)
    return Push(float(np.mean(off)), abs(complex(*loop.world.position[1]) - route.end), done)


def _pushed() -> list[Figure]:
    found = []
    for name, path in PATHS.items():
        made = [push(seed, path) for seed in range(_PUSHES)]
        error = 1e6 * np.array([one.error for one in made])
        error[[not one.done for one in made]] = math.inf
        spread = 1.96 * float(np.std(error, ddof=1)) / math.sqrt(_PUSHES)
        found.append(Figure(
            ISSUE, f'a bead pushed along 200 µm, {name}, {_PUSHES} draws: mean error '
            f'(± {spread:.2f})', float(error.mean()), 'µm', '≤ 5', 'the path',
            bool(error.mean() <= 5)))
    return found
