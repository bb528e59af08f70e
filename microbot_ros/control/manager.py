"""Manager that runs one of several controllers, switches them and checks commands; free of ROS."""

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
"""Choice: longest tick [s] counted for the slew, so that the field does not jump after a gap."""


@dataclass(frozen=True)
class SwitchResult:
    """Whether a request was granted (`ok`), and a `message` on why not or what changed."""

    ok: bool
    message: str = ''


@dataclass(frozen=True)
class Outcome:
    """Outcome of one tick.

    `command` is to be sent, None for no command at all; `result` and `message` say how it came
    about.
    """

    command: FieldCommand | None
    result: Result = Result.OK
    message: str = ''


class ControllerManager:
    """All controllers of a rig, one of which is active.

    On any error the field falls to zero at the allowed slew, and the outcome gives the reason.
    After a fault the controller is not called again before the next successful switch.

    Every command starts from the present field: the last command, or zero after stale poses, after
    a gap between frames of more than `pose_timeout` (which trips every dead-man switch), and after
    `let_go` and `reset`. The driver of the coils calls `let_go` when it sets them to zero.

    Parameters
    ----------
    controllers : dict of str to Controller
        Controllers of the rig by name.
    active : str
        The first active controller.
    deadline : float
        Longest time [s] that a tick waits for its controller.
    patience : float
        Time [s] after which a call is abandoned.
    pose_timeout : float
        Age of the poses [s] beyond which there is no command.
    border : float
        The field is turned if particles would leave the workspace within this time [s]; 0: never.
    worker : callable
        Makes the worker that calls a controller from the patience.
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
        """Name of the active controller."""
        return self._active

    @property
    def fault(self) -> str:
        """Why the active controller is no longer called; '' while it is."""
        return self._fault

    def configure(self, name: str, parameters: Any, seconds: float = CONFIGURING) -> SwitchResult:
        """Set new `parameters` of the controller `name`, active or not, or keep the old ones.

        Waits at most `seconds`, as `change` does.

        Parameters
        ----------
        name : str
            Name of the controller.
        parameters : object
            Parameters of the controller.
        seconds : float
            Longest time to wait [s].

        Returns
        -------
        SwitchResult
            Whether the parameters were accepted, and if not why.
        """
        return self._try(name, lambda: self._threads[name].configure(parameters, seconds))

    def change(self, parameters: Mapping[str, Any], drives: str = '',
               seconds: float = CONFIGURING) -> SwitchResult:
        """Set new `parameters` of controllers by name and switch to another one: all or nothing.

        `drives` is the controller to switch to, '' for none. If a controller needs more than
        `seconds` for its parameters, it continues in the background: the change is refused with a
        message that ends in `AGAIN`, and the same change, requested again once it is ready, is
        made at once.

        Parameters
        ----------
        parameters : mapping of str to object
            Parameters by controller.
        drives : str
            Name of the controller to switch to; '' for none.
        seconds : float
            Longest time to wait [s].

        Returns
        -------
        SwitchResult
            Whether the change was made, and if not why.
        """
        before = {name: self._threads[name].parameters for name in parameters}
        taken: list[str] = []
        answer = SwitchResult(True)
        for name, values in parameters.items():  # all first, so that nothing has to be undone
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
        """Activate the controller `name` from the next tick on; if that fails, nothing changes.

        It is activated here, within the deadline, with the input of the last tick and the present
        field; then the previous one is deactivated, in half of that time. Naming the active
        controller restarts it, also after a fault.

        Parameters
        ----------
        name : str
            Name of the controller.

        Returns
        -------
        SwitchResult
            Whether the controller was switched, and if not why.
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
        """Set the field to zero: the next command starts from there."""
        self._field = np.zeros(3)

    def reset(self) -> None:
        """Set the field to zero and reset every controller."""
        self.let_go()
        self._record.clear()
        for thread in self._threads.values():
            thread.renew()

    def tick(self, inputs: ControllerInput) -> Outcome:
        """Return the command for `inputs`, or None if the poses are too old.

        Particles without a finite position are removed first.

        Parameters
        ----------
        inputs : ControllerInput
            Input of the tick.

        Returns
        -------
        Outcome
            The command, or None, with the reason.
        """
        fresh = abs(inputs.age) <= self._pose_timeout
        if not fresh or abs(inputs.dt) > self._pose_timeout:
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
        """Deactivate the controller and release all threads; nothing may be called later."""
        self._threads[self._active].deactivate(self._deadline)
        for thread in self._threads.values():
            thread.close()

    def _ask(self, inputs: ControllerInput) -> tuple[FieldCommand, Result, str]:
        """Return the checked command of the controller, or zero field with the reason."""
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
            _log.error('%s; the field is set to zero', why)
        return no_field(why), result, why


def _usable(inputs: ControllerInput) -> ControllerInput:
    good = np.isfinite(inputs.position).all(1)
    if good.all():
        return inputs
    rows = {name: getattr(inputs, name)[good] for name in PER_PARTICLE}
    return dataclasses.replace(inputs, **rows)


def _with_delay_of_model(inputs: ControllerInput) -> ControllerInput:
    """Move the delay of the model into the delay of the input."""
    model = inputs.model
    if model is None or not model.delay:
        return inputs
    return dataclasses.replace(
        inputs, delay=inputs.delay + model.delay, model=model.undelayed())


def _checked(command: FieldCommand, limits: Limits) -> FieldCommand:
    """Return the command with a copied field (2,) or (3,) and an axis of unit length, if any.

    Raises ValueError unless it is finite and within limits.
    """
    field = np.array(command.field, dtype=float).reshape(-1)
    if len(field) not in (2, 3):
        raise ValueError(f'commanded a field of {len(field)} components; expected 2 or 3')
    strength = math.hypot(*field.tolist())
    if not strength <= limits.field * (1 + 1e-9):
        raise ValueError(f'commanded {strength * 1e3:g} mT; the limit is {limits.field * 1e3:g} '
                         'mT')
    if not 0 <= command.frequency <= limits.frequency:
        raise ValueError(f'commanded {command.frequency:g} Hz; expected 0 to {limits.frequency:g} '
                         'Hz')
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
    """Return a field (2,) or (3,) as (3,)."""
    return np.array([*field.tolist(), 0.0][:3])


def _approach(now: np.ndarray, wanted: np.ndarray, inputs: ControllerInput) -> np.ndarray:
    """Return the wanted field, or as far towards it as the slew allows in one tick.

    If the clock stands or runs backwards, the field stays, or is switched off, which needs no
    time.
    """
    if not inputs.dt > 0:
        return now if wanted.any() else wanted
    step = wanted - now
    length = math.hypot(*step.tolist())
    longest = inputs.limits.slew * min(inputs.dt, LONGEST_STEP)
    return now + step if length <= longest else now + step * (longest / length)
