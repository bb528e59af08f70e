"""Reachable positions of particles under one field, and those that an added effect opens.

Under the first-order model all N particles share one displacement U = ∫u dt: of the 2N dimensions
of their positions, two are reachable. Effects that act differently on the particles open more; how
many is determined by random commands to the model itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ros.control.contract import Workspace
from microbot_ros.control.planning.manoeuvre import Task, search
from microbot_ros.control.planning.plan import Swarm, roll_out
from microbot_ros.control.planning.refine import improve
from microbot_ros.control.planning.shared import best_displacement, floor

HANDLES = {
    'direction': 'turning a field of full strength',
    'strength': 'and changing its strength',
    'off': 'and switching it off',
}
"""Kinds of command, each including the ones before."""


@dataclass(frozen=True)
class Reach:
    """Reachable set of the first-order model.

    Attributes
    ----------
    subspace : (2N, 2) array
        Orthonormal columns that span the shared displacements (x₁, y₁, x₂, …).
    displacement : complex
        Best displacement U* [s].
    ends, left : (N,) complex array [m]
        Positions after it, and the remaining vectors to the goals.
    floor : float
        RMS of `left` [m], below which no controller gets.
    """

    subspace: np.ndarray
    displacement: complex
    ends: np.ndarray
    left: np.ndarray
    floor: float


def reach(velocity: np.ndarray, position: np.ndarray, goal: np.ndarray) -> Reach:
    """Return the reachable set for `velocity` v e^{iφ} (N,) [m/s], `position` and `goal` (N,) [m].

    All are complex.

    Parameters
    ----------
    velocity : ndarray, shape (N,)
        Velocity phasors v e^{iφ} [m/s].
    position : ndarray, shape (N,)
        Positions, complex [m].
    goal : ndarray, shape (N,)
        Goals, complex [m].

    Returns
    -------
    Reach
        The reachable set.
    """
    wanted = goal - position
    U = best_displacement(velocity, wanted)
    norm = float(np.sqrt(np.vdot(velocity, velocity).real)) or 1.0
    columns = np.stack([velocity, 1j * velocity], -1) / norm
    subspace = np.stack([columns.real, columns.imag], 1).reshape(-1, 2)
    ends = position + velocity * U
    return Reach(subspace, U, ends, goal - ends, floor(velocity, wanted))


def opened(swarm: Swarm, limit: float, seconds: float, rng: np.random.Generator,
           samples: int = 400) -> dict[str, np.ndarray]:
    """Return how far random commands move particles beyond their shared displacement.

    Parameters
    ----------
    swarm : Swarm
        State of the N particles.
    limit : float
        Largest field [T].
    seconds : float
        Duration of a command [s].
    rng : Generator
        Source of the random commands.
    samples : int
        Number of commands.

    Returns
    -------
    dict
        For each of HANDLES the singular values (2N − 2,) [m], largest first: RMS displacement
        along the directions closed to the first-order model. All are zero if that model is exact.
    """
    duration, field = _random_commands(swarm, limit, seconds, rng, samples)
    closed = _closed_directions(swarm.velocity)
    result = {}
    for handle, B in field.items():
        steps = swarm.velocity * swarm.paths(duration, B)[0].swapaxes(1, 2)
        factor, drift = swarm.surroundings(
            duration, B, swarm.position + np.cumsum(steps, axis=0))
        ends = (steps * factor + drift * duration[:, None, None]).sum(0)
        moved = np.stack([ends.real, ends.imag], -1).reshape(samples, -1)
        moved -= moved.mean(0)
        result[handle] = np.linalg.svd(moved @ closed, compute_uv=False) / np.sqrt(samples)
    return result


def _random_commands(
    swarm: Swarm, limit: float, seconds: float, rng: np.random.Generator, samples: int,
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Return spans (K,) and, for each handle, fields (K, V, 2) held for some alignment times."""
    count = int(np.clip(seconds / max(swarm.slowest, seconds / 60), 4, 60))
    angle = rng.uniform(-np.pi, np.pi, (count, samples))
    full = limit * np.stack([np.cos(angle), np.sin(angle)], -1)
    weaker = full * rng.uniform(0.1, 1, (count, samples, 1))
    off = weaker * (rng.uniform(0, 1, (count, samples, 1)) > 0.4)
    return np.full(count, seconds / count), {'direction': full, 'strength': weaker, 'off': off}


def _closed_directions(velocity: np.ndarray) -> np.ndarray:
    """Return orthonormal columns (2N, 2N − 2) of displacements closed in first order."""
    subspace = reach(velocity, np.zeros_like(velocity), np.zeros_like(velocity)).subspace
    return np.asarray(np.linalg.svd(subspace)[0][:, 2:])


def planned_floor(swarm: Swarm, goal: np.ndarray, limit: float, workspace: Workspace) -> float:
    """Return the RMS distance [m] from each `goal` (N, 2) [m] after one planned manoeuvre.

    For a `swarm` in a `workspace`, with fields up to `limit` [T]: turn, coast, go on together,
    refined, without noise. `predictive` starts from this.

    Parameters
    ----------
    swarm : Swarm
        The swarm.
    goal : ndarray, shape (N, 2)
        Goals [m].
    limit : float
        Largest field [T].
    workspace : Workspace
        The workspace.

    Returns
    -------
    float
        Distance [m].
    """
    task = Task(goal, limit, workspace, np.empty(0), np.empty(0), 1e-8, 0.0)
    plan = search(swarm, task)
    rollout = roll_out(swarm, plan, limit)
    for _ in range(30):
        better, rollout = improve(swarm, plan, task, rollout, 1.0)
        if better is plan:
            break
        plan = better
    return float(np.sqrt(np.mean(np.abs(rollout.position[-1] - goal) ** 2)))
