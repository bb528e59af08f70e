"""Runs one of several controllers, swaps them, and lets nothing unsafe out. No ROS in it."""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from microbot_ros.control.border import kept_in_view
from microbot_ros.control.contract import (
    PER_PARTICLE,
    Controller,
    ControllerError,
    FieldCommand,
    Limits,
    Result,
    Situation,
    no_field,
)
from microbot_ros.control.field_record import FieldRecord
from microbot_ros.control.forecast import look_ahead
from microbot_ros.control.runner import Runner, reason
from microbot_ros.control.worker import LateError, Worker

_log = logging.getLogger(__name__)

LONGEST_STEP = 0.1
"""A tick counts as no longer than this [s] for the slew: after a gap the field does not jump."""


@dataclass(frozen=True)
class Answer:
    """Whether a request was granted, and why not."""

    ok: bool
    message: str = ''


@dataclass(frozen=True)
class Outcome:
    """What one tick gives: the command to send, or None for no command at all."""

    command: FieldCommand | None
    result: Result = Result.OK
    message: str = ''


class Switchboard:
    """All controllers of a rig, of which one drives.

    `controllers` by name, `active` the first to drive. A tick waits at most `deadline` [s] for
    its controller and gives it up after `patience` [s]. Poses older than `stale_after` [s] mean
    no command. Particles that would be out of the workspace within `border` [s] turn the field;
    0: never. `worker` makes, from that patience, what calls a controller. Whatever goes wrong, the
    field falls to zero at the allowed slew, and the outcome says why. After a fault the controller
    is not asked again before the next successful swap.

    Every command starts from the field that flows: the last command, or zero after stale poses,
    after a gap between frames of more than `stale_after`, which no dead-man lets pass, and after
    `let_go` and `reset`. Whoever drives the coils calls `let_go` when it puts them to zero.
    """

    def __init__(
        self, controllers: dict[str, Controller], active: str, *,
        deadline: float = 0.01, patience: float = 0.5, stale_after: float = 0.2,
        border: float = 0.5, worker: Callable[[float], Worker] = Worker,
    ) -> None:
        self._runners = {name: Runner(name, it, patience, worker)
                         for name, it in controllers.items()}
        self._active = active
        self._deadline = deadline
        self._stale_after = stale_after
        self._border = border
        self._record = FieldRecord()
        self._field = np.zeros(2)
        self._fault = ''
        self._last: Situation | None = None

    @property
    def active(self) -> str:
        """The name of the controller that drives."""
        return self._active

    @property
    def fault(self) -> str:
        """Why the active controller is not asked any more; '' while it is."""
        return self._fault

    def configure(self, name: str, parameters: Any) -> Answer:
        """Give one controller new parameters, whether it drives or not; all or nothing."""
        try:
            self._runners[name].configure(parameters)
        except Exception as error:
            return Answer(False, f'{name}: {reason(error)}')
        return Answer(True)

    def change(self, parameters: Mapping[str, Any], drives: str = '') -> Answer:
        """New parameters for the controllers named, then another one that drives: all or nothing.

        `drives` is '' where the same goes on driving.
        """
        before = {name: self._runners[name].parameters for name in parameters}
        taken: list[str] = []
        answer = Answer(True)
        for name, values in parameters.items():
            answer = self.configure(name, values)
            if not answer.ok:
                break
            taken.append(name)
        if answer.ok and drives:
            answer = self.swap(drives)
        if not answer.ok:
            for name in taken:
                self._runners[name].restore(before[name])
        return answer

    def swap(self, name: str) -> Answer:
        """Let another controller drive from the next tick on; if it can't, nothing changes.

        It is activated here, within the deadline, against the situation of the last tick and the
        present field; then the one before is deactivated, in half of that. Naming the controller
        that drives restarts it, after a fault too.
        """
        if name not in self._runners:
            known = ', '.join(self._runners)
            return Answer(False, f"no controller '{name}'; there are: {known}")
        before, after = self._runners[self._active], self._runners[name]
        if after is before:
            before.deactivate(self._deadline / 2)
        try:
            if self._last is not None:
                situation = dataclasses.replace(self._last, field=self._field.copy())
                after.activate(situation, self._deadline)
        except Exception as error:
            return Answer(False, f'{name}: {reason(error)}')
        if after is not before:
            before.deactivate(self._deadline / 2)
        self._active, self._fault = name, ''
        return Answer(True, f'{name} drives')

    def let_go(self) -> None:
        """No field flows any more: the next command starts from zero."""
        self._field = np.zeros(2)

    def reset(self) -> None:
        """Let go, and every controller forgets what it learned and did."""
        self.let_go()
        self._record.clear()
        for runner in self._runners.values():
            runner.renew()

    def tick(self, situation: Situation) -> Outcome:
        """The command of this tick, or None where poses are too old to give one.

        Particles without a finite position are left out before the controller looks.
        """
        fresh = abs(situation.age) <= self._stale_after
        if not fresh or situation.dt > self._stale_after:
            self.let_go()
            self._record.clear()
        if not fresh:
            return Outcome(None, Result.STALE, f'poses are {situation.age:.2f} s old')
        situation = _with_delay_of_model(_usable(situation))
        situation = dataclasses.replace(
            situation, field=self._field.copy(), record=self._record)
        self._last = situation = look_ahead(situation)
        command, result, message = self._ask(situation)
        field = _approach(self._field, command.field, situation)
        self._field = field
        self._record.note(situation.t + situation.delay, field, command.frequency)
        return Outcome(dataclasses.replace(command, field=field), result, message)

    def close(self) -> None:
        """Let the active controller go; nothing may be asked afterwards."""
        self._runners[self._active].deactivate(self._deadline)
        for runner in self._runners.values():
            runner.close()

    def _ask(self, situation: Situation) -> tuple[FieldCommand, Result, str]:
        """What the controller answers, or zero field with the reason why not that."""
        if self._fault:
            return no_field(self._fault), Result.FAULT, self._fault
        try:
            command = self._runners[self._active].compute(situation, self._deadline)
            command = _checked(command, situation.limits)
            if self._border > 0:
                command = kept_in_view(situation, command, self._border)
                command = _checked(command, situation.limits)
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


