"""Plans to begin with, from what lag makes possible: turn, coast apart, go on together.

Particles that lag differently point differently, relative to φ, while they turn. Without a field
they keep that, and swim apart along directions one field could never give them together. Turn
and coast are tried on a grid; the leg together that follows is least squares in closed form.
"""

from __future__ import annotations

import cmath
from dataclasses import dataclass

import numpy as np

from microbot_ros.control.contract import Workspace
from microbot_ros.control.plan import Plan, Swarm
from microbot_ros.control.shared import best_displacement

_DIRECTIONS = np.exp(2j * np.pi * np.arange(32) / 32)
_TURNS = 10
_COASTS = np.linspace(0, 1, 16) ** 1.5


@dataclass(frozen=True)
class Task:
    """What is asked of a plan.

    `goal` (N,) complex [m]; the field's `limit` [T]; the `workspace` shrunk by its margin;
    `obstacles` (O,) complex [m] of radius (O,) [m] `clearance`; a second counts like
    `impatience` [m] of error; headings wander without a field by `wander` [rad²/s].
    """

    goal: np.ndarray
    limit: float
    workspace: Workspace
    obstacles: np.ndarray
    clearance: np.ndarray
    impatience: float
    wander: float


def straight(swarm: Swarm, task: Task) -> Plan:
    """All together along the best shared displacement, from now on."""
    U = best_displacement(swarm.velocity, task.goal - swarm.position)
    return Plan(*_leg(U, task.limit))


def search(swarm: Swarm, task: Task, longest_turn: float, longest_coast: float) -> Plan:
    """The best of turning by so much towards any direction, coasting, and a leg together."""
    turn = longest_turn / _TURNS
    field = np.stack([_DIRECTIONS.real, _DIRECTIONS.imag], -1) * task.limit
    paths, headings = swarm.paths(np.full(_TURNS, turn), np.repeat(field[None], _TURNS, axis=0))
    turned = np.concatenate([np.zeros_like(paths[:1]), np.cumsum(paths, 0)])
    coast = _COASTS * longest_coast
    # (turns, coasts, directions, N)
    apart = (turned[:, None] + headings[:, None] * coast[:, None, None]).swapaxes(2, 3)
    middle = swarm.position + swarm.velocity * apart
    left = task.goal - middle
    power = np.vdot(swarm.velocity, swarm.velocity).real
    together = (left @ swarm.velocity.conj()) / power
    error = left - swarm.velocity * together[..., None]
    length = (turn * np.arange(_TURNS + 1)[:, None, None] + coast[:, None] + np.abs(together))
    blur = power * 2 * task.wander * coast[:, None] ** 3 / 3
    cost = ((np.abs(error) ** 2).sum(-1) + blur) / len(swarm.position)
    cost = cost + (task.impatience * length) ** 2 + _trespass(
        swarm.position, middle, task.goal - error, task)
    a, b, k = np.unravel_index(np.argmin(cost), cost.shape)
    return _compose(a * turn, complex(_DIRECTIONS[k]), float(coast[b]),
                    complex(together[a, b, k]), task.limit)


def _trespass(start: np.ndarray, middle: np.ndarray, end: np.ndarray, task: Task) -> np.ndarray:
    """A cost [m²] for leaving the workspace or crossing an obstacle on the two legs."""
    view = task.workspace
    cost = np.zeros(middle.shape[:-1])
    for place in (middle, end):
        for part, low, high in ((place.real, view.low[0], view.high[0]),
                                (place.imag, view.low[1], view.high[1])):
            cost += 1e2 * (np.maximum(part - high, 0) + np.maximum(low - part, 0)).sum(-1) ** 2
    for centre, clearance in zip(task.obstacles, task.clearance, strict=True):
        for a, b in ((start, middle), (middle, end)):
            into = np.maximum(clearance - _distance(centre, a, b), 0)
            cost += 1e2 * into.sum(-1) ** 2
    return cost


def _distance(place: complex, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """From a place to the straight ways between a and b."""
    way = b - a
    power = np.abs(way) ** 2
    part = ((place - a) * way.conj()).real / np.where(power > 0, power, 1.0)
    return np.asarray(np.abs(a + np.clip(part, 0, 1) * way - place))


def _compose(turn: float, direction: complex, coast: float, together: complex,
             limit: float) -> Plan:
    strong = np.array([direction.real, direction.imag]) * limit
    parts = [(turn, strong, 4), (coast, np.zeros(2), 6)]
    durations = [np.full(n, length / n) for length, _, n in parts if length > 0]
    fields = [np.tile(field, (n, 1)) for length, field, n in parts if length > 0]
    duration, field = _leg(together, limit)
    return Plan(np.concatenate([*durations, duration]), np.concatenate([*fields, field]))


def _leg(U: complex, limit: float) -> tuple[np.ndarray, np.ndarray]:
    """Spans of a leg along U [s] at full field: short ones first, where the turn is."""
    length = max(abs(U), 1e-3)
    duration = length * np.array([0.05, 0.1, 0.15, 0.2, 0.25, 0.25])
    along = cmath.rect(limit, cmath.phase(U))
    return duration, np.tile([along.real, along.imag], (len(duration), 1))
