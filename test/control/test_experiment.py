"""The controller that plays a plan by topic: once, within limits, and nothing besides."""

from __future__ import annotations

import numpy as np
import pytest

from microbot_ros.common.records import Commands
from microbot_ros.control.contract import ControllerInput, Limits, NoSolutionError, Workspace
from microbot_ros.control.plugins.experiment import Experiment
from microbot_ros.loop.controller import ControllerParameters, ControllerStage

VIEW = Workspace(np.full(2, -1e-4), np.full(2, 1e-4))
PLAN = Commands(np.array([0.0, 1.0, 3.0]), np.array([[1e-3, 0.0], [0.0, 2e-3], [0.0, 0.0]]))


def _at(t, plan=None, field=5e-3):
    one = np.ones(1)
    return ControllerInput(
        t, 0.02, 0.0, np.zeros(1, int), np.zeros((1, 2)), 1e-8 * one, one, 1e-6 * one, one,
        1e-8 * one, 1e-2 * one, Limits(field), VIEW, plan=plan)


def test_a_plan_is_played_once_from_when_it_comes():
    controller = Experiment()
    controller.activate(_at(0.0))
    assert not controller.compute(_at(0.5)).field.any()
    assert controller.compute(_at(10.0, PLAN)).field.tolist() == [1e-3, 0.0]
    assert controller.compute(_at(11.5, PLAN)).field.tolist() == [0.0, 2e-3]
    for t in (13.0, 14.0, 1e6):
        over = controller.compute(_at(t, PLAN))
        assert not over.field.any()
        assert over.progress.done


def test_a_plan_from_before_it_drove_is_not_played():
    controller = Experiment()
    controller.activate(_at(0.0, PLAN))
    assert not controller.compute(_at(0.02, PLAN)).field.any()
    other = Commands(PLAN.t, PLAN.field)
    assert controller.compute(_at(0.04, other)).field.any()


def test_what_took_over_in_between_ends_it():
    controller = Experiment()
    controller.activate(_at(0.0))
    assert controller.compute(_at(1.0, PLAN)).field.any()
    controller.deactivate()
    controller.activate(_at(2.0, PLAN))
    assert not controller.compute(_at(2.0, PLAN)).field.any()


def test_a_clock_that_goes_back_lets_go():
    controller = Experiment()
    controller.activate(_at(0.0))
    controller.compute(_at(5.0, PLAN))
    assert not controller.compute(_at(4.0, PLAN)).field.any()
    assert not controller.compute(_at(5.5, PLAN)).field.any(), 'it does not go on by itself'


def test_a_plan_beyond_the_limits_is_not_played():
    controller = Experiment()
    controller.activate(_at(0.0))
    with pytest.raises(NoSolutionError, match='2 mT'):
        controller.compute(_at(1.0, PLAN, field=1.9e-3))


@pytest.mark.parametrize('broken', [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize('part', ['t', 'field', 'frequency'])
def test_a_plan_of_no_numbers_is_refused(part, broken):
    stage = ControllerStage(ControllerParameters())
    try:
        stage.play(PLAN)
        rows = {'t': PLAN.t.copy(), 'field': PLAN.field.copy(), 'frequency': np.ones(3)}
        rows[part][1] = broken
        with pytest.raises(ValueError, match='finite'):
            stage.play(Commands(**rows))
        assert stage.plan is PLAN
    finally:
        stage.manager.close()


@pytest.mark.parametrize('t', [[0.0], [0.0, 0.0], [0.0, 2.0, 1.0], [1.0, 2.0]])
def test_a_plan_has_times_that_ascend_from_its_beginning(t):
    stage = ControllerStage(ControllerParameters())
    try:
        with pytest.raises(ValueError, match='ascend from 0'):
            stage.play(Commands(np.array(t), np.zeros((len(t), 2))))
    finally:
        stage.manager.close()
