"""Shared parts of controllers: courses, the field along them, checked goals."""

from __future__ import annotations

import cmath
import math

import numpy as np

from microbot_ros.control.contract import ControllerInput, FieldCommand, GoalError, Progress


def approach(offset: complex, hold_radius: float) -> float:
    """Return the course [rad] to a place at `offset` [m], for a particle that cannot stop.

    From afar it is the tangent to a circle of `hold_radius` [m] about the place, so that the
    circle is joined without a turn; on the circle it runs counter-clockwise; from inside it leads
    outwards. A circle keeps the distance constant and shows an estimator every direction.

    Parameters
    ----------
    offset : complex
        Vector to the place, complex [m].
    hold_radius : float
        Radius of the circle [m].

    Returns
    -------
    float
        Course [rad].
    """
    distance = abs(offset)
    if distance >= hold_radius:
        away = math.asin(hold_radius / distance)
    else:
        away = math.pi * (1 - distance / hold_radius / 2)
    return cmath.phase(offset) - away


def field_along(inputs: ControllerInput, angle: float, strength: float) -> np.ndarray:
    """Return the command (2,) [T] whose field at the particles points along `angle` [rad].

    Its strength is `strength` [T], if the limit of `inputs` leaves room to compensate the known
    errors of the path from command to field (stray field, unequal or tilted coils).

    Parameters
    ----------
    inputs : ControllerInput
        Input of the tick.
    angle : float
        Direction of the field at the particles [rad].
    strength : float
        Strength of the field [T].

    Returns
    -------
    ndarray, shape (2,)
        Field [T].
    """
    limit = inputs.limits.field
    strength = min(strength, limit)
    wanted = np.array([strength * math.cos(angle), strength * math.sin(angle)])
    if inputs.model is None or inputs.model.is_first_order:
        return wanted
    command = wanted.copy()
    for _ in range(6):
        command += wanted - inputs.model.field(command)
        excess = math.hypot(*command) / limit
        if excess > 1:
            wanted, command = wanted / excess, command / excess
    return command


def goals_in_reach(inputs: ControllerInput) -> np.ndarray:
    """Return the goals (G, 2) [m] of `inputs`; GoalError if one is outside the workspace.

    Parameters
    ----------
    inputs : ControllerInput
        Input of the tick.

    Returns
    -------
    ndarray, shape (G, 2)
        Goals [m].
    """
    position = inputs.goals.position
    lost = np.flatnonzero(~inputs.workspace.holds(position))
    if lost.size:
        x, y = position[lost[0]] * 1e6
        raise GoalError(f'goal {lost[0] + 1} at ({x:.0f}, {y:.0f}) µm is outside the workspace')
    return position


class Excitation:
    """Course of the field while the response of the particles is unknown: a triangle.

    It returns to its start and shows an estimator three directions.
    """

    def __init__(self) -> None:
        self._begun: float | None = None

    def stop(self) -> None:
        """Stop; the next command starts a new triangle."""
        self._begun = None

    def command(self, inputs: ControllerInput, leg: float, strength: float, *,
                particles: np.ndarray | None, frequency: float = 0.0) -> FieldCommand:
        """Return a field of `strength` [T] and `frequency` [Hz] for `inputs`; `leg` [s] per side.

        `particles` (K,) are the ids of those it is for; None: all.

        Parameters
        ----------
        inputs : ControllerInput
            Input of the tick.
        leg : float
            Duration of a side [s].
        strength : float
            Strength of the field [T].
        particles : ndarray or None
            Identities (K,) of particles; None for all.
        frequency : float
            Frequency of the field [Hz].

        Returns
        -------
        FieldCommand
            The command.
        """
        if self._begun is None:
            self._begun = inputs.t
        angle = 2 * math.pi / 3 * ((inputs.t - self._begun) // leg)
        return FieldCommand(field_along(inputs, angle, strength), frequency,
                            Progress('learns how particles answer to the field'), particles)
