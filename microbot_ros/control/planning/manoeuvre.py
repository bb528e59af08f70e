"""Initial plans that use lag: turn, coast apart, continue together.

Particles with different lags point differently relative to φ while they turn. Without a field they
keep these directions and swim apart along directions that one field could never give them
together. The turn and the coasting time are searched on a grid; the leg together that follows is
a least-squares solution in closed form.
"""

from __future__ import annotations

import cmath
from dataclasses import dataclass

import numpy as np

from microbot_ros.control.contract import Workspace
from microbot_ros.control.planning.plan import Plan, Swarm

# Choices: the grid of the search, whose best plan `refine` improves.
_DIRECTIONS = np.exp(2j * np.pi * np.arange(16) / 16)
_ASIDE = np.exp(1j * np.radians([-160, -130, 130, 160]))
"""Choice: backwards to either side, with which a goal behind is approached."""
_COASTS = np.linspace(0, 1, 10) ** 1.5  # choice: parts of the longest coast, denser at short ones


@dataclass(frozen=True)
class Task:
    """Goal and constraints of a plan.

    Attributes
    ----------
    goal : (N,) complex array [m]
    limit : float
        Largest field [T].
    workspace : Workspace
        Reduced by the margin.
    obstacles, clearance : (O,) complex array [m], (O,) array [m]
        Centres and radii.
    impatience : float
        Error that counts like one second [m/s].
    wander : float
        Rotational diffusion without a field [rad²/s].
    """

    goal: np.ndarray
    limit: float
    workspace: Workspace
    obstacles: np.ndarray
    clearance: np.ndarray
    impatience: float
    wander: float


@dataclass(frozen=True)
class _Opening:
    """Candidate starts of a plan: V variants of `field` (K, V, 2) [T] over `duration` (K,) [s].

    Each may end after any number of spans from `least` on.
    """

    duration: np.ndarray
    field: np.ndarray
    least: int


def search(swarm: Swarm, task: Task, part: int = 0, parts: int = 1) -> Plan:
    """Return the cheapest plan for a `task` of turning a `swarm`, coasting, and a leg together.

    Of the candidate starts only every `parts`-th is tried, from number `part` on.

    Parameters
    ----------
    swarm : Swarm
        State of the N particles.
    task : Task
        Goals, largest field and obstacles.
    part : int
        Number of the first candidate start that is tried, from 0.
    parts : int
        Step between the candidate starts that are tried; 1 tries all.

    Returns
    -------
    Plan
        Cheapest plan of those tried.
    """
    slowest = swarm.slowest * swarm.models[0].reference_field / task.limit
    far = float(np.abs(task.goal - swarm.position).max())
    coasts = _COASTS * 2 * far / float(np.abs(swarm.velocity).min())
    chosen = slice(part % parts, None, parts)
    _, drift = swarm.surroundings(np.ones(1), np.zeros((1, 2)), swarm.position[None])
    openings = [_Opening(o.duration, o.field[:, chosen], o.least)
                for o in _openings(task.limit, slowest)]
    plans = [_best(swarm, task, opening, coasts, drift[0]) for opening in openings]
    return min(plans, key=lambda found: found[0])[1]


def _openings(limit: float, slowest: float) -> list[_Opening]:
    """Return turns from the present headings, and large turns after an alignment of all."""
    from_here = _Opening(
        slowest * np.array([0.2, 0.3, 0.3, 0.4, 0.6, 1.0]),
        np.repeat(_vectors(_DIRECTIONS)[None], 6, axis=0) * limit, 0)
    aligned = np.repeat(_DIRECTIONS, len(_ASIDE))
    aside = (_DIRECTIONS[:, None] * _ASIDE).ravel()
    from_aligned = _Opening(
        slowest * np.array([3.0, 0.5, 0.3, 0.3, 0.4, 0.6]),
        _vectors(np.stack([aligned] + [aside] * 5)) * limit, 2)
    return [from_here, from_aligned]


def _vectors(z: np.ndarray) -> np.ndarray:
    return np.stack([z.real, z.imag], -1)


def _best(swarm: Swarm, task: Task, opening: _Opening,
          coasts: np.ndarray, drift: np.ndarray) -> tuple[float, Plan]:
    """Return cost [m²] and plan of the cheapest plan with this opening.

    `drift` (N,) complex [m/s] counts as constant. Arrays are (spans of the opening, coasts,
    candidate starts, N).
    """
    paths, headings = swarm.paths(opening.duration, opening.field)
    turned = np.concatenate([np.zeros_like(paths[:1]), np.cumsum(paths, 0)])[opening.least:]
    apart = turned[:, None] + headings[opening.least:, None] * coasts[:, None, None]
    middle = swarm.position + swarm.velocity * apart.swapaxes(2, 3)
    spent = np.concatenate([[0.0], np.cumsum(opening.duration)])[opening.least:, None, None]
    power = np.vdot(swarm.velocity, swarm.velocity).real
    together = np.zeros(middle.shape[:-1], complex)
    for _ in range(2 if np.any(drift) else 1):  # the duration of the drift depends on the path
        taken = spent + coasts[:, None] + np.abs(together)
        left = task.goal - middle - drift * taken[..., None]
        together = (left @ swarm.velocity.conj()) / power
    error = left - swarm.velocity * together[..., None]
    blur = power * 2 * task.wander * coasts[:, None] ** 3 / 3
    cost = ((np.abs(error) ** 2).sum(-1) + blur) / len(swarm.position)
    cost += (task.impatience * (spent + coasts[:, None] + np.abs(together))) ** 2
    cost += _trespass(swarm.position, middle, task.goal - error, task)
    a, b, v = np.unravel_index(np.argmin(cost), cost.shape)
    spans = opening.least + a
    start = Plan(opening.duration[:spans], opening.field[:spans, v])
    plan = _compose(start, float(coasts[b]), complex(together[a, b, v]), task.limit)
    return float(cost[a, b, v]), plan


def _trespass(start: np.ndarray, middle: np.ndarray, end: np.ndarray, task: Task) -> np.ndarray:
    """Return the cost [m²] of leaving the workspace or crossing an obstacle on the two legs."""
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
    """Return the distance of a place from the straight lines between a and b."""
    way = b - a
    power = np.abs(way) ** 2
    part = ((place - a) * way.conj()).real / np.where(power > 0, power, 1.0)
    return np.asarray(np.abs(a + np.clip(part, 0, 1) * way - place))


def _compose(start: Plan, coast: float, together: complex, limit: float) -> Plan:
    spans = 6 if coast > 0 else 0
    duration, field = _leg(together, limit)
    return Plan(
        np.concatenate([start.duration, np.full(spans, coast / 6), duration]),
        np.concatenate([start.field, np.zeros((spans, 2)), field]))


def _leg(U: complex, limit: float) -> tuple[np.ndarray, np.ndarray]:
    """Return spans of a leg along U [s] at full field, short ones first, where the turn is."""
    length = max(abs(U), 1e-3)
    duration = length * np.array([0.05, 0.1, 0.15, 0.2, 0.25, 0.25])
    along = cmath.rect(limit, cmath.phase(U))
    return duration, np.tile([along.real, along.imag], (len(duration), 1))
