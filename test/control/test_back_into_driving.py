"""Whatever interrupts the driving, the next command starts from the field that flows."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from microbot_ros.control.contract import (
    Controller,
    FieldCommand,
    Goals,
    Limits,
    ParticleLostError,
    Result,
    no_field,
)
from microbot_ros.control.deadline_worker import UnhurriedWorker
from microbot_ros.control.manager import LONGEST_STEP, ControllerManager
from microbot_ros.control.plugins.hold import Hold
from microbot_ros.control.plugins.teleop import TeleopParameters
from microbot_ros.control.plugins.waypoint import Waypoint
from microbot_ros.control.steering.border import kept_in_view
from microbot_ros.control.testkit import controller_input
from microbot_ros.loop.controller import ControllerParameters, ControllerStage
from microbot_ros.loop.points import ESTIMATE
from microbot_ros.model.effects.field.background_field import BackgroundField
from microbot_ros.model.model import Model

STALE = 0.2
FULL = 5e-3
ODD = [0.0, -0.0, np.nan, np.inf, -np.inf, -1.0, 1e9, -1e9, 1e-300]


class East(Controller):
    """Full field one way."""

    interface_version = 1
    summary = 'One way.'
    way = (1, 0)

    def compute(self, inputs):
        return FieldCommand(FULL * np.array(self.way))


class South(East):
    way = (0, -1)


class Moody(Controller):
    """Does what the test wants of its class: returns it, or raises it."""

    interface_version = 1
    summary = 'Moody.'
    mood: object = None

    def compute(self, inputs):
        if isinstance(self.mood, BaseException):
            raise self.mood
        return self.mood


class Refuses(Hold):
    """Never takes over."""

    def activate(self, inputs):
        raise ParticleLostError('none is seen')


MOODS = [
    no_field(''), ParticleLostError('gone'), ZeroDivisionError(), None, FieldCommand(np.ones(2)),
    *(FieldCommand(np.array([bad, 0.0])) for bad in (np.nan, np.inf, -np.inf)),
    *(FieldCommand(np.zeros(2), bad) for bad in (np.nan, np.inf, -np.inf, -1.0)),
    FieldCommand(np.zeros((2, 1))), FieldCommand([0.0, FULL]), FieldCommand(np.zeros(3)),
]


class Rig:
    """A controller manager, and what whoever drives the coils last gave them, or zero."""

    def __init__(self, slew: float) -> None:
        self.limits = Limits(field=FULL, slew=slew)
        self.manager = ControllerManager(
            {'hold': Hold(), 'east': East(), 'south': South(), 'moody': Moody(),
             'refuses': Refuses(), 'waypoint': Waypoint()},
            'hold', deadline=10.0, pose_timeout=STALE)
        self.flowing = np.zeros(2)
        self.t = 0.0

    def drive(self, name: str) -> None:
        """A few ticks in which all is well."""
        assert self.manager.switch_controller(name).ok
        for _ in range(3):
            self.tick(0.05)
        if self.limits.slew:
            assert self.flowing.any()

    def interrupt(self, way: str) -> None:
        """What may come in between, by name."""
        if way in ('let go', 'reset'):  # deactivated, an exception, no frames; cleaned up
            (self.manager.reset if way == 'reset' else self.manager.let_go)()
            self.flowing = np.zeros(2)
        elif way == 'stale':
            self.tick(0.01, age=0.3)
        elif way == 'lost':
            self.tick(0.01, lost=True)
        elif way == 'restart':
            self.manager.switch_controller(self.manager.active)
        else:
            self.manager.switch_controller(way)

    def tick(self, dt: float, age: float = 0.01, lost: bool = False, speed: float = 4e-6) -> None:
        """One frame, and whether what it gave may be given to the coils."""
        self.t += dt if abs(dt) < 1e6 else 0.0
        outcome = self.manager.tick(controller_input(
            2, t=self.t, dt=dt, age=age, limits=self.limits, speed=np.full(2, speed),
            goals=Goals(np.array([[20e-6, 0.0]])),
            position=np.full((2, 2), np.nan if lost else 1.4399e-4)))
        if dt > STALE or not abs(age) <= STALE:
            self.flowing = np.zeros(2)  # every dead-man has struck
        if not abs(age) <= STALE:
            assert (outcome.command, outcome.result) == (None, Result.STALE)
            return
        assert outcome.command is not None
        self.judge(outcome.command, dt, lets_go=(
            self.manager.active == 'hold' or outcome.result is not Result.OK))

    def judge(self, command: FieldCommand, dt: float, lets_go: bool) -> None:
        """Within the limits, and from the field that flows, no faster than the slew."""
        before, field = self.flowing, command.field
        assert np.hypot(*field) <= FULL * (1 + 1e-9)
        assert 0 <= command.frequency <= self.limits.frequency
        step = self.limits.slew * min(dt, LONGEST_STEP) if dt > 0 else 0.0
        change = np.hypot(*(field - before))
        if dt > 0 or field.any():
            assert change <= step * (1 + 1e-9) + 1e-15, (before, field, dt)
        if lets_go:
            left = max(np.hypot(*before) - step, 0.0) if dt > 0 else 0.0
            assert np.hypot(*field) == pytest.approx(left, rel=1e-9, abs=1e-15)
        self.flowing = field


WAYS = ['let go', 'reset', 'stale', 'lost', 'restart', 'hold', 'east', 'south', 'moody',
        'refuses', 'waypoint']
TICK = st.fixed_dictionaries({
    'dt': st.sampled_from([0.01, 0.1, 0.15, STALE, *ODD]),
    'age': st.sampled_from([0.01, 0.01, 0.01, STALE, 0.21, *ODD]),
    'lost': st.sampled_from([False, False, True]),
    'speed': st.sampled_from([4e-6, 4e-6, 4e-6, *ODD])})


@settings(max_examples=150)
@given(slew=st.sampled_from([0.0, 0.005, 0.1, 10.0]), mood=st.sampled_from(MOODS),
       spells=st.lists(st.tuples(
           st.sampled_from(['east', 'south']), st.sampled_from(WAYS), st.lists(TICK, max_size=4)),
           min_size=1, max_size=5))
def test_every_way_back_starts_from_the_field_that_flows(slew, mood, spells):
    Moody.mood = mood
    rig = Rig(slew)
    for name, way, ticks in spells:
        rig.drive(name)
        rig.interrupt(way)
        for tick in ticks:
            rig.tick(**tick)


class NoNumberAside(BackgroundField):
    """An effect of somebody's own that knows no field off the x axis."""

    bad = np.nan

    def field(self, B):
        return B if B[1] == 0 else B * self.bad


