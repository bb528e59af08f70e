"""The online estimator on simulated experiments, and on everything that goes wrong."""

from dataclasses import replace

import numpy as np
import pytest
from filmed import CONDITIONS, FIELD, swimmers
from hypothesis import given, settings
from hypothesis import strategies as st

from microbot_ros.common.errors import InputError
from microbot_ros.common.records import Commands, Conditions
from microbot_ros.estimation.online.estimator import Estimator, Settings
from microbot_ros.model.effects.field.command_delay import CommandDelay
from microbot_ros.model.effects.heading.alignment_lag import AlignmentLag
from microbot_ros.model.effects.heading.heading_slip import HeadingSlip
from microbot_ros.model.effects.velocity.linear_flow import LinearFlow
from microbot_ros.model.effects.velocity.speed_decay import SpeedDecay
from microbot_ros.model.effects.velocity.uniform_drift import UniformDrift
from microbot_ros.model.io.model_file import write_model
from microbot_ros.model.model import Model, ParticleParameters
from microbot_ros.virtual_rig.record_session import Camera

NOBODY = ParticleParameters(np.empty(0, int), np.empty(0), np.empty(0))


def experiment(seed, seconds=20.0, hidden=None, commands=None, **camera):
    """A filmed session of three swimmers far apart, and their true c."""
    return swimmers(seed, seconds, Camera(**{'frame_rate': 20.0, 'noise': 0.1e-6, **camera}),
                    dwell=(1.0, 3.0), commands=commands, hidden=hidden)


def replay(session, estimator=None, change=lambda *_: None, load=None):
    """The estimates of every frame, of positions (T, N, 2) after a `change`; a model that is to be
    loaded is from the hundredth frame on.
    """
    estimator = estimator or Estimator(session.conditions)
    times, positions = session.tracks.grid()
    change(times, positions)
    sent, out = 0, []
    for k, (t, position) in enumerate(zip(times, positions, strict=True)):
        if load and k == 100:
            estimator.load(load)
        while sent < len(session.commands.t) and session.commands.t[sent] <= t:
            estimator.command(session.commands.t[sent], session.commands.field[sent])
            sent += 1
        out.append(estimator.update(t, session.tracks.particles, position))
    return out


def deviations(estimates, gain):
    turned = np.angle(np.exp(1j * estimates.phi) * np.conj(gain))
    return np.concatenate([
        (estimates.speed - np.abs(gain)) / estimates.speed_std, turned / estimates.phi_std])


@pytest.mark.parametrize('camera', [
    {}, {'noise': 0.02e-6}, {'noise': 0.3e-6}, {'missed': 0.2, 'run': 4.0, 'dropped': 0.05},
    {'exposure': 1.0},
], ids=str)
def test_speed_and_direction_come_out_within_their_spread(camera):
    off = []
    for seed in range(3):
        session, gain = experiment(seed, **camera)
        exposure = camera.get('exposure', 0.0) / 20.0
        last = replay(session, Estimator(CONDITIONS, Settings(exposure=exposure)))[-1]
        assert last.known.all()
        off.append(deviations(last, gain))
        np.testing.assert_allclose(last.speed, np.abs(gain), rtol=0.12)
    # 18 deviates of unit variance: their root mean square strays by 0.17.
    assert 0.5 < np.sqrt(np.mean(np.square(off))) < 1.6


def test_a_speed_that_falls_is_followed_within_its_spread():
    """Fuel that runs out, which the model does not have."""
    session, gain = experiment(0, 90.0, ('speed_decay', {'tau_s': 150.0}))
    times, _ = session.tracks.grid()
    off = [(found.speed - np.abs(gain) * np.exp(-t / 150)) / found.speed_std
           for t, found in zip(times, replay(session), strict=True) if t > 20]
    assert np.mean(np.abs(off) < 2) > 0.8


