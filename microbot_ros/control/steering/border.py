"""Keep driven particles in view, for every controller."""

from __future__ import annotations

import cmath
import dataclasses

import numpy as np

from microbot_ros.common.compiled import numba
from microbot_ros.control.contract import ControllerInput, FieldCommand
from microbot_ros.control.planning.shared import borders
from microbot_ros.control.steering.courses import field_along
from microbot_ros.control.steering.forecast import KNOWN_WELL_ENOUGH

COMES_BACK = 0.5
"""Choice: least part of its speed with which a particle outside is brought back."""


def kept_in_view(inputs: ControllerInput, command: FieldCommand, horizon: float) -> FieldCommand:
    """Turn the `command` by the smallest angle that keeps its particles in the workspace.

    No particle may swim towards a border faster than its distance from it over `horizon` [s]; one
    that is outside comes back. If one field cannot do that for all, it does so for as many as
    possible. Only particles of `inputs` with known speed and φ count; zero field stays zero. This
    is a control barrier function, h the distance: dh/dt ≥ −h/horizon.

    Parameters
    ----------
    inputs : ControllerInput
        Input of the tick.
    command : FieldCommand
        The command.
    horizon : float
        Time [s] in which a particle may reach a border.

    Returns
    -------
    FieldCommand
        The command, turned if necessary.
    """
    if not command.in_plane or _clear(
            inputs.expected, inputs.speed, command.frequency or 1.0, inputs.workspace.low,
            inputs.workspace.high, horizon):
        return command
    model = inputs.model
    made = complex(*(command.field if model is None else model.field(command.field)).tolist())
    rows = _concerned(inputs, command)
    if not (abs(made) > 0 and rows.any()):
        return command
    u = made / abs(made)
    rolling = model is not None and model.propulsion == 'rolling'
    pace = inputs.speed[rows] * (command.frequency if rolling else 1.0)
    velocity = pace * np.exp(1j * inputs.phi[rows])
    normal, room = borders(inputs.workspace, inputs.expected[rows], velocity, 0.0)
    most = np.maximum(room / horizon, -COMES_BACK * np.abs(normal))
    near = most < np.abs(normal)
    turned = _least_turn(u, normal[near], most[near])
    if turned == u:
        return command
    field = field_along(inputs, cmath.phase(turned), float(np.hypot(*command.field)))
    message = f'{command.progress.message}; turned: a particle is about to leave the view'
    progress = dataclasses.replace(command.progress, message=message)
    return dataclasses.replace(command, field=field, progress=progress)


@numba.njit(cache=True)
def _clear(expected, speed, turns, low, high, horizon):  # type: ignore[no-untyped-def]
    """Return whether no particle could leave the workspace within the horizon [s]."""
    for n in range(len(speed)):
        pace = speed[n] * max(turns, 1.0) * horizon
        for axis in range(2):
            at = expected[n, axis]
            if pace > high[axis] - at or pace > at - low[axis]:
                return False
    return True


def _concerned(inputs: ControllerInput, command: FieldCommand) -> np.ndarray:
    """Return the particles (N,) to keep in view."""
    known = inputs.learned(KNOWN_WELL_ENOUGH) & (inputs.speed > 0)
    known &= np.isfinite(inputs.speed) & np.isfinite(inputs.expected).all(1)
    if command.particles is not None:
        known &= np.isin(inputs.ids, command.particles)
    return known


def _least_turn(u: complex, normal: np.ndarray, most: np.ndarray) -> complex:
    """Return the direction nearest to u that violates fewest of Re(n̄ u) ≤ h, n and h (K,)."""
    ends = np.exp(1j * np.arccos(most / np.abs(normal)))
    along = normal / np.abs(normal)
    ways = np.concatenate([[u], along * ends, along / ends])
    excess = (normal.conj() * ways[:, None]).real - most
    broken = (excess > 1e-9 * np.abs(normal)).sum(1)
    best = np.lexsort((np.abs(ways - u), broken))[0]
    return complex(ways[best])
