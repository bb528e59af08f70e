"""Observations and actions of a learned policy, in training and on the rig alike.

The task: each of K particles has a goal and is to reach it once, all driven by one field. A
particle at p moves by c ∫u dt, with its velocity phasor c = v e^{iφ} and the direction u of the
field; (g − p)/c [s] is thus the ∫u dt that takes it to its goal g. In this form one field moves
all particles alike. An observation has 2 + 7 K numbers of single precision:

    0, 1   the present field, as a part of the largest allowed;
    then for each particle, in ascending order of the ids,
    0, 1   (g − p)/c in units of 30 s, or 0 once it has reached its goal,
    2, 3   p, ±1 at the borders of the workspace,
    4, 5   c in units of 10 µm/s,
    6      1 until it has reached its goal, then 0;

each clipped to ±10. An action has two: the wanted field as a part of the largest allowed,
shortened to length 1 if it is longer.
"""

from __future__ import annotations

import numpy as np

from microbot_ros.control.contract import ControllerInput, ParticleLostError, Workspace
from microbot_ros.control.planning.assignment import Assignment
from microbot_ros.control.planning.shared import as_complex

SHARED_NUMBERS, PARTICLE_NUMBERS = 2, 7
"""Numbers of an observation for the field, and for each particle."""
LARGEST = 10.0
"""Choice: value to which each number is clipped."""
ARRIVAL = 2e-6
"""Choice: distance [m] within which a goal is reached."""
_WAY_S, _SPEED = 30.0, 10e-6  # choices: units of the observation, which make numbers near 1


def distances(position: np.ndarray, goals: np.ndarray) -> np.ndarray:
    """Return the distances [m] of `position` (..., 2) [m] from `goals` (..., 2) [m].

    Parameters
    ----------
    position : ndarray, shape (..., 2)
        Positions [m].
    goals : ndarray, shape (..., 2)
        Goals [m].

    Returns
    -------
    ndarray, shape (...)
        Distances [m].
    """
    return np.asarray(np.abs(as_complex(goals - position)))


def observation(
    position: np.ndarray, velocity_phasor: np.ndarray, goals: np.ndarray, waiting: np.ndarray,
    share: np.ndarray, workspace: Workspace,
) -> np.ndarray:
    """Return the observation (..., 2 + 7 K), float32.

    Parameters
    ----------
    position, goals : (..., K, 2) array [m]
        Position and goal of each particle.
    velocity_phasor : (..., K) complex array [m/s]
        A particle that does not move gets a path of 0.
    waiting : (..., K) bool array
        Whether the goal has not been reached yet.
    share : (..., 2) array
        Present field over the largest allowed.
    workspace : Workspace
        Rectangle in which the particles are.

    Returns
    -------
    ndarray, shape (..., 2 + 7 K)
        Observation, float32.
    """
    low, high = workspace.low, workspace.high
    way = np.zeros(waiting.shape, complex)
    np.divide(as_complex(goals - position), velocity_phasor * _WAY_S, out=way,
              where=waiting & (velocity_phasor != 0))
    place = (2 * position - low - high) / (high - low)
    shown = np.empty((*waiting.shape[:-1], SHARED_NUMBERS + PARTICLE_NUMBERS * waiting.shape[-1]))
    shown[..., :SHARED_NUMBERS] = share
    for k, numbers in enumerate((
            way.real, way.imag, place[..., 0], place[..., 1], velocity_phasor.real / _SPEED,
            velocity_phasor.imag / _SPEED, waiting)):
        shown[..., SHARED_NUMBERS + k::PARTICLE_NUMBERS] = numbers
    return np.minimum(np.maximum(shown, -LARGEST), LARGEST).astype(np.float32)


def wanted_field(action: np.ndarray, strongest: float) -> np.ndarray:
    """Return the field (..., 2) [T] for an `action` (..., 2); NaN if that is not finite.

    `strongest` [T] is the largest field allowed.

    Parameters
    ----------
    action : ndarray, shape (..., 2)
        Actions.
    strongest : float
        Largest field [T].

    Returns
    -------
    ndarray, shape (..., 2)
        Field [T].
    """
    action = np.asarray(action, dtype=float)
    with np.errstate(invalid='ignore', over='ignore'):
        length = np.hypot(action[..., 0], action[..., 1])
        scale = np.where(np.isfinite(length), strongest / np.maximum(length, 1.0), np.nan)
    return np.asarray(action * scale[..., None])


class PolicyTask:
    """Goals of the particles, which have been reached, and the observation of them."""

    def __init__(self) -> None:
        self._assignment = Assignment()
        self.waiting = np.zeros(0, bool)
        """Particles (K,), in ascending order of ids, that have not reached their goals."""

    def rows(self, inputs: ControllerInput) -> np.ndarray:
        """Return rows (K,) in `inputs` of the particles with goals; new goals restart the task.

        Raises GoalError for a goal outside the workspace, ParticleLostError if a particle with a
        goal is not tracked.

        Parameters
        ----------
        inputs : ControllerInput
            Input of the tick.

        Returns
        -------
        ndarray, shape (K,)
            Rows.
        """
        if self._assignment.update(inputs):
            self.waiting = np.ones(len(inputs.goals), bool)
        rows = self._assignment.pairs(inputs)[0]
        if lost := len(self.waiting) - len(rows):
            raise ParticleLostError(f'{lost} of the particles with goals are not tracked')
        return rows

    def observation(self, inputs: ControllerInput) -> np.ndarray:
        """Return the observation (2 + 7 K,) of `inputs`, and record goals that are reached.

        Parameters
        ----------
        inputs : ControllerInput
            Input of the tick.

        Returns
        -------
        ndarray, shape (2 + 7 K,)
            Observation.
        """
        rows = self.rows(inputs)
        goals, place = self._assignment.pairs(inputs)[1], inputs.position[rows]
        self.waiting &= distances(place, goals) > ARRIVAL
        return observation(
            place, inputs.speed[rows] * np.exp(1j * inputs.phi[rows]), goals, self.waiting,
            inputs.field / (inputs.limits.field or 1.0), inputs.workspace)