def test_force_carries_the_spread_of_viscosity_and_radius():
    session, _ = experiment(0, 6.0)
    last = replay(session)[-1]
    drag = 6 * np.pi * 1.245e-3 * 4.6e-6
    np.testing.assert_allclose(last.force, drag * last.speed)
    relative = np.sqrt((last.speed_std / last.speed) ** 2 + 0.05**2 + 0.05**2)
    np.testing.assert_allclose(last.force_std / last.force, relative)


def test_prediction_is_where_particles_will_be():
    session, _ = experiment(1, 15.0)
    estimates = replay(session)
    off = []
    for now, then in zip(estimates[200:-10], estimates[210:], strict=True):
        turned = session.commands.index_at(now.t) != session.commands.index_at(then.t)
        if not turned:
            off.append((then.position - now.prediction) / now.prediction_std[:, None])
    assert 0.7 < np.sqrt(np.mean(np.square(off))) < 1.3


def test_delay_is_found_and_used():
    session, gain = experiment(2, hidden=('command_delay', {'delay_s': 0.15}))
    last = replay(session)[-1]
    assert abs(last.delay - 0.15) < 4 * last.delay_std + 1e-3
    assert last.delay_std < 0.02
    assert np.sqrt(np.mean(deviations(last, gain) ** 2)) < 1.8


def test_nothing_is_claimed_before_the_command_excites():
    estimator = Estimator(CONDITIONS)
    rng = np.random.default_rng(0)
    for k in range(100):
        found = estimator.update(k / 20, [4], 1e-7 * rng.normal(size=(1, 2)))
    assert not found.known[0]
    assert np.isnan([found.speed[0], found.phi[0], found.force[0]]).all()
    assert any('no command' in text for text in found.diagnosis)


def test_what_one_way_turning_confounds_is_said():
    commands = Commands(np.arange(0, 12, 0.1), FIELD * np.stack(
        [np.cos(0.6 * np.arange(120)), np.sin(0.6 * np.arange(120))], axis=-1))
    session, _ = experiment(0, 12.0, commands=commands)
    said = {text for found in replay(session) for text in found.diagnosis}
    assert any(text.startswith('φ and delay cannot be distinguished') for text in said)


def test_under_one_constant_command_drift_hides():
    straight = Commands(np.zeros(1), np.array([[FIELD, 0.0]]))
    last = replay(experiment(0, 10.0, commands=straight)[0])[-1]
    for name in ('speed', 'φ'):
        assert any(text.startswith(f'{name} and drift cannot be distinguished')
                   for text in last.diagnosis)


@pytest.mark.parametrize(('hidden', 'effect'), [
    (('uniform_drift', {'wx_um_s': 1.2, 'wy_um_s': -0.9}), UniformDrift(1.2e-6, -0.9e-6)),
    (('alignment_lag', {'tau_s': 0.4}), AlignmentLag(0.4)),
    (('linear_flow', {'gxx_per_s': 0.0, 'gxy_per_s': 0.02, 'gyx_per_s': 0.0, 'gyy_per_s': 0.0}),
     LinearFlow(0.0, 0.02, 0.0, 0.0)),
])
def test_a_model_that_is_loaded_while_running_explains_from_then_on(tmp_path, hidden, effect):
    session, gain = experiment(5, hidden=hidden)
    write_model(tmp_path / 'model.yaml', Model(FIELD, effects=(effect,)), NOBODY)
    told, plain = (replay(session, load=load)[-1] for load in (tmp_path / 'model.yaml', None))
    assert np.sqrt(np.mean(deviations(told, gain) ** 2)) < 1.8
    # What a model leaves unexplained, it takes for diffusion.
    assert told.noise.diffusion < 0.8 * plain.noise.diffusion
    assert any('does not explain' in text for text in plain.diagnosis)


def test_a_model_that_is_used_before_the_first_frame_is_that_of_the_beginning():
    """With the headings that lag, and their deviations."""
    session, _ = experiment(5, hidden=('alignment_lag', {'tau_s': 0.4}))
    model = Model(FIELD, effects=(AlignmentLag(0.4),))
    changed = Estimator(CONDITIONS)
    changed.use(model)
    begun, later = (replay(session, one)[-1] for one in (
        Estimator(CONDITIONS, model=model), changed))
    np.testing.assert_array_equal(later.speed, begun.speed)
    np.testing.assert_array_equal(later.phi_std, begun.phi_std)


