"""Courses, made-up fields, goals and whose they are."""

import cmath
import dataclasses
import math

import numpy as np
import pytest

from microbot_ros.control.contract import GoalError, Goals, Limits, ParticleLostError
from microbot_ros.control.planning.assignment import Assignment
from microbot_ros.control.steering.courses import Excitation, approach, field_along
from microbot_ros.control.steering.goal_sequence import GoalSequence
from microbot_ros.control.testkit import controller_input
from microbot_ros.model.effects.field.background_field import BackgroundField
from microbot_ros.model.effects.field.coil_gain_mismatch import CoilGainMismatch
from microbot_ros.model.model import Model


@pytest.mark.parametrize('start', [30 + 10j, 0.2 + 0.1j, -1j, 1e-9 + 0j])
def test_approach_ends_on_the_circle_at_once_straight(start):
    """Kinematics of unit speed; the way is at most the tangent and a part of the circle."""
    z, step, path = start, 0.01, []
    for _ in range(6000):
        z += step * cmath.exp(1j * approach(-z, 1.0))
        path.append(abs(z))
    assert np.abs(np.array(path[-1000:]) - 1).max() < 0.02
    arrival = next(k for k, distance in enumerate(path) if distance < 1.05) * step
    assert arrival <= max(abs(start), 2.0)


def test_approach_turns_counter_clockwise_on_the_circle():
    assert approach(-1 + 0j, 1.0) == pytest.approx(math.pi - math.pi / 2)
    assert approach(0j, 1.0) == pytest.approx(-math.pi)


def test_field_along_makes_up_for_what_the_model_knows():
    model = Model(5e-3, effects=(BackgroundField(bx=0.4e-3, by=-0.3e-3), CoilGainMismatch(0.8)))
    shown = controller_input(model=model)
    for angle in np.linspace(-3, 3, 7):
        command = field_along(shown, angle, 3e-3)
        field = model.field(command)
        assert field == pytest.approx([3e-3 * math.cos(angle), 3e-3 * math.sin(angle)], abs=2e-6)
        strong = field_along(shown, angle, 1.0)
        assert math.hypot(*strong) <= shown.limits.field * (1 + 1e-12)
        assert math.remainder(
            math.atan2(*model.field(strong)[::-1]) - angle, math.tau) == pytest.approx(0, abs=0.01)


def test_field_along_without_a_model_keeps_the_limit():
    shown = controller_input(limits=Limits(field=2e-3))
    assert field_along(shown, math.pi / 2, 9.0) == pytest.approx([0, 2e-3])


def test_excitation_is_a_closed_triangle_that_starts_anew():
    excitation = Excitation()

    def field(t):
        return excitation.command(controller_input(t=t), 1.0, 1e-3, particles=None).field

    fields = [field(5 + 0.1 * k) for k in range(30)]
    assert np.sum(fields, axis=0) == pytest.approx([0, 0], abs=1e-12)
    assert fields[0] == pytest.approx([1e-3, 0])
    excitation.stop()
    assert field(9.7) == pytest.approx([1e-3, 0])


GOALS = np.array([[10e-6, 0], [20e-6, 0], [30e-6, 0]])


def test_goal_sequence_ticks_off_goals_in_order_and_stays_at_the_last():
    sequence, shown = GoalSequence(), controller_input(goals=Goals(GOALS))
    sequence.update(shown, asked=1)
    assert sequence.row(shown) == 1
    assert sequence.offset(0j, 1e-6) == pytest.approx(10e-6)
    assert sequence.offset(9.5e-6 + 0j, 1e-6) == pytest.approx(10.5e-6)
    assert not sequence.done
    sequence.offset(20e-6 + 0j, 1e-6)
    sequence.offset(30e-6 + 0j, 1e-6)
    assert sequence.done
    sequence.offset(0j, 1e-6)
    sequence.update(shown, asked=1)
    assert sequence.done
    assert str(sequence) == 'particle 1: goal 3 of 3'
    sequence.update(controller_input(goals=Goals(GOALS[:2])), asked=1)
    assert not sequence.done
    assert sequence.offset(0j, 1e-6) == pytest.approx(10e-6)


def test_goal_sequence_chooses_the_nearest_and_another_when_that_is_lost():
    position = np.array([[50e-6, 0], [12e-6, 0], [30e-6, 0]])
    shown = controller_input(goals=Goals(GOALS), position=position)
    sequence = GoalSequence()
    sequence.update(shown, asked=-1)
    assert sequence.row(shown) == 1
    position[1] = 40e-6, 0
    assert sequence.row(controller_input(goals=Goals(GOALS), position=position)) == 1
    # Lost at 40 µm: number 0 at 48 µm is nearer to there than number 2, which is at the goals.
    position[0] = 48e-6, 0
    fewer = controller_input(
        2, goals=Goals(GOALS), position=position[[0, 2]], ids=np.array([0, 2]))
    sequence.update(fewer, asked=-1)
    assert sequence.row(fewer) == 0
    assert sequence.particle == 0
    with pytest.raises(ParticleLostError):
        sequence.row(controller_input(0))


def test_goal_sequence_of_a_named_particle_is_for_that_one_only():
    shown = controller_input(goals=Goals(GOALS, np.array([2, 1, 2])))
    sequence = GoalSequence()
    sequence.update(shown, asked=-1)
    assert (len(sequence), sequence.row(shown)) == (2, 2)
    with pytest.raises(ParticleLostError, match='particle 2'):
        sequence.row(controller_input(2))


@pytest.mark.parametrize('bad', [(np.nan, 0), (np.inf, 0), (0, -np.inf), (145e-6, 0), (0, 1.0)])
def test_goals_no_camera_could_see_are_refused(bad):
    shown = controller_input(goals=Goals(np.array([[0, 0], bad])))
    with pytest.raises(GoalError, match='goal 2'):
        GoalSequence().update(shown, asked=-1)
    with pytest.raises(GoalError, match='goal 2'):
        Assignment().update(shown)


def test_assignment_keeps_each_goal_with_its_particle():
    assignment = Assignment()
    shown = controller_input(3, ids=np.array([7, 3, 5]), goals=Goals(GOALS))
    assert assignment.update(shown)
    rows, goals = assignment.pairs(shown)
    assert dict(zip(shown.ids[rows].tolist(), goals[:, 0].tolist(), strict=True)) == {
        3: 10e-6, 5: 20e-6, 7: 30e-6}
    later = controller_input(2, ids=np.array([7, 5]), goals=Goals(GOALS))
    assert not assignment.update(later)
    rows, goals = assignment.pairs(later)
    assert later.ids[rows].tolist() == [5, 7]
    assert goals[:, 0].tolist() == [20e-6, 30e-6]
    with pytest.raises(ParticleLostError):
        assignment.pairs(controller_input(1, ids=np.array([9])))


def test_the_same_goals_sent_again_after_they_were_done_start_anew():
    sequence, place = GoalSequence(), np.array([[0.0, 0.0]])
    first = Goals(np.array([[0.0, 0.0], [1e-6, 0.0]]), stamp=1.0)
    sequence.update(controller_input(1, position=place, goals=first), -1)
    sequence.done = True
    sequence.update(controller_input(1, position=place, goals=first), -1)
    assert sequence.done
    sequence.update(controller_input(1, position=place, goals=dataclasses.replace(
        first, stamp=2.0)), -1)
    assert not sequence.done
