"""Every controller that is installed keeps the contract; the kit notices those that don't."""

import dataclasses

import numpy as np
import pytest

from microbot_ros.control import registry
from microbot_ros.control.contract import (
    Controller,
    FieldCommand,
    Goals,
    Input,
    ParticleLostError,
    Workspace,
    no_field,
)
from microbot_ros.control.testkit import controller_input, exercise

CLASSES = registry.controller_classes()


@pytest.mark.parametrize('name', CLASSES)
def test_controller_keeps_the_contract(name):
    exercise(CLASSES[name])


class Honest(Controller):
    interface_version = 1
    summary = 'Does nothing.'
    takes = frozenset({Input.GOALS, Input.PARTICLE_GOALS})

    def compute(self, inputs):
        return no_field('')


class TooStrong(Honest):
    def compute(self, inputs):
        return FieldCommand(np.array([inputs.limits.field * 1.01, 0]))


class NotANumber(Honest):
    def compute(self, inputs):
        return FieldCommand(np.array([np.nan, 0]))


class TooFast(Honest):
    def compute(self, inputs):
        return FieldCommand(np.zeros(2), np.inf)


class Meddler(Honest):
    def compute(self, inputs):
        inputs.position[:] = 0
        return no_field('')


class Silent(Honest):
    def compute(self, inputs):
        raise ParticleLostError


class Careless(Honest):
    def compute(self, inputs):
        return FieldCommand(inputs.goals.position[0])


class Unsaid(Honest):
    takes = None


class Follower(Honest):
    """Acts on goals, and does not say so."""

    takes = frozenset({Input.PATH})

    def compute(self, inputs):
        return FieldCommand(1e-3 * np.sign(inputs.goals.position.sum(0)))


class Grabber(Honest):
    takes = frozenset()

    def compute(self, inputs):
        return FieldCommand(1e-3 * inputs.joystick)


class Old(Honest):
    interface_version = 0


def test_the_kit_accepts_an_honest_controller():
    exercise(Honest)


@pytest.mark.parametrize('kind', [
    TooStrong, NotANumber, TooFast, Meddler, Silent, Old, Unsaid, Follower, Grabber])
def test_the_kit_notices(kind):
    with pytest.raises(AssertionError, match=r'\w+ .*'):
        exercise(kind)


def test_the_kit_lets_other_exceptions_through():
    with pytest.raises(IndexError):
        exercise(Careless)


class Entry:
    """Stands in for an entry point."""

    def __init__(self, name, target):
        self.name, self.value, self._target = name, f'lab:{name}', target

    def load(self):
        if isinstance(self._target, Exception):
            raise self._target
        return self._target


@pytest.fixture
def plugins(monkeypatch):
    entries = [Entry('zeta', Honest), Entry('broken', ImportError('no module named lab')),
               Entry('old', Old), Entry('thing', 7), Entry('alpha', Honest)]
    monkeypatch.setattr(registry, '_installed', lambda: {one.name: one for one in entries})


@pytest.mark.usefixtures('plugins')
def test_bystanders_that_fail_are_logged_and_left_out(caplog):
    assert list(registry.controller_classes('alpha')) == ['alpha', 'zeta']
    assert len(caplog.records) == 3


@pytest.mark.usefixtures('plugins')
@pytest.mark.parametrize(('name', 'reason'), [
    ('broken', 'no module named lab'), ('old', 'interface version 0; expected 1'),
    ('thing', 'is no Controller class'), ('absent', 'there are: alpha, broken')])
def test_a_requested_plugin_that_fails_is_an_error_with_its_reason(name, reason):
    for ask in (registry.controller_class, registry.controller_classes):
        with pytest.raises(registry.PluginError, match=reason):
            ask(name)


def test_controller_input_knows_who_is_who():
    shown = controller_input(3, ids=np.array([4, 2, 9]), phi_std=np.array([0.1, np.nan, np.inf]))
    assert shown.index(2) == 1
    assert shown.learned(0.2).tolist() == [True, False, False]
    with pytest.raises(ParticleLostError, match='particle 5'):
        shown.index(5)


def test_workspace_holds_only_what_is_inside():
    view = Workspace(np.array([-1.0, -2.0]), np.array([1.0, 2.0]))
    edge = np.array([[1, 2], [-1, -2], [1.0001, 0], [0, -2.0001], [np.nan, 0], [np.inf, 0]])
    assert view.holds(edge).tolist() == [True, True, False, False, False, False]
    assert not view.holds(edge, margin=0.1).any()
    assert dataclasses.replace(controller_input(), goals=Goals()).goals.position.shape == (0, 2)