def test_doubts_about_a_model_end_with_it(tmp_path):
    def drift(times, positions):
        positions[..., 0] += 2e-6 * np.maximum(times - 3, 0)[:, None]

    session, _ = experiment(5, 6.0)
    write_model(tmp_path / 'model.yaml', Model(FIELD, effects=(UniformDrift(2e-6, 0.0),)), NOBODY)
    found = replay(session, change=drift, load=tmp_path / 'model.yaml')
    doubts = [any('microbot discover' in text for text in one.diagnosis) for one in found[99:]]
    assert doubts[:2] == [True, False]


def test_a_delay_that_was_found_is_forgotten_when_a_model_has_it(tmp_path):
    session, _ = experiment(2, 8.0, hidden=('command_delay', {'delay_s': 0.15}))
    write_model(tmp_path / 'model.yaml', Model(FIELD, effects=(CommandDelay(0.15),)), NOBODY)
    found = replay(session, load=tmp_path / 'model.yaml')
    assert found[99].delay > 0.1
    assert found[100].delay == 0
    assert found[-1].delay < 0.02


@pytest.mark.parametrize(('hidden', 'effect', 'aged'), [
    (('heading_slip', {'rate_rad_s': 0.1}), HeadingSlip(0.1), lambda t: np.exp(0.1j * t)),
    (('speed_decay', {'tau_s': 20.0}), SpeedDecay(20.0), lambda t: np.exp(-t / 20)),
])
def test_speed_and_direction_are_those_of_now(hidden, effect, aged):
    session, gain = experiment(6, hidden=hidden)
    last = replay(session, Estimator(CONDITIONS, model=Model(FIELD, effects=(effect,))))[-1]
    assert np.sqrt(np.mean(deviations(last, gain * aged(last.t)) ** 2)) < 1.8
    assert np.sqrt(np.mean(deviations(last, gain) ** 2)) > 5


def test_a_delay_of_the_model_reaches_back_beyond_commands_that_repeat():
    """As a graph sends them: one with every frame, most of them the same."""
    session, gain = experiment(7, hidden=('command_delay', {'delay_s': 0.4}))
    times = np.unique(session.tracks.t)
    repeated = replace(session, commands=Commands(times, session.commands.field_at(times)))
    model = Model(FIELD, effects=(CommandDelay(0.4),))
    last = replay(repeated, Estimator(CONDITIONS, model=model))[-1]
    assert last.known.all()
    assert np.sqrt(np.mean(deviations(last, gain) ** 2)) < 1.8


def test_a_bad_model_file_is_refused_and_the_old_model_kept(tmp_path):
    estimator = Estimator(CONDITIONS, model=Model(FIELD, effects=(AlignmentLag(0.4),)))
    before = estimator.model
    bad = tmp_path / 'model.yaml'
    bad.write_text('effects: {no_such_effect: {}}\n')
    with pytest.raises(InputError, match=r'model\.yaml'):
        estimator.load(bad)
    write_model(bad, Model(FIELD, 'rolling'), NOBODY)
    with pytest.raises(InputError, match='propulsion'):
        estimator.load(bad)
    assert estimator.model is before


def spoiled(change, seconds=15.0, seed=3):
    """The last estimates and the diagnosis of a run whose positions were changed after 10 s."""
    found = replay(experiment(seed, seconds)[0], change=change)
    assert all(np.isfinite(now.position).all() for now in found)
    return found[-1], {text for now in found if now.t > 10 for text in now.diagnosis}


def test_a_particle_that_is_stuck_is_named():
    def stick(times, positions):
        positions[times > 10, 1] = positions[times > 10][0, 1]

    _, said = spoiled(stick)
    assert 'particle 1 does not follow the field: stuck, or not a swimmer?' in said
    assert not any('particle 0' in text or 'particle 2' in text for text in said)


