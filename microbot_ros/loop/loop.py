"""The whole loop, from a frame to the currents that may flow."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from microbot_ros.control.deadline_worker import UnhurriedWorker
from microbot_ros.control.manager import Outcome
from microbot_ros.drive.gate import Gate
from microbot_ros.loop.allocation import AllocationStage, GateParameters, limits
from microbot_ros.loop.controller import ControllerParameters, ControllerStage
from microbot_ros.loop.model import ModelParameters, ModelStage
from microbot_ros.loop.tracker import TrackerParameters, TrackerStage


@dataclass(frozen=True)
class LoopParameters:
    """What its parts are configured with.

    `controllers` holds the parameters of each controller by its name, where they are not the
    default ones.
    """

    tracker: TrackerParameters = dataclasses.field(default_factory=TrackerParameters)
    model: ModelParameters = dataclasses.field(default_factory=ModelParameters)
    controller: ControllerParameters = dataclasses.field(default_factory=ControllerParameters)
    gate: GateParameters = dataclasses.field(default_factory=GateParameters)
    controllers: Mapping[str, Any] = dataclasses.field(default_factory=dict)


@dataclass(frozen=True)
class LoopStep:
    """What one frame gives.

    `t` [s] is its exposure; `particles` (N,) of type PARTICLE are those in it, `estimates` (M,)
    of type ESTIMATE what is known of them and of those that have just gone out of sight. `field`
    (2,) [T] is what the controller asks for, `frequency` [Hz] that of a rolling field, `currents`
    (4,) [A] what the gate affirms of it, and `reasons` why that may be less.
    """

    t: float
    particles: np.ndarray
    estimates: np.ndarray
    field: np.ndarray
    frequency: float
    currents: np.ndarray
    reasons: tuple[str, ...]


class Loop:
    """Tracker, model, controller manager, allocation and gate as one function of a frame.

    It has no thread and no clock: times come with what it is given, and controllers are called
    without a deadline. The same frames, measurements and goals give the same currents to the last
    bit. Raises InputError for parameters that contradict each other.
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
        self.gate = Gate(limits(parameters.gate))

    @property
    def tracker(self) -> TrackerStage:
        """The first stage, made when it is first needed."""
        if self._tracker is None:
            self._tracker = TrackerStage(self._parameters.tracker)
        return self._tracker

    def arm(self, t: float) -> None:
        """Let currents flow from `t` [s] on. Raises RuntimeError with the gate's reason."""
        if refusal := self.gate.arm(t):
            raise RuntimeError(refusal)

    def measured(self, currents: np.ndarray, t: float) -> np.ndarray:
        """The amplifier reads currents (4,) [A] back at `t` [s]; the field (2,) [T] they make."""
        self.gate.measured(currents.tolist(), t)
        field = self.allocation.field(currents)
        self.model.field(t, field)
        if self._tracker is not None:
            self._tracker.field(t, field)
        return field

    def step(self, image: np.ndarray, t: float) -> LoopStep:
        """Take an `image` (H, W) that was exposed at `t` [s].

        Raises FrameError for one that cannot be used: nothing is commanded then.
        """
        return self.steer(self.tracker.step(image, t), t)

    def steer(self, particles: np.ndarray, t: float) -> LoopStep:
        """Take particles (N,) of type PARTICLE, seen at `t` [s], as a tracker of one's own gives
        them.
        """
        estimates = self.model.step(particles, t)
        outcome = self.controller.step(estimates, t, t)
        if outcome.command is None:
            self.controller.let_go()
        field, frequency = _asked(outcome)
        currents = self.gate.command(self.allocation.step(field).tolist(), t)
        return LoopStep(t, particles, estimates, field, frequency, np.array(currents),
                        self._reasons(outcome))

    def _reasons(self, outcome: Outcome) -> tuple[str, ...]:
        found = self.model.estimates
        doubts = found.diagnosis if found is not None else ()
        fault = self.gate.fault
        said = (outcome.message, *doubts, f'{fault.reason.value}: {fault.detail}' if fault else '')
        return tuple(filter(None, said))


def _asked(outcome: Outcome) -> tuple[np.ndarray, float]:
    if outcome.command is None:
        return np.zeros(2), 0.0
    return outcome.command.field, outcome.command.frequency
