"""Newton's equations with Stokes' drag: the inertia that the first-order model leaves out.

Without noise, as the paper integrates them. The equations are stiff, time constants of
microseconds against legs of seconds, so they are given to SciPy's stiff solver leg by leg;
where the heading follows at once they also have a closed solution, to check it by.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise

import numpy as np

from microbot_ros.common.records import Commands
from microbot_ros.model.physics.particle import Fluid, Particle, rotational_drag, stokes_drag
from microbot_ros.model.physics.vectors import unit

_Rates = Callable[[float, np.ndarray], np.ndarray]

_RELATIVE = 1e-6
# Absolute tolerances: a hundredth of a nanometre, of a nanometre per second, of a milliradian.
_POSITION, _VELOCITY, _ANGLE = 1e-11, 1e-11, 1e-5


def newton_stokes(
    fluid: Fluid, particles: Sequence[Particle], commands: Commands, times: np.ndarray,
    start: np.ndarray, heading: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Translation and rotation: positions (T, N, 2) [m] and headings (T, N) [rad].

    m dv/dt = F ê(θ) − 6πηr v and I dω/dt = d|B| sin(θ_B + φ − θ) − 8πηr³ω, from rest at `start`
    (N, 2) and `heading` (N,) at the first of `times` (T,) [s], which ascend.
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
    """Translation alone, as the paper reduces it: positions (T, N, 2) [m].

    m dv/dt = F R(φ)u − 6πηr v, the heading following the field at once; `times` and `start` as in
    `newton_stokes`. Without a field there is no propulsion.
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
    """States (T, S) by SciPy's stiff solver, restarted wherever the command changes."""
    from scipy.integrate import solve_ivp

    states = np.empty((len(times), len(state)))
    states[0] = state
    for begin, end, field, rows in _legs(commands, times):
        leg = solve_ivp(
            rates(field), (begin, end), state, 'BDF', t_eval=np.union1d(times[rows], [end]),
            rtol=_RELATIVE, atol=tolerance)
        state = leg.y[:, -1]
        states[rows] = leg.y[:, :len(times[rows])].T
    return states


def _radius(particles: Sequence[Particle]) -> np.ndarray:
    return np.array([p.radius for p in particles])


def _force(particles: Sequence[Particle], field: np.ndarray) -> np.ndarray:
    """Propulsion (N, 2) [N] of particles that point at once where the field sends them."""
    if not field.any():
        return np.zeros((len(particles), 2))
    direction = np.arctan2(field[1], field[0]) + np.array([p.phi for p in particles])
    return np.array([p.force for p in particles])[:, None] * unit(direction)


def _legs(
    commands: Commands, times: np.ndarray,
) -> Iterator[tuple[float, float, np.ndarray, slice]]:
    """Begin, end [s], field (2,) [T] and rows of `times` in (begin, end] of each constant leg."""
    inside = commands.t[(commands.t > times[0]) & (commands.t < times[-1])]
    edges = np.concatenate(([times[0]], np.unique(inside), [times[-1]]))
    for begin, end in pairwise(edges):
        first, last = np.searchsorted(times, (begin, end), side='right')
        yield begin, end, commands.field_at(begin), slice(first, last)
