"""Third stage: what is known of the particles, goals, a joystick → the field."""

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

    controller: str = setting('hold', 'The controller that drives; see `~/controllers`.')
    max_field_mT: float = setting(5.0, 'Strongest field a controller may ask for.', lower=0.0,
                                  upper=100.0, read_only=True)
    slew_mT_per_s: float = setting(1000.0, 'Fastest change of the field.', lower=1.0, upper=1e6,
                                   read_only=True)
    max_frequency_hz: float = setting(100.0, 'Fastest rotation of a rolling field.', lower=0.0,
                                      upper=1000.0, read_only=True)
    pose_timeout_ms: float = setting(
        200.0, 'Age of the poses beyond which nothing is commanded.', lower=10.0, upper=5000.0,
        read_only=True)
    joy_timeout_ms: float = setting(
        250.0, 'Age of the joystick beyond which it counts as centred; its driver must repeat.',
        lower=20.0, upper=2000.0, read_only=True)
    deadline_ms: float = setting(10.0, 'How long a controller may think.', lower=1.0,
                                 upper=1000.0, read_only=True)
    workspace_um: list[float] = setting(
        [-140.0, -104.0, 140.0, 104.0], 'Left, bottom, right, top of where particles may go.',
        lower=-1e5, upper=1e5, read_only=True)
    border_s: float = setting(
        0.5, 'A driven particle that would be out of the workspace within this time turns the '
        'field; 0: never.', lower=0.0, upper=60.0, read_only=True)
    delay_ms: float = setting(
        25.0, 'From exposure until a command given now acts; 0 for none.', lower=0.0,
        upper=2000.0)
    model_file: str = setting('', 'model.yaml with the effects that controllers may use.')


AT_REST = 0.15
"""Deflection of a stick, of 1, up to which it is centred: as the dead zone of `teleop`."""