def test_a_particle_that_jumps_is_named_and_followed():
    def jump(times, positions):
        positions[times > 10, 2] += 30e-6

    found, said = spoiled(jump)
    assert any(text.startswith('particle 2 jumped by 42') for text in said)
    assert found.known.all()
    assert found.position_std[2] < 0.3e-6


def test_two_tracks_of_one_particle_are_named():
    def double(_, positions):
        rng = np.random.default_rng(0)
        positions[:, 2] = positions[:, 1] + 0.05e-6 * rng.normal(size=positions[:, 1].shape)

    _, said = spoiled(double)
    assert 'particles 1 and 2 have the same position: two tracks of one particle?' in said


def test_what_is_not_a_number_is_named_and_left_out():
    def spoil(times, positions):
        positions[times > 10, 0] = np.nan

    found, said = spoiled(spoil)
    assert 'particle 0 was reported at a position that is not a number' in said
    assert list(found.seen) == [False, True, True]


def test_the_model_node_is_told_when_the_model_stops_explaining():
    def drift(times, positions):
        positions[..., 0] += 2e-6 * np.maximum(times - 10, 0)[:, None]

    _, said = spoiled(drift, 16.0)
    assert any('all particles drift' in text and 'microbot discover' in text for text in said)


@pytest.mark.parametrize(('offset', 'side'), [(1e4, 'after'), (-1e9, 'before')])
def test_commands_from_another_clock_are_noticed(offset, side):
    estimator = Estimator(CONDITIONS)
    estimator.command(offset, [FIELD, 0])
    for k in range(10):
        found = estimator.update(1.0 + k, [0], [[0, 0]])
    assert any(f'{side} the frames: different clocks?' in text for text in found.diagnosis)


def test_frames_and_commands_out_of_order_are_ignored_and_said():
    estimator = Estimator(CONDITIONS)
    estimator.command(0.0, [FIELD, 0])
    estimator.command(-0.5, [FIELD, 0])
    estimator.command(0.1, [np.nan, 0])
    first = estimator.update(1.0, [0], [[0, 0]])
    for t in (1.0, 0.9, np.nan, np.inf):
        again = estimator.update(t, [0], [[5e-6, 0]])
        np.testing.assert_array_equal(again.position, first.position)
    assert any('not later' in text for text in again.diagnosis)
    assert any('not finite' in text for text in again.diagnosis)
    assert any('before it: ignored' in text for text in again.diagnosis)


def test_notes_of_before_the_clock_was_set_back_go():
    estimator, random = Estimator(CONDITIONS), np.random.default_rng(0)
    for begin, leap in ((3600.0, 50e-6), (0.0, 0.0)):
        for k in range(400):
            t = begin + k / 20
            if k % 40 == 0:
                estimator.command(t, FIELD * np.array([np.cos(k), np.sin(k)]))
            place = 1e-7 * random.normal(size=(1, 2)) + leap * (k > 380)
            found = estimator.update(t, np.array([3]), place, np.array([1e-7]))
        assert any('jumped' in one for one in found.diagnosis) == (leap > 0)


def test_a_roller_is_judged_by_its_gain():
    estimator, random = Estimator(
        Conditions(propulsion='rolling', radius=0.5e-6, viscosity=1e-3)), np.random.default_rng(0)
    place, gain, frequency = 0j, 0.08e-6, 30.0
    for k in range(800):
        angle = k // 40 * 1.1
        if k % 40 == 0:
            estimator.command(k / 20, np.array([np.cos(angle), np.sin(angle)]), frequency)
        seen = place + 5e-8 * complex(*random.normal(size=2))
        found = estimator.update(
            k / 20, np.array([0]), np.array([[seen.real, seen.imag]]), np.array([5e-8]))
        place += gain * frequency * np.exp(1j * angle) / 20 + 9e-8 * complex(
            *random.normal(size=2))
    assert not any('follow the field' in one for one in found.diagnosis)


