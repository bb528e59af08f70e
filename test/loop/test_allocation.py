"""A field that turns, as currents of six coils and of four."""

import math

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from microbot_ros.cli.demo.robots import three_pairs
from microbot_ros.drive.rotation import Rotation
from microbot_ros.loop.allocation import AllocationStage, GateParameters

vectors = st.tuples(*[st.floats(-1, 1)] * 3).map(np.array).filter(
    lambda v: np.linalg.norm(v) > 0.1)


@pytest.fixture(scope='module')
def six(tmp_path_factory):
    file = tmp_path_factory.mktemp('coils') / 'coils.yaml'
    file.write_text(yaml.safe_dump({'coils': three_pairs().content()}))
    return AllocationStage(GateParameters(coils_file=str(file)))


def fields(stage, turning, times):
    rotation = Rotation(1e9)
    rotation.follow(turning, 0.0, turning.at(turning.start))
    return np.array([stage.field(rotation.currents(t)) for t in times])


@given(field=vectors, axis=vectors, rate=st.floats(0.1, 250))
def test_the_field_goes_round_the_axis_on_the_cone_it_was_given(six, field, axis, rate):
    field, axis = 2e-3 * field, axis / np.linalg.norm(axis)
    if np.linalg.norm(np.cross(field, axis)) < 1e-6:
        return
    made = fields(six, six.turn(field, rate * axis), [0.0, 0.001])
    assert made[0] == pytest.approx(field, abs=1e-12)  # it begins as it is commanded
    assert np.linalg.norm(made, axis=1) == pytest.approx(np.linalg.norm(field), rel=1e-9)
    assert made @ axis == pytest.approx(field @ axis, abs=1e-12)  # ψ, half the cone's angle
    across = made - np.outer(made @ axis, axis)
    angle = math.atan2(np.cross(*across) @ axis, across[0] @ across[1])
    assert angle == pytest.approx(rate * 0.001, abs=1e-6)


def test_more_than_the_coils_can_turn_is_made_smaller_and_as_round(six):
    turning = six.turn(np.array([0.1, 0, 0]), np.array([0, 10.0, 0]))
    made = fields(six, turning, np.linspace(0, 1, 200))
    assert np.ptp(np.linalg.norm(made, axis=1)) < 1e-12
    angles = np.linspace(0, 7, 999)
    currents = np.array([turning.at((math.cos(a), 0, -math.sin(a))) for a in angles])
    assert np.abs(currents).max() == pytest.approx(six.coils.max_current[0], rel=1e-4)
    assert np.all(np.abs(currents) <= six.coils.max_current + 1e-12)


def test_coils_in_a_plane_turn_the_field_in_it_and_refuse_the_rest():
    four = AllocationStage(GateParameters())
    made = fields(four, four.turn(np.array([3e-3, 0, 0]), np.array([0, 0, 5.0])), [0.0, 0.1])
    assert made == pytest.approx(3e-3 * np.array(
        [[1, 0], [math.cos(0.5), math.sin(0.5)]]), abs=1e-12)
    with pytest.raises(ValueError, match='no field along z'):
        four.turn(np.array([3e-3, 0, 0]), np.array([0, 5.0, 0]))
    with pytest.raises(ValueError, match='no field along z'):
        four.step(np.array([0, 0, 1e-3]))
    assert four.step(np.array([1e-3, 2e-3, 0.0])) == pytest.approx(
        four.step(np.array([1e-3, 2e-3])), abs=0)


@pytest.mark.parametrize('bad', [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize('place', [0, 1, 2])
def test_what_is_not_finite_is_no_current_at_all(six, bad, place):
    wrong, right = np.array([1e-3, 0, 0]), np.array([0, 0, 5.0])
    wrong[place] = bad
    assert np.isnan(six.step(wrong)).all()
    for turning in (six.turn(wrong, right), six.turn(right * 1e-4, wrong * 1e3)):
        assert np.isnan(turning.at(turning.start)).all()


def test_a_board_may_turn_the_largest_field_by_itself():
    """Rounding must not carry the largest current beyond the limit of the gate."""
    values = GateParameters()
    stage = AllocationStage(values)
    for strength in np.linspace(8e-3, 20e-3, 50):
        rotation = Rotation(values.slew_limit_A_per_s)
        rotation.follow(stage.turn(np.array([strength, 0, 0]), np.array([0, 0, 6 * math.pi])),
                        0.0, np.zeros(4))
        for k in range(1, 40):
            rotation.currents(1e-3 * k)
        assert rotation.settled
        assert (rotation.swing().largest <= values.current_limit_A).all()