class ControllerStage:
    """The controller that drives, and what it is told beside the particles.

    `worker` makes what calls a controller within its deadline. Raises InputError where the
    controller that `parameters` name cannot be had.
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
        self.begin()

    def begin(self) -> None:
        """Nothing has been seen, said or commanded yet."""
        self.driving = False
        """Whether a field may flow by the last command."""
        self.outcome = Outcome(None, Result.STALE, 'no poses yet')
        """What came of the last frame."""
        self.armed: bool | None = None
        """Whether the coil driver is armed; None where there is none that says so."""
        self.forget()
        self.joystick_remark = ''
        """Why a joystick that was deflected counts as centred; '' where none does."""
        self._joystick, self._joystick_t = np.zeros(2), -math.inf
        self._held = False
        self._last_t = -math.inf
        self._model: tuple[str, Model | None] = ('', None)

    @property
    def unrepeatable(self) -> str:
        """Why the same inputs need not have the same answers; '' where they do."""
        name = self.manager.active
        return '' if self.classes[name].repeatable else f'{name} thinks for as long as it may'

    def configure(self, parameters: ControllerParameters, controllers: Mapping[str, Any],
                  restart: bool = False, seconds: float = CONFIGURING) -> SwitchResult:
        """Take new parameters, its own and those of the controllers named: all, or none and why.

        Within `seconds`, see `ControllerManager.change`. `restart` lets the controller that
        drives begin anew after a fault.
        """
        wanted = parameters.controller
        switch = wanted != self.manager.active or (restart and self.manager.fault)
        answer = self.manager.change(controllers, wanted if switch else '', seconds)
        if answer.ok:
            self.parameters = parameters
        return answer

    def forget(self) -> None:
        """No goals, no path and no plan any more."""
        self.goals, self.path = Goals(), np.empty((0, 2))
        self.plan: Commands | None = None

    def be_armed(self) -> None:
        """Start from zero: what is given from now on may drive.

        A stick that is deflected now counts as centred until it has been centred once.
        """
        self.armed = True
        self._held = bool(np.hypot(*self._joystick) > AT_REST)
        self.let_go()

    def be_disarmed(self) -> None:
        """Forget goals, path and plan that were being carried out: nothing resumes by itself.

        Those that came before the first word of the driver are kept.
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
        """Why the controller that drives is not given `what`, and which ones take it; '' where it
        takes it."""
        name = self.manager.active
        if self.classes[name].accepts(what):
            return ''
        others = [other for other, kind in self.classes.items() if kind.accepts(what)]
        return f'{name} takes no {what.value}; these do: {", ".join(others) or "none"}'

    def go_to(self, goals: Goals) -> None:
        """New goals, from the next frame on."""
        self.goals = goals
        self._begin_anew()

    def follow(self, path: np.ndarray) -> None:
        """A new path (P, 2) [m], from the next frame on."""
        self.path = path
        self._begin_anew()

    def play(self, plan: Commands) -> None:
        """A new plan on a clock of its own, from the next frame on, for a controller that plays.

        ValueError for one that can't be played: its numbers must be finite, its times ascend
        from 0, and its last row, the end, be after them.
        """
        turns = np.zeros(1) if plan.frequency is None else plan.frequency
        if not all(np.isfinite(rows).all() for rows in (plan.t, plan.field, turns)):
            raise ValueError('expected finite numbers')
        if len(plan.t) < 2 or plan.t[0] != 0 or not (np.diff(plan.t) > 0).all():
            raise ValueError('expected two rows at least, at times that ascend from 0')
        self.plan = plan
        self._begin_anew()

    def _begin_anew(self) -> None:
        """What came of the places before says nothing of these."""
        self.outcome = Outcome(None, Result.STALE, 'no poses since it was told where to go')

    def move_joystick(self, axes: np.ndarray, t: float) -> None:
        """The stick stands at `axes` (2,) at `t` [s]; what is not two finite numbers is centred.

        Raises ValueError for such.
        """
        self._joystick = np.zeros(2)
        if not (axes.shape == (2,) and np.isfinite(axes).all()):
            raise ValueError(f'expected two finite axes; received {axes.tolist()}: counted as '
                             'centred')
        self._joystick = axes / max(1.0, float(np.hypot(*axes)))
        self._joystick_t = t
        self._held = self._held and bool(np.hypot(*self._joystick) > AT_REST)

    def step(self, estimates: np.ndarray, t: float, now: float) -> Outcome:
        """The command after a frame that was exposed at `t` [s] and whose estimates (N,), of type
        ESTIMATE, came at `now` [s]; without a command the field is let go.
        """
        outcome = self.manager.tick(self._input(estimates, t, now))
        if self.joystick_remark:
            said = '; '.join(filter(None, [outcome.message, self.joystick_remark]))
            outcome = dataclasses.replace(outcome, message=said)
        self.outcome = outcome
        self.driving = outcome.command is not None or self.driving
        return self.outcome

    def expire(self, now: float) -> bool:
        """Let go where poses that came once stay away at `now` [s], and say for how long they do;
        whether a field may have flown until now.
        """
        age = now - self._last_t
        if math.isinf(age) or abs(age) <= self.parameters.pose_timeout_ms * 1e-3:
            return False
        drove = self.let_go()
        if not self.manager.fault:
            self.outcome = Outcome(None, Result.STALE, f'poses are {age:.2f} s old')
        return drove

    def let_go(self) -> bool:
        """No field is to flow, and the next command starts from there; whether one may have flown.
        """
        self.manager.let_go()
        drove, self.driving = self.driving, False
        if drove and self.outcome.result is Result.OK:
            self.outcome = Outcome(None, Result.STALE, 'no poses since the field was let go')
        return drove

    def _input(self, estimates: np.ndarray, t: float, now: float) -> ControllerInput:
        """All at the moment of exposure: the same poses give the same command, live or replayed.

        When they arrive decides only whether they are too old for any. Time goes by from the
        newest: frames that overtake each other give none, unless the clock was set back.
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
        """The stick (2,) at an exposure `t` [s]: centred where it was silent for too long.

        A frame may be exposed before the stick moved, but no longer than poses may be old.
        """
        values, age = self.parameters, t - self._joystick_t
        self.joystick_remark = ''
        if age > values.joy_timeout_ms * 1e-3:
            self._held = False  # a stick that is silent counts as centred
        if self._held:
            self.joystick_remark = 'the joystick was deflected at arming: centre it'
            return np.zeros(2)
        fresh = -values.pose_timeout_ms * 1e-3 <= age <= values.joy_timeout_ms * 1e-3
        if fresh or not self._joystick.any():
            return self._joystick
        since = (f'has been silent for {age:.2f} s' if age > 0 else
                 f'is stamped {-age:.2f} s after the frame')
        self.joystick_remark = f'the joystick {since}: counted as centred'
        return np.zeros(2)

    def _present_model(self) -> Model | None:
        file = self.parameters.model_file
        if file != self._model[0]:
            self._model = (file, read_model(file)[0] if file else None)
        return self._model[1]


@cache
def _warm_up() -> None:
    """Compile what the first ticks would otherwise wait for."""
    manager, one = ControllerManager({'it': Waypoint()}, 'it', deadline=60.0), np.ones(1)
    workspace = Workspace(np.full(2, -1e-4), np.full(2, 1e-4))
    goals = Goals(np.zeros((1, 2)))
    for k in range(3):
        manager.tick(ControllerInput(
            0.01 * k, 0.01, 0.0, np.zeros(1, int), np.full((1, 2), 1e-6), 1e-8 * one, one,
            1e-6 * one, one, 1e-8 * one, 1e-2 * one, Limits(), workspace, goals=goals))
    manager.close()
