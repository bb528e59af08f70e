"""The batch fit on simulated and real recordings, beside the paper's recipe."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from filmed import CONDITIONS, FIELD, swimmers
from oracles import sliding_near_a_wall

from microbot_ros.common.errors import InputError
from microbot_ros.common.records import Commands, Conditions, Session, Tracks
from microbot_ros.estimation import report
from microbot_ros.estimation.batch import fit
from microbot_ros.estimation.likelihood.excitation import _information, command_excitation
from microbot_ros.estimation.likelihood.noise import Noise, whiten
from microbot_ros.estimation.one_leg_regression import one_leg
from microbot_ros.model.physics.particle import Fluid, translational_diffusion
from microbot_ros.session import read_session
from microbot_ros.virtual_rig.record_session import Camera

ROLLING = Path(__file__).parents[2].parent / 'shared' / 'data' / 'rolling_robot'


def experiment(seed, hidden=None, seconds=30.0):
    return swimmers(seed, seconds, Camera(20.0, 0.0, 0.1e-6, 0.05), hidden=hidden)


def test_everything_comes_out_within_its_spread():
    off = []
    for seed in range(6):
        session, gain = experiment(seed)
        result = fit(session)
        off += list((result.polar.speed - np.abs(gain)) / result.polar.speed_std)
        off += list(np.angle(np.exp(1j * result.polar.phi) / gain) / result.polar.phi_std)
        assert result.noise.diffusion == pytest.approx(
            translational_diffusion(Fluid(1.245e-3), 4.6e-6), abs=4 * result.noise.diffusion_std)
        assert result.noise.localisation == pytest.approx(0.1e-6, rel=0.1)
        assert not [text for text in result.warnings if 'Stokes' in text or 'too large' in text]
    # 36 deviates: their root mean square strays by 0.12.
    assert 0.65 < np.sqrt(np.mean(np.square(off))) < 1.4


def near_a_floor(height, told):
    """A session above a floor, whose `session.yaml` tells a height (or None), and its speeds."""
    session, gain = swimmers(5, 60.0, Camera(20.0, 0.0, 0.05e-6, 0.0), height=height,
                             known=replace(CONDITIONS, height=told))
    return session, np.abs(gain)


@pytest.mark.parametrize('height', [4.7e-6, 5.2e-6, 9e-6])
def test_a_floor_is_named_where_nobody_stated_it(height):
    exact = sliding_near_a_wall(height, 4.6e-6)
    session, speed = near_a_floor(height, None)
    found = fit(session)
    said, = (text for text in found.warnings if 'Stokes' in text)
    assert 'far from walls: the particles probably move near a floor' in said
    guessed = float(re.search(r'A centre ([0-9.]+) µm above it', said)[1]) * 1e-6
    # A spread of D that is known moves the height, by as much as it moves the drag.
    spread = 4 * found.noise.diffusion_std / found.noise.diffusion * exact
    assert abs(sliding_near_a_wall(guessed, 4.6e-6) - exact) < spread
    assert found.force == pytest.approx(6 * np.pi * 1.245e-3 * 4.6e-6 * speed, rel=0.08)


@pytest.mark.parametrize('height', [4.7e-6, 5.2e-6, 9e-6])
def test_where_the_floor_is_stated_force_and_diffusion_are_those_above_it(height):
    exact = sliding_near_a_wall(height, 4.6e-6)
    session, speed = near_a_floor(height, height)
    found = fit(session)
    assert not [text for text in found.warnings if 'Stokes' in text]
    assert found.force == pytest.approx(6 * np.pi * 1.245e-3 * 4.6e-6 * speed * exact, rel=0.08)


@pytest.mark.parametrize(('conditions', 'said'), [
    # ten times the drag: nearer than surfaces come
    (Conditions(radius=4.6e-7, viscosity=1.245e-3),
     'far from walls: radius or viscosity are wrong'),
    (Conditions(radius=9.2e-6, viscosity=1.245e-3), 'Otherwise radius or viscosity are wrong'),
    (Conditions(radius=4.6e-6, viscosity=1.245e-3, height=4.7e-6),
     'Otherwise height, radius or viscosity are wrong'),
    (Conditions(radius=4.6e-6, viscosity=1.245e-3, height=4.7e-6),
     '4.7 µm above a floor: the model lacks an effect that moves the particles'),
])
def test_a_floor_is_not_blamed_for_what_it_does_not_do(conditions, said):
    session, _ = experiment(0)
    warning, = (text for text in fit(replace(session, conditions=conditions)).warnings
                if 'Stokes' in text)
    assert said in warning
    assert 'most likely' not in warning


def test_a_delay_is_used_only_where_the_data_demand_it():
    session, gain = experiment(1, ('command_delay', {'delay_s': 0.2}))
    late = fit(session)
    assert late.delay.value == pytest.approx(0.2, abs=4 * late.delay.std)
    np.testing.assert_allclose(late.polar.speed, np.abs(gain), rtol=0.06)
    assert fit(experiment(1)[0]).delay.value == 0.0


def test_the_recipe_is_a_regression_over_the_longest_leg():
    session, _ = experiment(2)
    leg = one_leg(session)[0]
    track = session.tracks.of(0)
    inside = (track.t >= leg.start) & (track.t <= leg.end)
    slope = np.polyfit(track.t[inside], track.position[inside], 1)[0]
    assert leg.speed == pytest.approx(np.hypot(*slope))
    u = session.commands.field_at(leg.start)
    turned = np.arctan2(slope[1], slope[0]) - np.arctan2(u[1], u[0])
    assert np.exp(1j * leg.phi) == pytest.approx(np.exp(1j * turned))
    lengths = np.diff(np.append(session.commands.t, track.t[-1]))
    assert leg.end - leg.start == pytest.approx(lengths.max(), abs=0.2)


def test_a_jump_is_left_out_and_said():
    session, gain = experiment(3)
    moved = session.tracks.position + 40e-6 * (session.tracks.t > 15)[:, None]
    tracks = Tracks(session.tracks.t, session.tracks.particle, moved, session.tracks.theta,
                    session.tracks.sigma)
    result = fit(Session(tracks, session.commands, session.conditions))
    np.testing.assert_allclose(result.polar.speed, np.abs(gain), rtol=0.08)
    assert sum('too large for diffusion' in text for text in result.warnings) == 3


def test_a_broken_track_is_one_particle():
    session, gain = experiment(3)
    tracks, lost = session.tracks, np.abs(session.tracks.t - 15) < 0.2
    tracks = tracks.rows(~lost | (tracks.particle > 0))
    named = np.where((tracks.particle == 0) & (tracks.t > 15), 7, tracks.particle)
    order = np.lexsort((named, tracks.t))
    broken = replace(session, tracks=replace(tracks, particle=named).rows(order))
    result, whole = fit(broken), fit(session)
    assert list(result.ids) == list(whole.ids)
    assert len(result.legs) == len(whole.legs)
    np.testing.assert_allclose(result.polar.speed, np.abs(gain), rtol=0.08)
    assert any('joined (7 to 0)' in text for text in result.warnings)


def test_without_commands_there_is_noise_but_no_speed():
    session, _ = experiment(4, seconds=8.0)
    result = fit(Session(session.tracks, Commands(np.empty(0), np.empty((0, 2))), CONDITIONS))
    assert np.isnan(result.polar.speed).all()
    assert any('nothing was driven' in text for text in result.warnings)
    content = report.as_json(result)
    unknown = {'value': None, 'std': None}
    assert content['delay_s'] == unknown
    assert content['particles']['0']['v_um_s'] == content['particles']['0']['phi_rad'] == unknown
    json.dumps(content, allow_nan=False)


@pytest.mark.parametrize(('degrees', 'open_pairs', 'told'), [
    (np.arange(0, 360, 2), {('φ', 'delay')}, 'both ways'),
    (np.r_[np.arange(0, 180, 2), np.arange(180, 0, -2)], set(), ''),
    ([0, 120, 240, 0], set(), ''),
    ([40], {('φ', 'drift'), ('speed', 'drift')}, 'other directions'),
    ([], set(), 'nothing was driven')])
def test_what_commands_leave_open_is_known_before_any_fit(degrees, open_pairs, told):
    """Steps tell φ from a delay whichever way they turn, a steady turn does not."""
    t, angle = np.arange(180) / 30, np.radians(degrees)
    tracks = Tracks(t, np.zeros(180, int), np.zeros((180, 2)), np.full(180, np.nan),
                    np.full(180, np.nan))
    field = FIELD * np.column_stack([np.cos(angle), np.sin(angle)])
    commands = Commands(np.linspace(-1, 6, len(angle), endpoint=False), field)
    excited = command_excitation(Session(tracks, commands, CONDITIONS))
    assert set(excited.pairs) == open_pairs
    assert excited.driven == (len(degrees) > 0)
    assert told in ' '.join(excited.sentences)
    assert command_excitation(Session(tracks.rows(slice(1)), commands)) is None


def test_too_little_is_an_input_error():
    tracks = Tracks(np.array([0.0, 0.1]), np.zeros(2, int), np.zeros((2, 2)), *np.zeros((2, 2)))
    with pytest.raises(InputError, match='at least 4 frames'):
        fit(Session(tracks, Commands(np.empty(0), np.empty((0, 2))), CONDITIONS, 'short'))


@pytest.mark.skipif(not ROLLING.is_dir(), reason='the recording of a rolling robot is not here')
def test_the_rolling_robot():
    result = fit(read_session(ROLLING))
    fast = [one for one in result.gains if one.frequency >= 10]
    weight = np.array([one.std**-2 for one in fast])
    mean = (weight * np.array([one.gain for one in fast])).sum() / weight.sum()
    assert abs(mean) * 1e6 == pytest.approx(3.0, abs=0.1)
    assert np.degrees(result.polar.phi[0]) == pytest.approx(-14, abs=1)
    assert any('φ and delay cannot be distinguished' in text for text in result.warnings)
    assert any('gain is not constant in frequency' in text for text in result.warnings)
    assert np.isnan(result.force).all()
    assert 'gain_um_s_hz' in report.as_json(result)['particles']['0']
    assert 'gain_by_frequency' not in report.as_json(result)


@pytest.mark.parametrize('exposure', [0.0, 0.01])
def test_what_commands_tell_is_what_the_whitening_of_positions_leaves(exposure):
    """The information by a tridiagonal covariance of increments, and by the filter of the fit."""
    rng = np.random.default_rng(4)
    interval = rng.uniform(0.02, 0.1, 60)
    steps = rng.normal(size=(60, 3)) + 1j * rng.normal(size=(60, 3))
    noise = Noise(1e-13, 5e-8, exposure)
    paths = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    white = whiten(paths[:, None], np.r_[0.0, np.cumsum(interval)], noise)[:, 0]
    assert _information(steps, interval, noise) == pytest.approx(np.real(white.conj().T @ white))
