"""Learned terms: tables between whose knots the model interpolates, and which fade beyond."""

from dataclasses import replace

import numpy as np
import pytest
from command_line import microbot
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import trapezoid
from scipy.interpolate import RegularGridInterpolator

from microbot_ros.common.errors import InputError
from microbot_ros.common.records import Commands
from microbot_ros.model.effect_context import EffectContext, Places
from microbot_ros.model.increments import respond
from microbot_ros.model.io.model_file import read_model, write_model
from microbot_ros.model.learned_term import LearnedTerm
from microbot_ros.model.model import Model, ParticleParameters
from microbot_ros.model.timeline import Timeline, last_change

RNG = np.random.default_rng(5)
LINE = np.concatenate([[-1.0], np.linspace(0.0, 10.0, 11), [11.0]])
SQUARE = np.arange(-4, 5) * 1e-5
NOBODY = ParticleParameters(np.arange(1), np.zeros(1), np.zeros(1))


def faded(shape, inner):
    values = np.zeros(shape)
    values[inner] = RNG.normal(0, 1e-6, values[inner].shape)
    return values


def term(against, frame, acts_on, axes, values):
    return LearnedTerm(against, frame, acts_on, axes, values, values - 1e-7, values + 1e-7,
                       np.abs(values).max(axis=1) > 0)


OF_TIME = term('time', 'laboratory', 'velocity', (LINE,), faded((13, 2), slice(1, -1)))
INNER = np.zeros((9, 9), bool)
INNER[1:-1, 1:-1] = True
OF_PLACE = term('position', 'laboratory', 'velocity', (SQUARE, SQUARE),
                faded((81, 2), INNER.ravel()))
OF_ANGLE = term('command angle', 'heading', 'heading',
                (-np.pi + np.arange(8) * np.pi / 4,), RNG.normal(0, 0.1, (8, 1)))
OF_NEIGHBOURS = term('neighbour distance', 'radial', 'velocity',
                     (np.array([1e-6, 5e-6, 2e-5, 4e-5, 5e-5]),), faded((5, 2), slice(1, 4)))
OF_SPEED = term('time since switch', 'heading', 'speed', (LINE / 5,),
                np.concatenate([[0], -np.linspace(2, 0.1, 11), [0]])[:, None])
TERMS = {'time': OF_TIME, 'place': OF_PLACE, 'angle': OF_ANGLE, 'neighbours': OF_NEIGHBOURS,
         'speed': OF_SPEED}


def context(t=0.0, angle=0.0, place=None, since=0.0):
    t = np.atleast_1d(t).astype(float)[:, None]
    field = 5e-3 * np.stack(np.broadcast_arrays(np.cos(angle), np.sin(angle)), axis=-1)
    return EffectContext(
        t, np.zeros_like(t), np.broadcast_to(field.reshape(-1, 1, 2), (len(t), 1, 2)),
        np.zeros_like(t), 5e-3, None if place is None else Places(np.asarray(place, float)),
        np.broadcast_to(np.asarray(since, float), t.shape))


@given(st.floats(-5, 15))
def test_a_table_of_time_is_linear_between_knots_and_nothing_beyond(t):
    felt = OF_TIME.drift(context(t))[0, 0]
    np.testing.assert_allclose(
        felt, [np.interp(t, LINE, column, 0, 0) for column in OF_TIME.values.T], atol=1e-18)


@given(st.floats(-9e-5, 9e-5), st.floats(-9e-5, 9e-5))
def test_a_table_of_place_is_bilinear_and_nothing_beyond(x, y):
    peer = RegularGridInterpolator((SQUARE, SQUARE), OF_PLACE.values.reshape(9, 9, 2),
                                   bounds_error=False, fill_value=0.0)
    felt = OF_PLACE.drift(context(place=[[[x, y]]]))[0, 0]
    np.testing.assert_allclose(felt, peer([[x, y]])[0], atol=1e-18)


@given(st.floats(-10, 10), st.integers(-2, 2))
def test_angles_are_the_same_again_a_turn_on(angle, turns):
    felt = [OF_ANGLE.heading_offset(context(angle=a))[0, 0] for a in (
        angle, angle + 2 * np.pi * turns)]
    assert felt[0] == pytest.approx(felt[1], abs=1e-9)


def test_without_a_field_or_a_place_it_does_nothing():
    still = replace(context(), field=np.zeros((1, 1, 2)))
    assert OF_ANGLE.heading_offset(still)[0, 0] == 0
    lost = OF_PLACE.drift(context(place=[[[np.nan, np.nan], [0, 0]]]))
    assert np.isfinite(lost).all()
    assert (lost[0, 0] == 0).all()
    np.testing.assert_array_equal(lost[0, 1], OF_PLACE.drift(context(place=[[[0, 0]]]))[0, 0])


def test_neighbours_feel_each_other_alike_and_nobody_who_is_far_or_missing():
    both = OF_NEIGHBOURS.drift(context(place=[[[0, 0], [1e-5, 0]]]))[0]
    np.testing.assert_allclose(both[0], -both[1])
    away = np.interp(1e-5, *((OF_NEIGHBOURS.axes[0], OF_NEIGHBOURS.values[:, 0])))
    assert both[1, 0] == pytest.approx(away)
    for third in ([np.nan, np.nan], [1.0, 1.0]):
        more = OF_NEIGHBOURS.drift(context(place=[[[0, 0], [1e-5, 0], third]]))[0]
        np.testing.assert_allclose(more[:2], both)
        assert (more[2] == 0).all()


def test_a_speed_is_never_negative():
    factor = OF_SPEED.speed_factor(context(since=0.0))
    assert OF_SPEED.values.min() < -1
    assert factor[0, 0] == 0


