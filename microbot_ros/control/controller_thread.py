"""One controller and the thread it runs in."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import Any

from microbot_ros.control.contract import (
    Controller,
    ControllerError,
    ControllerInput,
    FieldCommand,
)
from microbot_ros.control.deadline_worker import (
    BusyError,
    Call,
    DeadlineWorker,
    HungError,
    LateError,
)

CONFIGURING = 30.0
"""How long [s] taking new parameters may last: files are read and code is compiled meanwhile."""

AGAIN = 'set it again'
"""How the refusal of parameters ends that are not taken yet; asked again they will be."""


class ConfiguringError(LateError):
    """Parameters are being taken aside, and are not there yet."""

_log = logging.getLogger(__name__)


class ControllerThread:
    """Calls a controller, in order and each with a deadline, from a thread of its own.

    `name` is for messages; `worker` makes, from the patience, what makes the calls. A call that
    does not return in `patience` [s] is left behind, and the controller is replaced by a fresh one
    with the same parameters.
    """

    def __init__(self, name: str, controller: Controller, patience: float,
                 worker: Callable[[float], DeadlineWorker] = DeadlineWorker) -> None:
        self._name = name
        self._controller = controller
        self._parameters = controller.parameters
        self._worker = worker(patience)
        self._configured: Call | None = None
        self._aside = worker(patience)
        self._prepared: tuple[Any, Controller, Call] | None = None
        """Parameters, a controller that takes them aside, and the call in which it does."""
        self._active = False

    @property
    def parameters(self) -> Any:
        """What it was configured with."""
        return self._parameters

    def prepare(self, parameters: Any, seconds: float) -> None:
        """Have a fresh controller configured with `parameters`, in a thread beside that of ticks.

        Returns once it is; ConfiguringError where that takes more than `seconds`: it goes on, and
        to prepare the same again finds it. Raises what `configure` raises.
        """
        if self._prepared is None or self._prepared[0] != parameters:
            self._aside.leave_behind()
            fresh = type(self._controller)()
            self._prepared = parameters, fresh, self._aside.post(
                lambda: fresh.configure(parameters))
        _, fresh, call = self._prepared
        if not self._aside.finished(call, seconds):
            if time.monotonic() - call.begun <= CONFIGURING:
                raise ConfiguringError(f'is still being configured, aside: {AGAIN}')
            self._drop_prepared()
            raise LateError(f'took longer than {CONFIGURING:g} s')
        if call.error is not None:
            self._drop_prepared()
            raise call.error if isinstance(call.error, Exception) else RuntimeError(
                f'raised {type(call.error).__name__}')

    def _drop_prepared(self) -> None:
        self._aside.leave_behind()
        self._prepared = None

    def configure(self, parameters: Any, seconds: float = CONFIGURING) -> None:
        """Give it other parameters, within `seconds`; if it raises, it keeps those it has.

        They are taken by a fresh controller first (`prepare`), so that neither what is refused
        nor what takes long touches the one that may drive. That one takes them then; where it
        is late, the fresh one takes its place.
        """
        self.prepare(parameters, seconds)
        assert self._prepared is not None
        fresh, controller = self._prepared[1], self._controller
        self._drop_prepared()
        try:
            self._call(lambda: controller.configure(parameters), seconds)
        except BusyError:
            raise
        except LateError:
            self.close()
            self._controller = fresh
        except Exception:
            controller.parameters = self._parameters
            raise
        self._parameters, self._configured = parameters, None

    def restore(self, parameters: Any, seconds: float = CONFIGURING) -> None:
        """Give back parameters that it had, within `seconds`. If it can't, it does not drive
        before it has them."""
        try:
            self.configure(parameters, seconds)
        except Exception:
            self._parameters = parameters
            self.renew()

    def activate(self, inputs: ControllerInput, deadline: float) -> None:
        """Let it get ready for `inputs`. Where that is late it is replaced: what it did is not
        known.
        """
        controller, configured = self._controller, self._configured

        def run() -> None:
            if configured is not None and configured.error is not None:
                raise configured.error
            controller.activate(inputs)

        self._call(run, deadline, replace_late=True)
        self._active = True

    def compute(self, inputs: ControllerInput, deadline: float) -> FieldCommand:
        """Its command for `inputs`, within `deadline` [s]; where need be activated, in half of
        that.
        """
        if not self._active:
            deadline /= 2
            self.activate(inputs, deadline)
        controller = self._controller
        command: FieldCommand = self._call(lambda: controller.compute(inputs), deadline)
        return command

    def deactivate(self, deadline: float) -> None:
        """Let it go. One that still works on its last tick is replaced."""
        if not self._active:
            return
        self._active = False
        try:
            self._call(self._controller.deactivate, deadline, replace_late=True)
        except Exception as error:
            _log.warning('%s: deactivating: %s', self._name, reason(error))

    def renew(self) -> None:
        """A fresh controller in place of one whose state can't be trusted or is to be forgotten.

        What was configured stays; a call that still runs works on the old one.
        """
        self.close()
        fresh = self._controller = type(self._controller)()
        parameters = self._parameters
        # Nobody waits: it may read a file, which takes longer than a tick.
        self._configured = self._worker.post(lambda: fresh.configure(parameters))

    def close(self) -> None:
        """Let its thread go."""
        self._worker.leave_behind()
        self._active = False

    def _call(self, function: Callable[[], Any], deadline: float, *,
              replace_late: bool = False) -> Any:
        try:
            return self._worker.call(function, deadline)
        except (LateError, HungError) as error:
            if replace_late or isinstance(error, HungError):
                self.renew()
            raise


def reason(error: Exception) -> str:
    """The `error` in words for people."""
    named = isinstance(error, ControllerError | LateError | HungError | ValueError)
    return str(error) if named else f'{type(error).__name__}: {error}'
