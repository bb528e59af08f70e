"""Third stage: from estimates, goals and a joystick to the field."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from microbot_ros.common.errors import InputError
from microbot_ros.common.records import Commands
from microbot_ros.common.settings import setting
from microbot_ros.control.contract import (
    ControllerInput,
    Goals,
    Input,
    Limits,
    Result,
    Workspace,
)
from microbot_ros.control.controller_thread import CONFIGURING
from microbot_ros.control.deadline_worker import DeadlineWorker
from microbot_ros.control.manager import ControllerManager, Outcome, SwitchResult
from microbot_ros.control.plugins.waypoint import Waypoint
from microbot_ros.control.registry import PluginError, controller_classes
from microbot_ros.loop.points import numbers
from microbot_ros.model.io.model_file import read_model
from microbot_ros.model.model import Model


@dataclass(frozen=True)
class ControllerParameters:
    """Parameters of the controller manager; each controller has its own under its name."""

    controller: str = setting('hold', 'The active controller; see `~/controllers`.')
    max_field_mT: float = setting(5.0, 'Largest field that a controller may command.', lower=0.0,
                                  upper=100.0, read_only=True)
    slew_mT_per_s: float = setting(1000.0, 'Largest rate of change of the field.', lower=1.0,
                                   upper=1e6, read_only=True)
    max_frequency_hz: float = setting(100.0, 'Highest frequency of a rotating field.', lower=0.0,
                                      upper=1000.0, read_only=True)
    pose_timeout_ms: float = setting(
        200.0, 'Age of the poses beyond which nothing is commanded.', lower=10.0, upper=5000.0,
        read_only=True)
    joy_timeout_ms: float = setting(
        250.0, 'Age of the joystick message beyond which the stick is '
               'treated as centred; the joystick driver must repeat '
               'messages.', lower=20.0, upper=2000.0, read_only=True)
    deadline_ms: float = setting(10.0, 'Computing time of a controller per frame.', lower=1.0,
                                 upper=1000.0, read_only=True)
    workspace_um: list[float] = setting(
        [-140.0, -104.0, 140.0, 104.0], 'Left, bottom, right and top of the workspace.',
        lower=-1e5, upper=1e5, read_only=True)
    border_s: float = setting(
        0.5, 'If a driven particle would leave the workspace within this time, the field is '
             'turned; 0 disables this.', lower=0.0, upper=60.0, read_only=True)
    delay_ms: float = setting(
        25.0, 'Delay from exposure to the effect of the command computed from it; 0 if there is '
              'none.',
        lower=0.0, upper=2000.0)
    model_file: str = setting('', 'File model.yaml with the effects that controllers may use.')


AT_REST = 0.15
"""Choice: deflection of a stick (0 to 1) up to which it is centred, the dead zone of `teleop`."""


class ControllerStage:
    """The active controller and its inputs besides the particles.

    `worker` makes the object that calls a controller within its deadline. Raises InputError if the
    controller named in `parameters` is not available.

    Parameters
    ----------
    parameters : ControllerParameters
        Parameters of the manager.
    worker : callable
        Function that makes, from a patience [s], the worker that calls controllers.
    """

    def __init__(self, parameters: ControllerParameters,
                 worker: Callable[[float], DeadlineWorker] = DeadlineWorker) -> None:
        self.parameters = parameters
        self._limits = Limits(parameters.max_field_mT * 1e-3, parameters.slew_mT_per_s * 1e-3,
                              parameters.max_frequency_hz)
        self._workspace = Workspace(np.array(parameters.workspace_um[:2]) * 1e-6,
                                    np.array(parameters.workspace_um[2:]) * 1e-6)
        try:
            self.classes = controller_classes(required=parameters.controller)
        except PluginError as error:
            raise InputError('controller', str(error)) from None
        self.manager = ControllerManager(
            {name: kind() for name, kind in self.classes.items()},
            active=parameters.controller, deadline=parameters.deadline_ms * 1e-3,
            pose_timeout=parameters.pose_timeout_ms * 1e-3, border=parameters.border_s,
            worker=worker)
        _warm_up()
        self._at_rest = AT_REST
        self.begin()

    def begin(self) -> None:
        """Reset everything seen, received and commanded."""
        self.driving = False
        """Whether the last command may make a field."""
        self.outcome = Outcome(None, Result.STALE, 'no poses yet')
        """Outcome of the last frame."""
        self.armed: bool | None = None
        """Whether the coil driver is armed; None if no driver reports it."""
        self.forget()
        self.joystick_remark = ''
        """Why a deflected joystick counts as centred; '' if it does not."""
        self._joystick, self._joystick_t = np.zeros(2), -math.inf
        self._held = False
        self._last_t = -math.inf
        self._model: tuple[str, Model | None] = ('', None)

    @property
    def unrepeatable(self) -> str:
        """Why equal inputs may give different results; '' if they do not."""
        name = self.manager.active
        return '' if self.classes[name].repeatable else f'{name} uses its whole computing time'

    def configure(self, parameters: ControllerParameters, controllers: Mapping[str, Any],
                  restart: bool = False, seconds: float = CONFIGURING) -> SwitchResult:
        """Apply new parameters, either all of them or none.

        Parameters
        ----------
        parameters : ControllerParameters
            New parameters of the controller manager.
        controllers : mapping
            Parameters of controllers, by the name of the controller.
        restart : bool
            Whether the active controller restarts after a fault.
        seconds : float
            Time limit [s], see `ControllerManager.change`.

        Returns
        -------
        SwitchResult
            With the reason if nothing was changed.
        """
        wanted = parameters.controller
        switch = wanted != self.manager.active or (restart and self.manager.fault)
        answer = self.manager.change(controllers, wanted if switch else '', seconds)
        if answer.ok:
            self.parameters = parameters
            if 'teleop' in controllers:
                self._at_rest = min(AT_REST, controllers['teleop'].dead_zone)
        return answer

    def forget(self) -> None:
        """Clear goals, path and plan."""
        self.goals, self.path = Goals(), np.empty((0, 2))
        self.plan: Commands | None = None

    def be_armed(self) -> None:
        """Record that the driver is armed, and start from zero field.

        A stick that is deflected now counts as centred until it has been centred once.
        """
        self.armed = True
        self._held = bool(np.hypot(*self._joystick) > self._at_rest)
        self.let_go()

    def be_disarmed(self) -> None:
        """Record that the driver is disarmed, and clear goals, path and plan.

        Nothing resumes by itself. Goals received before the driver's first message are kept.
        """
        if self.armed:
            self.forget()
            self._begin_anew()
        self.armed = False

    @property
    def waits(self) -> bool:
        """Whether goals, a path or a plan wait for the coil driver to be armed."""
        given = len(self.goals) or len(self.path) or self.plan is not None
        return self.armed is False and bool(given)

    def refusal(self, what: Input) -> str:
        """Return why the active controller refuses the input `what`; '' if it does not.

        Parameters
        ----------
        what : Input
            The input.

        Returns
        -------
        str
            Reason, or ''.
        """
        name = self.manager.active
        if self.classes[name].accepts(what):
            return ''
        others = [other for other, kind in self.classes.items() if kind.accepts(what)]
        return f'{name} takes no {what.value}; controllers that do: {", ".join(others) or "none"}'

    def go_to(self, goals: Goals) -> None:
        """Set new `goals`, from the next frame on.

        Parameters
        ----------
        goals : Goals
            The goals.
        """
        self.goals = goals
        self._begin_anew()

    def follow(self, path: np.ndarray) -> None:
        """Set a new `path` (P, 2) [m], from the next frame on.

        Parameters
        ----------
        path : ndarray, shape (P, 2)
            Points of the path [m].
        """
        self.path = path
        self._begin_anew()

    def play(self, plan: Commands) -> None:
        """Set a new `plan`, from the next frame on, for a controller that plays one.

        Its times are relative and ascend from 0; its last row is the end. Raises ValueError for
        anything else and for numbers that are not finite.

        Parameters
        ----------
        plan : Commands
            The plan.
        """
        turns = np.zeros(1) if plan.frequency is None else plan.frequency
        if not all(np.isfinite(rows).all() for rows in (plan.t, plan.field, turns)):
            raise ValueError('expected finite numbers')
        if len(plan.t) < 2 or plan.t[0] != 0 or not (np.diff(plan.t) > 0).all():
            raise ValueError('expected two rows at least, at times that ascend from 0')
        self.plan = plan
        self._begin_anew()

    def _begin_anew(self) -> None:
        """Drop the outcome: the last command belongs to earlier goals."""
        self.outcome = Outcome(None, Result.STALE, 'no poses since the goals arrived')

    def move_joystick(self, axes: np.ndarray, t: float) -> None:
        """Set the stick to `axes` (2,) at time `t` [s].

        Raises ValueError, and centres the stick, if `axes` are not two finite numbers.

        Parameters
        ----------
        axes : ndarray, shape (2,)
            Position from −1 to 1.
        t : float
            Time of the position [s].
        """
        self._joystick = np.zeros(2)
        if not (axes.shape == (2,) and np.isfinite(axes).all()):
            raise ValueError(f'expected two finite axes; received {axes.tolist()}: treated as '
                             'centred')
        self._joystick = axes / max(1.0, float(np.hypot(*axes)))
        self._joystick_t = t
        self._held = self._held and bool(np.hypot(*self._joystick) > self._at_rest)

    def step(self, estimates: np.ndarray, t: float, now: float) -> Outcome:
        """Return the command for a frame; without a command the field is released.

        Parameters
        ----------
        estimates : (N,) array of ESTIMATE
            Estimated state of each particle in the frame.
        t : float
            Exposure of the frame [s].
        now : float
            Arrival of the estimates [s].

        Returns
        -------
        Outcome
            The command, or why there is none.
        """
        outcome = self.manager.tick(self._input(estimates, t, now))
        if self.joystick_remark:
            said = '; '.join(filter(None, [outcome.message, self.joystick_remark]))
            outcome = dataclasses.replace(outcome, message=said)
        self.outcome = outcome
        self.driving = outcome.command is not None or self.driving
        return self.outcome

    def expire(self, now: float) -> bool:
        """Release the field if poses, once received, stay away at `now` [s].

        Returns whether a field may have been on until now.

        Parameters
        ----------
        now : float
            Present time [s].

        Returns
        -------
        bool
            Whether a field may have been on until now.
        """
        age = now - self._last_t
        if math.isinf(age) or abs(age) <= self.parameters.pose_timeout_ms * 1e-3:
            return False
        drove = self.let_go()
        if not self.manager.fault:
            self.outcome = Outcome(None, Result.STALE, f'poses are {age:.2f} s old')
        return drove

    def let_go(self) -> bool:
        """Switch the field off and let the next command start from zero.

        Returns whether a field may have been on.

        Returns
        -------
        bool
            Whether a field may have been on.
        """
        self.manager.let_go()
        drove, self.driving = self.driving, False
        if drove and self.outcome.result is Result.OK:
            self.outcome = Outcome(None, Result.STALE, 'no poses since the field was set to zero')
        return drove

    def _input(self, estimates: np.ndarray, t: float, now: float) -> ControllerInput:
        """Return the controller's input, all at the time of exposure.

        The same poses thus give the same command, live or replayed. Their arrival only decides
        whether they are too old. Frames that overtake each other do not advance time, unless the
        clock was set back.
        """
        values = self.parameters
        timeout = values.pose_timeout_ms * 1e-3
        dt = t - self._last_t
        if not -timeout <= dt <= 0:
            self._last_t = t
        age = now - t
        rows = numbers(estimates)
        _, _, speed, phi, _, x_std, _, speed_std, phi_std, *_, theta = rows
        unknown = ~np.isfinite(speed_std)
        speed_std[unknown] = phi_std[unknown] = math.inf
        return ControllerInput(
            t=t, dt=dt if math.isfinite(dt) else 0.0, age=0.0 if abs(age) <= timeout else age,
            ids=estimates['id'].astype(int),
            position=rows[:2].T.copy(), sigma=x_std, theta=theta, speed=speed, phi=phi,
            speed_std=speed_std, phi_std=phi_std, limits=self._limits, workspace=self._workspace,
            delay=values.delay_ms * 1e-3, goals=self.goals, path=self.path,
            joystick=self._joystick_at(t), model=self._present_model(),
            plan=None if self.armed is False else self.plan)

    def _joystick_at(self, t: float) -> np.ndarray:
        """Return the stick (2,) at an exposure `t` [s]: centred after too long a silence.

        A frame may be exposed before the stick moved, but by no more than the pose timeout.
        """
        values, age = self.parameters, t - self._joystick_t
        self.joystick_remark = ''
        if age > values.joy_timeout_ms * 1e-3:
            self._held = False  # a silent stick counts as centred
        if self._held:
            self.joystick_remark = 'the joystick was not centred at arming: centre it'
            return np.zeros(2)
        fresh = -values.pose_timeout_ms * 1e-3 <= age <= values.joy_timeout_ms * 1e-3
        if fresh or not self._joystick.any():
            return self._joystick
        since = (f'sent no message for {age:.2f} s' if age > 0 else
                 f'is stamped {-age:.2f} s after the frame')
        self.joystick_remark = f'the joystick {since}: treated as centred'
        return np.zeros(2)

    def _present_model(self) -> Model | None:
        file = self.parameters.model_file
        if file != self._model[0]:
            self._model = (file, read_model(file)[0] if file else None)
        return self._model[1]


@cache
def _warm_up() -> None:
    """Compile the code that the first frames would otherwise wait for."""
    manager, one = ControllerManager({'it': Waypoint()}, 'it', deadline=60.0), np.ones(1)
    workspace = Workspace(np.full(2, -1e-4), np.full(2, 1e-4))
    goals = Goals(np.zeros((1, 2)))
    for k in range(3):
        manager.tick(ControllerInput(
            0.01 * k, 0.01, 0.0, np.zeros(1, int), np.full((1, 2), 1e-6), 1e-8 * one, one,
            1e-6 * one, one, 1e-8 * one, 1e-2 * one, Limits(), workspace, goals=goals))
    manager.close()