@pytest.mark.filterwarnings('ignore::RuntimeWarning')  # on a rig they stop nothing
@pytest.mark.parametrize('bad', [np.nan, np.inf, -np.inf])
def test_what_the_border_makes_of_a_field_is_checked_too(bad, monkeypatch):
    """The controller's command was finite; what the border turned it into was not."""
    monkeypatch.setattr(NoNumberAside, 'bad', bad)
    manager = ControllerManager({'east': East()}, 'east', deadline=10.0)
    edge = {'position': np.array([[1.4399e-4, 0.0]]), 'phi': np.zeros(1),
            'speed': np.full(1, 4e-6)}
    for tick in range(3):
        outcome = manager.tick(controller_input(
            1, t=tick / 60, model=Model(5e-3, effects=(NoNumberAside(0.0, 0.0),)), **edge))
        assert outcome.result is Result.FAULT
        assert not outcome.command.field.any()
    assert manager.fault == 'east: commanded nan mT; the limit is 5 mT'


@pytest.mark.parametrize('name', ['speed', 'expected', 'phi', 'speed_std', 'phi_std'])
@pytest.mark.parametrize('bad', [np.nan, np.inf, -np.inf])
def test_who_is_no_number_does_not_count_at_the_border(name, bad):
    shown = controller_input(2, **{name: np.full((2, 2) if name == 'expected' else 2, bad)})
    if name.endswith('_std'):
        shown = dataclasses.replace(shown, phi=np.full(2, bad))
    command = FieldCommand(np.array([3e-3, -4e-3]))
    assert kept_in_view(shown, command, 60.0) is command


@pytest.mark.parametrize('bad', [np.nan, np.inf, -np.inf, -1.0])
@pytest.mark.parametrize('name', ['field', 'slew', 'frequency'])
def test_a_limit_that_limits_nothing_is_refused(name, bad):
    with pytest.raises(ValueError, match=f'{name} must be finite and 0 or more'):
        Limits(**{name: bad})


@pytest.mark.parametrize(('deflected', 'still'), [(0.14, 0.0), (0.0, FULL)])
def test_a_stick_that_steers_when_the_rig_is_armed_must_be_centred(deflected, still):
    """Also where its dead zone is smaller than what usually counts as centred."""
    stage = ControllerStage(ControllerParameters(controller='teleop'), UnhurriedWorker)
    try:
        assert stage.configure(stage.parameters, {'teleop': TeleopParameters(dead_zone=0.0)}).ok
        seen = np.zeros(1, ESTIMATE)
        seen['speed'], seen['x_std'], seen['speed_std'], seen['phi_std'] = 5e-6, 5e-8, 1e-8, 0.01
        stage.be_disarmed()
        for k in range(6):
            t = 100.0 + 0.02 * k
            stage.move_joystick(np.array([deflected if k < 4 else 0.14, 0.0]), t)
            if k == 2:
                stage.be_armed()
            command = stage.step(seen, t, t).command
        assert np.hypot(*command.field) == pytest.approx(still)
    finally:
        stage.manager.close()
