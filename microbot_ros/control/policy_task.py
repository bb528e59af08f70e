"""What a learned policy is shown and what its answer means, in training and at the rig alike.

The task: each of K particles has a goal and is to have been there once, all driven by one field.
A particle at p moves by c ∫u dt, with its velocity phasor c = v e^{iφ} and the direction u of the
field, so that (g − p)/c [s] is the ∫u dt that takes it to its goal g: counted like that, one field
moves all particles alike. A policy sees 2 + 7 K numbers of single precision:

    0, 1   the field that flows, as a part of the strongest allowed;
    then of each particle, in ascending order of the ids,
    0, 1   (g − p)/c in units of 30 s, or 0 once it has been at its goal,
    2, 3   p, ±1 at the borders of the workspace,
    4, 5   c in units of 10 µm/s,
    6      1 until it has been at its goal, then 0;

each cut off at ±10. It answers with two: the wanted field as a part of the strongest allowed. What
is longer than 1 is shortened to that.
"""

from __future__ import annotations

import numpy as np

from microbot_ros.control.contract import ControllerInput, ParticleLostError, Workspace
from microbot_ros.control.planning.assignment import Assignment
from microbot_ros.control.planning.shared import as_complex

SHARED_NUMBERS, PARTICLE_NUMBERS = 2, 7
"""How many numbers of an observation are of the field, and how many of each particle."""
LARGEST = 10.0
"""Where each of them is cut off."""
ARRIVAL = 2e-6
"""A goal counts as reached from this close [m]."""
_WAY_S, _SPEED = 30.0, 10e-6


def distances(position: np.ndarray, goals: np.ndarray) -> np.ndarray:
    """How far [m] particles at a `position` (..., 2) [m] are from their `goals` (..., 2) [m]."""
    return np.asarray(np.abs(as_complex(goals - position)))


def observation(
    position: np.ndarray, velocity_phasor: np.ndarray, goals: np.ndarray, waiting: np.ndarray,
    share: np.ndarray, workspace: Workspace,
) -> np.ndarray:
    """What a policy is shown (..., 2 + 7 K), float32.

    Of each particle `position` (..., K, 2) [m], `velocity_phasor` (..., K) [m/s], its goal of
    `goals` (..., K, 2) [m] and whether it is still `waiting` (..., K) to be there; the `share`
    (..., 2) of the strongest field that flows. The way of one that does not move is shown as 0.
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
    """The field (..., 2) [T] that an `action` (..., 2) asks for; NaN where that is no number.

    `strongest` [T] is the largest that is allowed.
    """
    action = np.asarray(action, dtype=float)
    with np.errstate(invalid='ignore', over='ignore'):
        length = np.hypot(action[..., 0], action[..., 1])
        scale = np.where(np.isfinite(length), strongest / np.maximum(length, 1.0), np.nan)
    return np.asarray(action * scale[..., None])


class PolicyTask:
    """Whose goal is whose, who has been there, and what a policy is shown of it."""

    def __init__(self) -> None:
        self._assignment = Assignment()
        self.waiting = np.zeros(0, bool)
        """Which particles (K,), in ascending order of their ids, have not been at their goals."""

    def rows(self, inputs: ControllerInput) -> np.ndarray:
        """The rows (K,) in `inputs` of the particles that have goals; new goals begin the task.

        GoalError for one outside the workspace, ParticleLostError where a particle that has one
        is not seen.
        """
        if self._assignment.update(inputs):
            self.waiting = np.ones(len(inputs.goals), bool)
        rows = self._assignment.pairs(inputs)[0]
        if lost := len(self.waiting) - len(rows):
            raise ParticleLostError(f'{lost} of the particles that have goals are not seen')
        return rows

    def observation(self, inputs: ControllerInput) -> np.ndarray:
        """What a policy is shown (2 + 7 K,) of `inputs`; who is at a goal has now been there."""
        rows = self.rows(inputs)
        goals, place = self._assignment.pairs(inputs)[1], inputs.position[rows]
        self.waiting &= distances(place, goals) > ARRIVAL
        return observation(
            place, inputs.speed[rows] * np.exp(1j * inputs.phi[rows]), goals, self.waiting,
            inputs.field / (inputs.limits.field or 1.0), inputs.workspace)
