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
"""Choice: time limit of `configure` [s], in which files are read and code is compiled."""

AGAIN = 'set it again'
"""End of the refusal of parameters that are still being configured; a repetition succeeds."""


class ConfiguringError(LateError):
    """Parameters are still being configured in the background."""

_log = logging.getLogger(__name__)


class ControllerThread:
    """Calls a controller from its own thread, in order and each call with a deadline.

    A call that does not return within `patience` [s] is abandoned, and a fresh controller with the
    same parameters replaces the old one.

    Parameters
    ----------
    name : str
        Name in messages.
    controller : Controller
        Controller that is called.
    patience : float [s]
        Time after which a call is abandoned.
    worker : callable
        Makes the worker that calls the controller from the patience.
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
        """Parameters, the controller that is configured with them, and the call doing so."""
        self._active = False

    @property
    def parameters(self) -> Any:
        """Parameters that it was configured with."""
        return self._parameters

    def prepare(self, parameters: Any, seconds: float) -> None:
        """Configure a fresh controller with `parameters` in a background thread.

        Returns when it is ready. Raises ConfiguringError if that takes more than `seconds`: it
        continues, and preparing the same parameters again finds it. Raises what `configure`
        raises.

        Parameters
        ----------
        parameters : object
            Parameters of the controller.
        seconds : float
            Longest time to wait [s]; configuring continues in the background after it.
        """
        if self._prepared is None or self._prepared[0] != parameters:
            self._aside.leave_behind()
            fresh = type(self._controller)()
            self._prepared = parameters, fresh, self._aside.post(
                lambda: fresh.configure(parameters))
        _, fresh, call = self._prepared
        if not call.returned.wait(seconds):
            if time.monotonic() - call.begun <= CONFIGURING:
                raise ConfiguringError(f'is still being configured in the background: {AGAIN}')
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
        """Set other parameters, within `seconds`; if that raises, the old ones are kept.

        A fresh controller takes them first (`prepare`), so that neither refused nor slow
        parameters affect the one that may be driving, which takes them afterwards. If it is late,
        the fresh one replaces it.

        Parameters
        ----------
        parameters : object
            Parameters of the controller.
        seconds : float
            Longest time to wait for the controller [s].
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
        if not self._active:
            self._worker.leave_behind()  # a controller that does not drive needs no thread

    def restore(self, parameters: Any, seconds: float = CONFIGURING) -> None:
        """Set parameters that it had before, within `seconds`.

        If that fails, it does not drive before it has them.

        Parameters
        ----------
        parameters : object
            Parameters of the controller.
        seconds : float
            Longest time to wait for the controller [s].
        """
        try:
            self.configure(parameters, seconds)
        except Exception:
            self._parameters = parameters
            self.renew()

    def activate(self, inputs: ControllerInput, deadline: float) -> None:
        """Activate it with `inputs` within `deadline` [s]; a late one is replaced.

        Parameters
        ----------
        inputs : ControllerInput
            Input of the tick.
        deadline : float
            Time [s] after which the controller is late and is replaced.
        """
        controller, configured = self._controller, self._configured

        def run() -> None:
            if configured is not None and configured.error is not None:
                raise configured.error
            controller.activate(inputs)

        self._call(run, deadline, replace_late=True)
        self._active = True

    def compute(self, inputs: ControllerInput, deadline: float) -> FieldCommand:
        """Return its command for `inputs` within `deadline` [s].

        If it must be activated first, half of that time is for the activation.

        Parameters
        ----------
        inputs : ControllerInput
            Input of the tick.
        deadline : float
            Time [s] for the command, activation included, after which LateError is raised.

        Returns
        -------
        FieldCommand
            The command.
        """
        if not self._active:
            deadline /= 2
            self.activate(inputs, deadline)
        controller = self._controller
        command: FieldCommand = self._call(lambda: controller.compute(inputs), deadline)
        return command

    def deactivate(self, deadline: float) -> None:
        """Deactivate it within `deadline` [s]; if it is still busy, a fresh one replaces it.

        Parameters
        ----------
        deadline : float
            Time [s] after which a busy controller is replaced.
        """
        if not self._active:
            return
        self._active = False
        try:
            self._call(self._controller.deactivate, deadline, replace_late=True)
            self._worker.leave_behind()
        except Exception as error:
            _log.warning('%s: deactivating: %s', self._name, reason(error))

    def renew(self) -> None:
        """Replace the controller by a fresh one, if its state is unreliable or to be forgotten.

        The parameters stay; a running call continues on the old one.
        """
        self.close()
        fresh = self._controller = type(self._controller)()
        parameters = self._parameters
        # Not waited for: it may read a file, which takes longer than a tick.
        self._configured = self._worker.post(lambda: fresh.configure(parameters))

    def close(self) -> None:
        """Release its thread."""
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
    """Return a message for an `error`.

    Parameters
    ----------
    error : Exception
        The error.

    Returns
    -------
    str
        The message.
    """
    named = isinstance(error, ControllerError | LateError | HungError | ValueError)
    return str(error) if named else f'{type(error).__name__}: {error}'
