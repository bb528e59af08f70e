"""Runs one of several controllers, switches them, and lets nothing unsafe out. No ROS in it."""

from __future__ import annotations

import dataclasses
import logging
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from microbot_ros.control.contract import (
    PER_PARTICLE,
    Controller,
    ControllerError,
    ControllerInput,
    FieldCommand,
    Limits,
    Result,
    no_field,
)
from microbot_ros.control.controller_thread import (
    CONFIGURING,
    ConfiguringError,
    ControllerThread,
    reason,
)
from microbot_ros.control.deadline_worker import DeadlineWorker, LateError
from microbot_ros.control.field_record import FieldRecord
from microbot_ros.control.steering.border import kept_in_view
from microbot_ros.control.steering.forecast import look_ahead

_log = logging.getLogger(__name__)

LONGEST_STEP = 0.1
"""A tick counts as no longer than this [s] for the slew: after a gap the field does not jump."""


@dataclass(frozen=True)
class SwitchResult:
    """Whether a request was granted (`ok`), and a `message`: why not, or what has changed."""

    ok: bool
    message: str = ''


@dataclass(frozen=True)
class Outcome:
    """What one tick gives: the command to send, or None for no command at all; how it came to
    that, and a `message` on it."""

    command: FieldCommand | None
    result: Result = Result.OK
    message: str = ''


class ControllerManager:
    """All controllers of a rig, of which one drives.

    `controllers` by name, `active` the first to drive. A tick waits at most `deadline` [s] for
    its controller and gives it up after `patience` [s]. Poses older than `pose_timeout` [s] mean
    no command. Particles that would be out of the workspace within `border` [s] turn the field;
    0: never. `worker` makes, from that patience, what calls a controller. Whatever goes wrong, the
    field falls to zero at the allowed slew, and the outcome says why. After a fault the controller
    is not asked again before the next successful switch.

    Every command starts from the field that flows: the last command, or zero after stale poses,
    after a gap between frames of more than `pose_timeout`, which no dead-man lets pass, and after
    `let_go` and `reset`. Whoever drives the coils calls `let_go` when it puts them to zero.
    """

    def __init__(
        self, controllers: dict[str, Controller], active: str, *,
        deadline: float = 0.01, patience: float = 0.5, pose_timeout: float = 0.2,
        border: float = 0.5, worker: Callable[[float], DeadlineWorker] = DeadlineWorker,
    ) -> None:
        self._threads = {name: ControllerThread(name, it, patience, worker)
                         for name, it in controllers.items()}
        self._active = active
        self._deadline = deadline
        self._pose_timeout = pose_timeout
        self._border = border
        self._record = FieldRecord()
        self._field = np.zeros(3)
        self._fault = ''
        self._last: ControllerInput | None = None

    @property
    def active(self) -> str:
        """The name of the controller that drives."""
        return self._active

    @property
    def fault(self) -> str:
        """Why the active controller is not asked any more; '' while it is."""
        return self._fault

    def configure(self, name: str, parameters: Any, seconds: float = CONFIGURING) -> SwitchResult:
        """Give one controller new parameters, whether it drives or not; all or nothing.

        Waits `seconds` at most, as `change` does.
        """
        return self._try(name, lambda: self._threads[name].configure(parameters, seconds))

    def change(self, parameters: Mapping[str, Any], drives: str = '',
               seconds: float = CONFIGURING) -> SwitchResult:
        """New parameters for the controllers named, then another one that drives: all or nothing.

        `drives` is '' where the same goes on driving. A controller that takes its parameters for
        more than `seconds` does so aside: the change is refused with a message that ends in
        `AGAIN`, and the same change, asked again once it is ready, is made at once.
        """
        before = {name: self._threads[name].parameters for name in parameters}
        taken: list[str] = []
        answer = SwitchResult(True)
        for name, values in parameters.items():  # so that one that is not ready undoes no other
            if answer.ok:
                answer = self._try(name, partial(self._threads[name].prepare, values, seconds))
        for name, values in parameters.items():
            if not answer.ok:
                break
            answer = self.configure(name, values, seconds)
            if answer.ok:
                taken.append(name)
        if answer.ok and drives:
            answer = self.switch_controller(drives)
        if not answer.ok:
            for name in taken:
                self._threads[name].restore(before[name], seconds)
        return answer

    def _try(self, name: str, work: Callable[[], None]) -> SwitchResult:
        try:
            work()
        except ConfiguringError as error:
            return SwitchResult(False, f'{name} {error}')
        except Exception as error:
            return SwitchResult(False, f'{name}: {reason(error)}')
        return SwitchResult(True)

    def switch_controller(self, name: str) -> SwitchResult:
        """Let another controller drive from the next tick on; if it can't, nothing changes.

        It is activated here, within the deadline, against the input of the last tick and the
        present field; then the one before is deactivated, in half of that. Naming the controller
        that drives restarts it, after a fault too.
        """
        if name not in self._threads:
            known = ', '.join(self._threads)
            return SwitchResult(False, f"no controller '{name}'; there are: {known}")
        before, after = self._threads[self._active], self._threads[name]
        if after is before:
            before.deactivate(self._deadline / 2)
        try:
            if self._last is not None:
                inputs = dataclasses.replace(self._last, field=self._field[:2].copy())
                after.activate(inputs, self._deadline)
        except Exception as error:
            return SwitchResult(False, f'{name}: {reason(error)}')
        if after is not before:
            before.deactivate(self._deadline / 2)
        self._active, self._fault = name, ''
        return SwitchResult(True, f'{name} drives')

    def let_go(self) -> None:
        """No field flows any more: the next command starts from zero."""
        self._field = np.zeros(3)

    def reset(self) -> None:
        """Let go, and every controller forgets what it learned and did."""
        self.let_go()
        self._record.clear()
        for thread in self._threads.values():
            thread.renew()

    def tick(self, inputs: ControllerInput) -> Outcome:
        """The command for `inputs`, or None where the poses are too old to give one.

        Particles without a finite position are left out before the controller looks.
        """
        fresh = abs(inputs.age) <= self._pose_timeout
        if not fresh or inputs.dt > self._pose_timeout:
            self.let_go()
            self._record.clear()
        if not fresh:
            return Outcome(None, Result.STALE, f'poses are {inputs.age:.2f} s old')
        inputs = _with_delay_of_model(_usable(inputs))
        self._last = inputs = dataclasses.replace(
            inputs, field=self._field[:2].copy(), record=self._record,
            expected=look_ahead(inputs, self._record))
        command, result, message = self._ask(inputs)
        self._field = _approach(self._field, _in_space(command.field), inputs)
        field = self._field if self._field[2] else self._field[:2]
        command = dataclasses.replace(command, field=field)
        self._record.note(inputs.t + inputs.delay, command.drive, command.frequency)
        return Outcome(command, result, message)

    def close(self) -> None:
        """Let the active controller go; nothing may be asked afterwards."""
        self._threads[self._active].deactivate(self._deadline)
        for thread in self._threads.values():
            thread.close()

    def _ask(self, inputs: ControllerInput) -> tuple[FieldCommand, Result, str]:
        """What the controller answers, or zero field with the reason why not that."""
        if self._fault:
            return no_field(self._fault), Result.FAULT, self._fault
        try:
            command = self._threads[self._active].compute(inputs, self._deadline)
            command = _checked(command, inputs.limits)
            if self._border > 0:
                kept = kept_in_view(inputs, command, self._border)
                command = command if kept is command else _checked(kept, inputs.limits)
            return command, Result.OK, command.progress.message
        except ControllerError as error:
            result, why = error.result, str(error)
        except LateError as error:
            result, why = Result.FAULT, f'{self._active}: {error}'
        except Exception as error:
            result = Result.FAULT
            self._fault = why = f'{self._active}: {reason(error)}'
            _log.error('%s; the field is let go', why)
        return no_field(why), result, why