def test_a_clock_set_back_starts_anew():
    session, gain = experiment(0, 8.0)
    estimator = Estimator(CONDITIONS)
    replay(session, estimator)
    again = replay(session, estimator)
    assert any('set back' in text for text in again[0].diagnosis)
    np.testing.assert_allclose(again[-1].speed, np.abs(gain), rtol=0.2)


def test_particles_come_and_go():
    estimator = Estimator(CONDITIONS, Settings(forget_after=1.0))
    estimator.command(0.0, [FIELD, 0])
    estimator.update(0.0, [7, 3], [[0, 0], [1e-5, 0]])
    found = estimator.update(0.5, [3, 9], [[1e-5, 0], [2e-5, 0]])
    assert list(found.id) == [3, 7, 9]
    assert list(found.seen) == [True, False, True]
    assert list(estimator.update(1.4, [3], [[1e-5, 0]]).id) == [3, 9]
    empty = estimator.update(9.0, [], np.empty((0, 2)))
    assert empty.id.shape == empty.speed.shape == (0,)


rows = st.lists(
    st.tuples(st.integers(0, 4), st.floats(allow_nan=True, allow_infinity=True, width=32),
              st.floats(-1e-3, 1e-3)), max_size=6)


@settings(max_examples=60)
@given(st.lists(st.tuples(
    st.floats(-0.5, 2.0), rows, st.floats(-1, 1) | st.just(np.nan), st.booleans()), max_size=25))
def test_no_input_breaks_it(script):
    estimator, t = Estimator(CONDITIONS), 0.0
    for step, readings, bx, commanded in script:
        t += step
        if commanded:
            estimator.command(t, [bx, FIELD])
        ids = [name for name, _, _ in readings]
        found = estimator.update(
            t, ids, np.array([[x, y] for _, x, y in readings]).reshape(-1, 2))
        assert np.isfinite(found.position).all()
        assert (found.position_std > 0).all()
        assert (found.speed_std[found.known] > 0).all()
        assert np.isfinite(found.prediction_std).all()


@pytest.mark.parametrize('stated', [
    [1e-7, 1e-7, 1e-4], [1e-7, 1e-7, 1e30], [1e-7, 1e-7, np.nan], [1e-7, 1e-7, np.inf],
    [1e-7, 1e-7, -1.0], [1e-7, 1e-7, 0.0], [1e-7, 1e-7, 1e-30]])
def test_what_is_stated_of_one_reading_spoils_no_other(stated):
    session, _ = experiment(0, 10.0)
    times, positions = session.tracks.grid()
    plain, odd = Estimator(CONDITIONS), Estimator(CONDITIONS)
    for estimator in (plain, odd):
        for t, field in zip(session.commands.t, session.commands.field, strict=True):
            estimator.command(t, field)
    for t, position in zip(times, positions, strict=True):
        expected = plain.update(t, [0, 1, 2], position, np.full(3, 1e-7))
        found = odd.update(t, [0, 1, 2], position, np.array(stated))
    off = np.abs(found.position - expected.position)[:2]
    assert (off < 0.5 * expected.position_std[:2, None]).all()
    np.testing.assert_allclose(found.position_std[:2], expected.position_std[:2], rtol=0.1)
    assert np.isfinite(found.position).all()
    assert np.hypot(*(found.position[2] - position[2])) < 1e-4


def test_fields_and_turns_beyond_all_coils_are_ignored_and_said():
    session, gain = experiment(0)
    estimator = Estimator(CONDITIONS)
    for field, frequency in (([1e300, 0], None), ([FIELD, 0], 1e300), ([0, -1e4], 1.0)):
        estimator.command(-1.0, field, frequency)
    estimates = replay(session, estimator)
    assert any('exceeds any coils' in text for text in estimates[0].diagnosis)
    np.testing.assert_allclose(estimates[-1].speed, np.abs(gain), rtol=0.12)
