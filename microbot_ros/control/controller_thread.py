"""One controller and the thread it runs in."""

from __future__ import annotations

import logging
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
        self._active = False

    @property
    def parameters(self) -> Any:
        """What it was configured with."""
        return self._parameters

    def configure(self, parameters: Any) -> None:
        """Give it other parameters; if it raises, it keeps those it has.

        Where that is late it is replaced: it may take them after all, when nobody waits.
        """
        controller = self._controller
        try:
            self._call(lambda: controller.configure(parameters), CONFIGURING)
        except BusyError:
            raise
        except LateError:
            self.renew()
            raise
        except Exception:
            controller.parameters = self._parameters
            raise
        self._parameters, self._configured = parameters, None

    def restore(self, parameters: Any) -> None:
        """Give back parameters that it had. If it can't, it does not drive before it has them."""
        try:
            self.configure(parameters)
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