def _usable(inputs: ControllerInput) -> ControllerInput:
    good = np.isfinite(inputs.position).all(1)
    if good.all():
        return inputs
    rows = {name: getattr(inputs, name)[good] for name in PER_PARTICLE}
    return dataclasses.replace(inputs, **rows)


def _with_delay_of_model(inputs: ControllerInput) -> ControllerInput:
    """A delay that the model knows of adds to how long a command takes to act."""
    model = inputs.model
    if model is None or not model.delay:
        return inputs
    return dataclasses.replace(
        inputs, delay=inputs.delay + model.delay, model=model.undelayed())


def _checked(command: FieldCommand, limits: Limits) -> FieldCommand:
    """The command with a field of its own, (2,) or (3,), and, where it has one, an axis of unit
    length; ValueError unless finite and within limits."""
    field = np.array(command.field, dtype=float).reshape(-1)
    if len(field) not in (2, 3):
        raise ValueError(f'commanded a field of {len(field)} components; expected 2 or 3')
    strength = math.hypot(*field.tolist())
    if not strength <= limits.field * (1 + 1e-9):
        raise ValueError(f'commanded {strength * 1e3:g} mT; the limit is {limits.field * 1e3:g}')
    if not 0 <= command.frequency <= limits.frequency:
        raise ValueError(f'commanded {command.frequency:g} Hz; expected 0 to {limits.frequency:g}')
    return dataclasses.replace(
        command, field=field, frequency=float(command.frequency), axis=_unit(command.axis))


def _unit(axis: np.ndarray | None) -> np.ndarray | None:
    if axis is None:
        return None
    found = np.array(axis, dtype=float).reshape(3)
    length = math.hypot(*found.tolist())
    if not 0 < length < math.inf:
        raise ValueError(f'commanded an axis {axis}; expected a direction')
    return found / length


def _in_space(field: np.ndarray) -> np.ndarray:
    """A field (2,) or (3,) as (3,)."""
    return np.array([*field.tolist(), 0.0][:3])


def _approach(now: np.ndarray, wanted: np.ndarray, inputs: ControllerInput) -> np.ndarray:
    """The wanted field, or as far towards it as the slew lets one tick go.

    A clock that stands or runs backwards gives no time to change in: the field stays. Letting
    go needs none.
    """
    if not inputs.dt > 0:
        return now if wanted.any() else wanted
    step = wanted - now
    length = math.hypot(*step.tolist())
    longest = inputs.limits.slew * min(inputs.dt, LONGEST_STEP)
    return now + step if length <= longest else now + step * (longest / length)
