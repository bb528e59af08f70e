"""Refinement of a plan: Gauss–Newton steps, quadratic programmes with obstacles and borders."""

from __future__ import annotations

import numpy as np

from microbot_ros.control.planning.manoeuvre import Task
from microbot_ros.control.planning.plan import Plan, Rollout, Swarm, roll_out

MICROMETRE = 1e-6
"""Scaling of the programme: lengths in µm, fields in units of their limit, so values near 1."""

_FARTHEST = 0.4
"""Choice: largest change of a field component in one step, of the limit."""
_EFFORT = 0.02
"""Choice: weight of the change itself [µm²], which keeps the programme well posed."""
_PENALTY = 50.0
"""Choice: cost of a micrometre inside an obstacle or beyond a border [µm²]."""
_USABLE = (1, 2)
"""OSQP's codes for solved, and solved inaccurately."""


def cost(swarm: Swarm, plan: Plan, task: Task, rollout: Rollout) -> float:
    """Return the cost [µm²] of a `plan` of a `swarm`, with its `rollout`, for a `task`.

    It adds the mean square error at the end, time, rotational diffusion and trespass.

    Parameters
    ----------
    swarm : Swarm
        The swarm.
    plan : Plan
        The plan.
    task : Task
        The task.
    rollout : Rollout
        Its prediction.

    Returns
    -------
    float
        Cost [µm²].
    """
    error = np.mean(np.abs(rollout.position[-1] - task.goal) ** 2)
    waiting = (task.impatience * plan.length) ** 2
    coasting = plan.duration[np.hypot(*plan.field.T) < 0.05 * task.limit].sum()
    blur = np.mean(np.abs(swarm.velocity) ** 2) * 2 * task.wander * coasting**3 / 3
    _, room = _rows(rollout, task)
    trespass = max(0.0, -float(room.min())) if len(room) else 0.0
    return float((error + waiting + blur) / MICROMETRE**2 + _PENALTY * trespass)


def improve(swarm: Swarm, plan: Plan, task: Task, rollout: Rollout,
            seconds: float) -> tuple[Plan, Rollout]:
    """Improve the `plan` of a `swarm` for a `task` by one step from its `rollout`, if possible.

    The solver may use at most `seconds`; unfinished work is discarded.

    Parameters
    ----------
    swarm : Swarm
        The swarm.
    plan : Plan
        The plan.
    task : Task
        The task.
    rollout : Rollout
        Prediction of the present plan.
    seconds : float
        Longest computing time of the solver [s]; unfinished work is discarded.

    Returns
    -------
    tuple[Plan, Rollout]
        Improved plan and its prediction; those given if there is no improvement.
    """
    step = _solve(rollout, task, seconds)
    if step is None:
        return plan, rollout
    before = cost(swarm, plan, task, rollout)
    for fraction in (1.0, 0.3, 0.1, 0.03):
        field = plan.field + fraction * task.limit * step.reshape(-1, 2)
        strength = np.hypot(*field.T)
        field *= np.minimum(1, task.limit / np.maximum(strength, 1e-12))[:, None]
        other = Plan(plan.duration, field)
        result = roll_out(swarm, other, task.limit)
        if cost(swarm, other, task, result) < before:
            return other, result
    return plan, rollout


def _solve(rollout: Rollout, task: Task, seconds: float) -> np.ndarray | None:
    """Minimise |e + Jδ|² + effort |δ|² + penalty s, with constraints up to a slack s ≥ 0."""
    import osqp
    from scipy import sparse

    response = rollout.response[-1] / MICROMETRE
    J = np.concatenate([response.real, response.imag])
    left = (rollout.position[-1] - task.goal) / MICROMETRE
    e = np.concatenate([left.real, left.imag])
    count = J.shape[1]
    P = np.zeros((count + 1, count + 1))
    P[:count, :count] = 2 * (J.T @ J / len(response) + _EFFORT * np.eye(count))
    P[count, count] = 1e-3
    q = np.append(2 * J.T @ e / len(response), _PENALTY)
    rows, room = _rows(rollout, task)
    A = np.zeros((count + 1 + len(rows), count + 1))
    A[:count + 1] = np.eye(count + 1)
    A[count + 1:, :count], A[count + 1:, count] = rows, 1
    low = np.concatenate([np.full(count, -_FARTHEST), [0], -room])
    high = np.concatenate([np.full(count, _FARTHEST), [np.inf], np.full(len(room), np.inf)])
    solver = osqp.OSQP(algebra='builtin')
    solver.setup(sparse.csc_matrix(np.triu(P)), q, sparse.csc_matrix(A), low, high, verbose=False,
                 eps_abs=1e-3, eps_rel=1e-3, max_iter=400, time_limit=max(seconds, 1e-4),
                 polishing=False)
    result = solver.solve(raise_error=False)
    step = result.x[:count] if result.x is not None else np.full(count, np.nan)
    usable = result.info.status_val in _USABLE and np.isfinite(step).all()
    return np.asarray(step) if usable else None


def _rows(rollout: Rollout, task: Task) -> tuple[np.ndarray, np.ndarray]:
    """Return constraints row·δ ≥ −room near borders and obstacles: rows (R, 2K), room (R,) [µm].

    Others cannot become active within one step.
    """
    rows, room = [], []
    z, response = rollout.position, rollout.response

    def keep(normal: np.ndarray, distance: np.ndarray) -> None:
        near = distance < 10 * MICROMETRE
        rows.append((normal[..., None].conj() * response).real[near])
        room.append(distance[near])

    view = task.workspace
    for normal, distance in ((-1, view.high[0] - z.real), (1, z.real - view.low[0]),
                             (-1j, view.high[1] - z.imag), (1j, z.imag - view.low[1])):
        keep(np.full(z.shape, normal, complex), distance)
    for centre, clearance in zip(task.obstacles, task.clearance, strict=True):
        away = z - centre
        keep(away / np.maximum(np.abs(away), 1e-9), np.abs(away) - clearance)
    return np.concatenate(rows) / MICROMETRE, np.concatenate(room) / MICROMETRE