def test_it_says_where_it_was_learned():
    assert OF_TIME.inside(context(5.2)).all()
    assert not OF_TIME.inside(context(12.0)).any()
    inside = OF_PLACE.inside(context(place=[[[0, 0], [9e-5, 0], [np.nan, np.nan]]]))
    np.testing.assert_array_equal(inside, [[True, False, False]])


def test_the_knots_weigh_what_the_values_do():
    for one, at in ((OF_TIME, context([0.3, 7.7])),
                    (OF_PLACE, context(place=[[[1.3e-5, -2.2e-5], [0, 0]]]))):
        where, weight = one.knots(at)
        weighed = np.einsum('...k,...kc->...c', weight, one.values[where])
        np.testing.assert_allclose(weighed, one.drift(at), atol=1e-18)


def test_in_the_model_it_moves_what_it_says():
    commands = Commands(np.array([0.0]), np.array([[5e-3, 0.0]]))
    times = np.linspace(0, 10, 301)
    moved = respond(Model(5e-3, learned=(OF_TIME,)), Timeline(commands, times)).increments(NOBODY)
    total = [trapezoid(np.interp(np.linspace(0, 10, 4001), LINE, v), dx=10 / 4000)
             for v in OF_TIME.values.T]
    np.testing.assert_allclose(moved.sum(axis=0)[0], total, rtol=1e-3, atol=1e-9)


def test_the_time_since_a_switch_counts_changes_not_repeats():
    field = np.array([[1.0, 0], [1, 0], [0, 1], [0, 1]])
    np.testing.assert_array_equal(last_change(field), [0, 0, 2, 2])
    np.testing.assert_array_equal(last_change(field, np.array([1.0, 2, 2, 2])), [0, 1, 2, 2])
    assert len(last_change(np.empty((0, 2)))) == 0
    own = ParticleParameters(np.arange(1), np.full(1, 4e-6), np.zeros(1))
    model = Model(5e-3, learned=(replace(OF_SPEED, values=OF_SPEED.values / 4),))
    times = np.linspace(0, 4, 121)
    once = Commands(np.array([0.0, 2.0]), 5e-3 * np.array([[1.0, 0], [0, 1]]))
    again = Commands(np.array([0.0, 1.0, 2.0, 3.0]), 5e-3 * field)
    np.testing.assert_allclose(respond(model, Timeline(once, times)).increments(own),
                               respond(model, Timeline(again, times)).increments(own), atol=1e-12)


@pytest.mark.parametrize('name', TERMS)
def test_model_yaml_gives_it_back_to_the_last_bit(tmp_path, name):
    one = replace(TERMS[name], formula='c0 x⁻²', parameters={'c0_um_s': 0.1})
    model = Model(5e-3, learned=(one,))
    write_model(tmp_path / 'model.yaml', model, NOBODY)
    assert read_model(tmp_path / 'model.yaml')[0] == model


@pytest.mark.parametrize(('change', 'message'), [
    (('against: time\n', 'against: weather\n'), "'learned.0.against'"),
    (('frame: laboratory', 'frame: radial'), 'radial'),
    (('acts_on: velocity', 'acts_on: heading'), "'frame' and 'acts_on'"),
    (('    - 2.0\n', '    - .nan\n'), 'finite number'),
    (('    - 2.0\n', '    - 1.0\n'), 'ascend'),
    (('  seen:\n  - false\n', '  seen:\n'), "'seen'"),
    (('    x_um_s:\n', '    x_um_s:\n    - 1.0\n'), '13 finite numbers'),
])
def test_a_table_that_cannot_be_is_refused_in_one_line(tmp_path, change, message):
    path = tmp_path / 'model.yaml'
    write_model(path, Model(5e-3, learned=(OF_TIME,)), NOBODY)
    text = path.read_text()
    assert change[0] in text
    path.write_text(text.replace(*change, 1))
    with pytest.raises(InputError) as raised:
        read_model(path)
    assert message in str(raised.value)
    assert '\n' not in str(raised.value)


def test_terms_are_compared_by_what_they_hold():
    assert replace(OF_TIME, values=OF_TIME.values.copy()) == OF_TIME
    assert replace(OF_TIME, values=OF_TIME.values * 2) != OF_TIME
    assert OF_TIME != 'a term'
    assert len({OF_TIME, replace(OF_TIME)}) == 1


def test_simulate_runs_with_it(tmp_path):
    """A flow along x of 2 µm/s in the middle of the dish, felt by particles that stand still."""
    flow = np.zeros((81, 2))
    flow[INNER.ravel(), 0] = 2e-6
    model = Model(5e-3, learned=(term('position', 'laboratory', 'velocity',
                                      (SQUARE * 100, SQUARE * 100), flow),))
    write_model(tmp_path / 'model.yaml', model, ParticleParameters(
        np.arange(2), np.full(2, 1e-9), np.zeros(2)))
    (tmp_path / 'scenario.yaml').write_text(
        'duration_s: 3\nradius_um: 4.6\nreference_field_mT: 5\nmodel: model.yaml\n'
        'fluid: {viscosity_mPa_s: 1.245, temperature_K: 298}\n'
        'camera: {frame_rate_hz: 10, exposure: 0.0, localisation_um: 0.0}\n'
        'commands:\n  steps: {field_mT: 5, dwell_s: [1, 2]}\n')
    assert microbot('simulate', tmp_path / 'scenario.yaml', '--out', tmp_path / 'out') == 0
    rows = np.genfromtxt(tmp_path / 'out' / 'tracks.csv', delimiter=',', names=True)
    for particle in (0, 1):
        own = rows[rows['particle'] == particle]
        assert own['x_um'][-1] - own['x_um'][0] == pytest.approx(5.8, abs=2.5)
        assert abs(own['y_um'][-1] - own['y_um'][0]) < 2.5