def _usable(situation: Situation) -> Situation:
    good = np.isfinite(situation.position).all(1)
    if good.all():
        return situation
    rows = {name: getattr(situation, name)[good] for name in PER_PARTICLE}
    return dataclasses.replace(situation, **rows)


def _with_delay_of_model(situation: Situation) -> Situation:
    """A delay that the model knows of adds to how long a command takes to act."""
    model = situation.model
    if model is None or not model.delay:
        return situation
    return dataclasses.replace(
        situation, delay=situation.delay + model.delay, model=model.without('command_delay'))


def _checked(command: FieldCommand, limits: Limits) -> FieldCommand:
    """The command with a field of its own, (2,); ValueError unless finite and within limits."""
    field = np.array(command.field, dtype=float).reshape(2)
    strength = float(np.hypot(*field))
    if not strength <= limits.field * (1 + 1e-9):
        raise ValueError(f'commanded {strength * 1e3:g} mT; the limit is {limits.field * 1e3:g}')
    if not 0 <= command.frequency <= limits.frequency:
        raise ValueError(f'commanded {command.frequency:g} Hz; expected 0 to {limits.frequency:g}')
    return dataclasses.replace(command, field=field, frequency=float(command.frequency))


def _approach(now: np.ndarray, wanted: np.ndarray, situation: Situation) -> np.ndarray:
    """The wanted field, or as far towards it as the slew lets one tick go.

    A clock that stands or runs backwards gives no time to change in: the field stays. Letting
    go needs none.
    """
    if not situation.dt > 0:
        return now if wanted.any() else wanted
    step = wanted - now
    length, longest = float(np.hypot(*step)), situation.limits.slew * min(
        situation.dt, LONGEST_STEP)
    return now + step if length <= longest else now + step * (longest / length)
