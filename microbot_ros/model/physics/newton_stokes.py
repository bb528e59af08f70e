"""Newton's equations with Stokes drag: the inertia that the first-order model neglects.

Without noise, as the paper integrates them. The equations are stiff, with time constants of
microseconds and legs of seconds, so SciPy's stiff solver integrates them leg by leg. If the
heading follows immediately they also have a closed solution, which tests compare with.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise

import numpy as np

from microbot_ros.common.records import Commands
from microbot_ros.model.physics.particle import Fluid, Particle, rotational_drag, stokes_drag
from microbot_ros.model.physics.vectors import unit

_Rates = Callable[[float, np.ndarray], np.ndarray]
"""Derivative of the state as a function of time and state."""

_RELATIVE = 1e-6
"""Relative tolerance of the solver. Choice: far below the inertia that is studied."""

# Absolute tolerances: a hundredth of a nanometre, of a nanometre per second, of a milliradian.
_POSITION, _VELOCITY, _ANGLE = 1e-11, 1e-11, 1e-5
"""Absolute tolerances of position [m], `_VELOCITY` [m/s] and `_ANGLE` [rad].

Choice: a hundredth of a nanometre, of a nanometre per second, of a milliradian.
"""


def newton_stokes(
    fluid: Fluid, particles: Sequence[Particle], commands: Commands, times: np.ndarray,
    start: np.ndarray, heading: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Integrate translation and rotation.

    m dv/dt = F ê(θ) − 6πηr v and I dω/dt = d|B| sin(θ_B + φ − θ) − 8πηr³ω, from rest.

    Parameters
    ----------
    fluid : Fluid
        The fluid.
    particles : sequence of Particle
        N particles.
    commands : Commands
        Fields.
    times : ndarray, shape (T,)
        Times [s], ascending.
    start : ndarray, shape (N, 2)
        Positions at the first time [m].
    heading : ndarray, shape (N,)
        Headings at the first time [rad].

    Returns
    -------
    positions : ndarray, shape (T, N, 2)
        Positions [m].
    headings : ndarray, shape (T, N)
        Headings [rad].
    """
    mass, moment, inertia = (
        np.array([getattr(p, name) for p in particles])
        for name in ('mass', 'moment', 'moment_of_inertia'))
    slowing = stokes_drag(fluid, _radius(particles)) / mass
    spin_damping = rotational_drag(fluid, _radius(particles)) / inertia
    push = np.array([p.force for p in particles]) / mass
    phi = np.array([p.phi for p in particles])

    def rates(field: np.ndarray) -> _Rates:
        torque = moment * np.hypot(*field) / inertia
        target = np.arctan2(field[1], field[0]) + phi

        def rate(_: float, state: np.ndarray) -> np.ndarray:
            u, v, angle, spin = state.reshape(6, -1)[2:]
            return np.concatenate((
                u, v, push * np.cos(angle) - slowing * u, push * np.sin(angle) - slowing * v,
                spin, torque * np.sin(target - angle) - spin_damping * spin))

        return rate

    still = np.zeros(len(particles))
    state = np.concatenate((np.ravel(np.transpose(start)), still, still, heading, still))
    tolerance = [_POSITION, _POSITION, _VELOCITY, _VELOCITY, _ANGLE, _ANGLE]
    states = _solve(rates, commands, times, state, np.repeat(tolerance, len(particles)))
    states = states.reshape(len(times), 6, -1)
    return np.stack((states[:, 0], states[:, 1]), axis=-1), states[:, 4]


def stokes_translation(
    fluid: Fluid, particles: Sequence[Particle], commands: Commands, times: np.ndarray,
    start: np.ndarray,
) -> np.ndarray:
    """Integrate translation only, as the paper reduces it.

    m dv/dt = F R(φ)u − 6πηr v, with a heading that follows the field immediately. Without a field
    there is no propulsion.

    Parameters
    ----------
    fluid : Fluid
        The fluid.
    particles : sequence of Particle
        N particles.
    commands : Commands
        Fields.
    times : ndarray, shape (T,)
        Times [s], ascending.
    start : ndarray, shape (N, 2)
        Positions at the first time [m].

    Returns
    -------
    ndarray, shape (T, N, 2)
        Positions [m].
    """
    mass = np.array([p.mass for p in particles])[:, None]
    slowing = np.repeat(stokes_drag(fluid, _radius(particles))[:, None] / mass, 2)
    size = len(slowing)

    def rates(field: np.ndarray) -> _Rates:
        push = np.ravel(_force(particles, field) / mass)
        return lambda _, state: np.concatenate(
            (state[size:], push - slowing * state[size:]))

    state = np.concatenate((np.ravel(start), np.zeros(size)))
    tolerance = np.repeat([_POSITION, _VELOCITY], size)
    states = _solve(rates, commands, times, state, tolerance)
    return states[:, :size].reshape(len(times), -1, 2)


def _solve(
    rates: Callable[[np.ndarray], _Rates], commands: Commands, times: np.ndarray,
    state: np.ndarray, tolerance: np.ndarray,
) -> np.ndarray:
    """Return states (T, S) by SciPy's stiff solver, restarted at every change of the command."""
    from scipy.integrate import solve_ivp

    states = np.empty((len(times), len(state)))
    states[0] = state
    for begin, end, field, rows in _legs(commands, times):
        # SciPy's first step subtracts from memory that it has not set, and drops the result.
        with np.errstate(invalid='ignore', over='ignore'):
            leg = solve_ivp(
                rates(field), (begin, end), state, 'BDF', t_eval=np.union1d(times[rows], [end]),
                rtol=_RELATIVE, atol=tolerance)
        state = leg.y[:, -1]
        states[rows] = leg.y[:, :len(times[rows])].T
    return states


def _radius(particles: Sequence[Particle]) -> np.ndarray:
    return np.array([p.radius for p in particles])


def _force(particles: Sequence[Particle], field: np.ndarray) -> np.ndarray:
    """Return the propulsion (N, 2) [N] of particles that are aligned with the field."""
    if not field.any():
        return np.zeros((len(particles), 2))
    direction = np.arctan2(field[1], field[0]) + np.array([p.phi for p in particles])
    return np.array([p.force for p in particles])[:, None] * unit(direction)


def _legs(
    commands: Commands, times: np.ndarray,
) -> Iterator[tuple[float, float, np.ndarray, slice]]:
    """Yield begin, end [s], field (2,) [T] and rows of `times` in (begin, end] of each leg."""
    inside = commands.t[(commands.t > times[0]) & (commands.t < times[-1])]
    edges = np.concatenate(([times[0]], np.unique(inside), [times[-1]]))
    for begin, end in pairwise(edges):
        first, last = np.searchsorted(times, (begin, end), side='right')
        yield begin, end, commands.field_at(begin), slice(first, last)
