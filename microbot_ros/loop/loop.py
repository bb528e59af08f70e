"""The whole loop, from a frame to the currents that may flow."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from microbot_ros.control.deadline_worker import UnhurriedWorker
from microbot_ros.control.manager import Outcome
from microbot_ros.drive.gate import Gate
from microbot_ros.drive.rotation import Rotation
from microbot_ros.loop.allocation import AllocationStage, GateParameters, limits
from microbot_ros.loop.controller import ControllerParameters, ControllerStage
from microbot_ros.loop.felt_rotation import FeltRotation
from microbot_ros.loop.model import ModelParameters, ModelStage
from microbot_ros.loop.tracker import TrackerParameters, TrackerStage


@dataclass(frozen=True)
class LoopParameters:
    """Parameters of the stages of the loop.

    `controllers` holds the parameters of controllers by name, if they differ from the defaults.
    """

    tracker: TrackerParameters = dataclasses.field(default_factory=TrackerParameters)
    model: ModelParameters = dataclasses.field(default_factory=ModelParameters)
    controller: ControllerParameters = dataclasses.field(default_factory=ControllerParameters)
    gate: GateParameters = dataclasses.field(default_factory=GateParameters)
    controllers: Mapping[str, Any] = dataclasses.field(default_factory=dict)


@dataclass(frozen=True)
class LoopStep:
    """Result of one frame.

    Attributes
    ----------
    t : float
        Exposure of the frame [s].
    particles : (N,) array of PARTICLE
        Particles in the frame.
    estimates : (M,) array of ESTIMATE
        Estimates of these and of particles that have just been lost.
    field : (2,) or (3,) array [T]
        Field that the controller commands.
    angular_velocity : (3,) array [rad/s]
        Rotation of that field.
    currents : (N,) array [A]
        Currents that the gate passes at `t`.
    reasons : tuple of str
        Why the currents may make less than the field.
    """

    t: float
    particles: np.ndarray
    estimates: np.ndarray
    field: np.ndarray
    angular_velocity: np.ndarray
    currents: np.ndarray
    reasons: tuple[str, ...]


class Loop:
    """Tracker, model, controller manager, allocation and gate as one function of a frame.

    It works for any number of coils N, with two or three axes, and for rotating fields: `sample`
    gives their currents between two frames. It has no thread and no clock: times are arguments,
    and controllers have no deadline. Equal frames, measurements and goals give equal currents to
    the last bit. Raises InputError for contradictory `parameters`.

    Parameters
    ----------
    parameters : LoopParameters
        Parameters of all stages.
    """

    def __init__(self, parameters: LoopParameters) -> None:
        self._tracker: TrackerStage | None = None
        self._parameters = parameters
        self.model = ModelStage(parameters.model)
        self.model.use(parameters.model.model_file)
        self.controller = ControllerStage(parameters.controller, UnhurriedWorker)
        answer = self.controller.configure(parameters.controller, parameters.controllers)
        if not answer.ok:
            raise ValueError(answer.message)
        self.allocation = AllocationStage(parameters.gate)
        self.gate = Gate(limits(parameters.gate), len(self.allocation.coils.names))
        self._rotation = Rotation(self.gate.limits.slew_A_per_s)
        self._felt = FeltRotation()
        self._given_t = -math.inf

    @property
    def tracker(self) -> TrackerStage:
        """The first stage, created on first use."""
        if self._tracker is None:
            self._tracker = TrackerStage(self._parameters.tracker)
        return self._tracker

    def arm(self, t: float) -> None:
        """Arm the gate at `t` [s]. Raises RuntimeError with the gate's reason if it refuses.

        Parameters
        ----------
        t : float
            Time [s].
        """
        if refusal := self.gate.arm(t):
            raise RuntimeError(refusal)

    def measured(self, currents: np.ndarray, t: float) -> np.ndarray:
        """Process the `currents` (N,) [A] that the amplifier reads back at `t` [s].

        Returns the field (2,) or (3,) [T] that they make.

        Parameters
        ----------
        currents : ndarray, shape (N,)
            Current of each coil [A].
        t : float
            Time [s].

        Returns
        -------
        ndarray, shape (2,)
            Field or (3,) [T].
        """
        self.gate.measured(currents.tolist(), t)
        field = self.allocation.field(currents)
        if self._rolls:
            if changed := self._felt.applied(t, field):
                self._tell_rotation(*changed)
        else:
            self.model.field(t, field[:2])
            if self._tracker is not None:
                self._tracker.field(t, field[:2])
        return field

    def sample(self, t: float) -> np.ndarray:
        """Return the currents (N,) [A] that may flow at `t` [s], between two frames.

        Parameters
        ----------
        t : float
            Time [s].

        Returns
        -------
        ndarray, shape (N,)
            Currents [A].
        """
        if self._rotation.turns:
            self.gate.command(self._rotation.currents(t).tolist(), t, self._given_t)
        else:
            self.gate.tick(t)
        if not self.gate.armed:
            self._rotation.stop()
        return np.array(self.gate.output)

    def step(self, image: np.ndarray, t: float) -> LoopStep:
        """Process an `image` (H, W) that was exposed at `t` [s].

        Raises FrameError for an unusable image; nothing is commanded then.

        Parameters
        ----------
        image : ndarray, shape (H, W)
            The picture.
        t : float
            Exposure of the picture [s].

        Returns
        -------
        LoopStep
            Results of all stages.
        """
        return self.steer(self.tracker.step(image, t), t)

    def steer(self, particles: np.ndarray, t: float) -> LoopStep:
        """Process `particles` (N,) of type PARTICLE from another tracker, seen at `t` [s].

        Parameters
        ----------
        particles : ndarray, shape (N,)
            PARTICLE of each particle.
        t : float
            Time at which they were seen [s].

        Returns
        -------
        LoopStep
            Results of all stages.
        """
        estimates = self.model.step(particles, t)
        outcome = self.controller.step(estimates, t, t)
        if outcome.command is None:
            self.controller.let_go()
        field, angular_velocity = _asked(outcome)
        refusal = self._command(field, angular_velocity, t)
        return LoopStep(t, particles, estimates, field, angular_velocity, self.sample(t),
                        self._reasons(outcome, refusal))

    @property
    def _rolls(self) -> bool:
        return self._parameters.model.propulsion == 'rolling'

    def _command(self, field: np.ndarray, angular_velocity: np.ndarray, t: float) -> str:
        """Command a field at `t` [s], rotating or not.

        Return why the coils cannot make it, or ''.
        """
        if self._rolls and (changed := self._felt.command(t, angular_velocity[:2])):
            self._tell_rotation(*changed)
        try:
            if angular_velocity.any() and field.any():
                wanted = self.allocation.turn(np.array([*field, 0.0][:3]), angular_velocity)
                self._rotation.follow(wanted, t, np.array(self.gate.output))
                self._given_t = t
            else:
                currents = self.allocation.step(field)
                self._rotation.stop()
                self.gate.command(currents.tolist(), t)
        except ValueError as error:
            return str(error)
        return ''

    def _tell_rotation(self, t: float, angular_velocity: np.ndarray) -> None:
        self.model.rotation(t, angular_velocity)
        if self._tracker is not None:
            self._tracker.rotation(t, angular_velocity)

    def _reasons(self, outcome: Outcome, refusal: str) -> tuple[str, ...]:
        found = self.model.estimates
        doubts = found.diagnosis if found is not None else ()
        fault = self.gate.fault
        cut = f'{fault.reason.value}: {fault.detail}' if fault else ''
        said = (outcome.message, refusal, *doubts, cut)
        return tuple(filter(None, said))


def _asked(outcome: Outcome) -> tuple[np.ndarray, np.ndarray]:
    """Return the field and the angular velocity of an outcome; zero without a command."""
    if outcome.command is None:
        return np.zeros(2), np.zeros(3)
    return outcome.command.field, outcome.command.angular_velocity
