"""From hidden effect to verdict: named, unnamed, consistent, and what is written."""

import json
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from schemas import conforming

from microbot_ros.cli.discover.discover import command
from microbot_ros.common.errors import InputError
from microbot_ros.discovery.discover import discover
from microbot_ros.model.io.model_file import read_model
from microbot_ros.session import write_session


@pytest.fixture(scope='module')
def consistent(film):
    return discover([film(10)[0]])


def test_nothing_missing_is_consistent(consistent):
    assert consistent.verdict == 'consistent'
    assert consistent.effects == ()
    assert consistent.model.effects == ()
    assert consistent.unexplained == ()
    assert consistent.gap.before < consistent.gap.floor
    drift = [limit for limit in consistent.limits if limit.id == 'uniform_drift']
    assert 0 < max(limit.limit for limit in drift) < 1e-6


def test_named_with_parameters_and_the_gap_shrinks(film):
    truth = {'wx_um_s': 0.6, 'wy_um_s': -0.4}
    found = discover([film(11, {'uniform_drift': truth})[0]])
    assert found.verdict == 'named'
    effect, = found.effects
    assert effect.status == 'established'
    for name, value in truth.items():
        estimate = effect.parameters[name]
        assert abs(estimate.value * 1e6 - value) < 4 * estimate.std * 1e6 < 0.3
    assert effect.delta_bic > 100
    assert effect.log_evidence > 50
    assert found.gap.before > 0.4e-6
    assert found.gap.after < 0.5 * found.gap.before
    assert found.learned == () == found.model.learned
    assert any(m.fires for m in found.maps_before)
    assert not any(m.fires for m in found.maps_after)


def test_two_at_once_are_both_named(film):
    hidden = {'speed_decay': {'tau_s': 40.0}, 'coil_misalignment': {'skew_rad': 0.25}}
    found = discover([film(12, hidden)[0]])
    assert found.verdict == 'named'
    assert {e.id for e in found.effects if e.status == 'established'} == set(hidden)


@pytest.mark.parametrize(('effect', 'parameters', 'against'), [
    ('speed_by_heading', {'depth': 0.15}, 'heading'),
    pytest.param('pulsing_speed', {'depth': 0.5, 'frequency_hz': 0.7},
                 'rhythm, along the heading', marks=pytest.mark.soak),
])
def test_what_no_entry_explains_is_unnamed(film, effect, parameters, against):
    found = discover([film(14, {effect: parameters})[0]])
    assert found.verdict == 'unnamed'
    assert against in [m.against for m in found.unexplained]
    assert not any(e.status == 'established' for e in found.effects)


@pytest.mark.parametrize(('hidden', 'verdict'), [
    ({}, 'consistent'), ({'uniform_drift': {'wx_um_s': 0.8, 'wy_um_s': -0.5}}, 'named')])
def test_a_stage_that_is_touched_decides_nothing(film, hidden, verdict):
    """It is told, and what is missing is named beside it."""
    touched = {'stage_jump': {'time_s': 15.0, 'x_um': 3.0, 'y_um': 1.0}}
    found = discover([film(14, touched | hidden)[0]])
    assert found.verdict == verdict
    assert [e.id for e in found.effects if e.status == 'established'] == list(hidden)
    assert any('3 steps are longer than the motion before' in r for r in found.remarks)


def test_several_sessions_are_explained_together(film):
    drift = {'uniform_drift': {'wx_um_s': 0.25, 'wy_um_s': 0.0}}
    sessions = [film(seed, drift, duration=20.0)[0] for seed in (16, 17)]
    one, other, both = (discover(some) for some in (sessions[:1], sessions[1:], sessions))
    assert [e.id for e in both.effects] == ['uniform_drift']
    assert len(both.baseline) == 6
    wx, *alone = (f.effects[0].parameters['wx_um_s'] for f in (both, one, other))
    assert abs(wx.value - 0.25e-6) < 3 * wx.std
    # Two independent estimates of the same drift: variances combine by their inverses.
    assert 1 / wx.std**2 == pytest.approx(sum(1 / each.std**2 for each in alone), rel=0.2)
    assert both.effects[0].delta_bic > max(f.effects[0].delta_bic for f in (one, other))


def test_json_is_complete_and_finite(consistent):
    content = conforming(
        'discovery/verdict', json.dumps(consistent.as_json(), allow_nan=False))
    particle = content['baseline']['particles']['0']
    assert particle['force_pN']['value'] == pytest.approx(
        6 * np.pi * 1.245 * 4.6e-3 * particle['v_um_s']['value'], rel=1e-6)


def test_command_writes_a_model_that_can_be_loaded(film, tmp_path):
    session, _ = film(18, {'speed_decay': {'tau_s': 20.0}})
    write_session(tmp_path / 'session', session)
    result = CliRunner().invoke(command, [
        str(tmp_path / 'session'), '--out', str(tmp_path / 'out'),
        '--json', str(tmp_path / 'copy.json')])
    assert result.exit_code == 0, result.output
    assert 'speed_decay' in result.stdout
    content = json.loads((tmp_path / 'out' / 'result.json').read_text())
    assert content == json.loads((tmp_path / 'copy.json').read_text())
    model, particles = read_model(tmp_path / 'out' / 'model.yaml')
    value = content['effects'][0]['parameters']['tau_s']['value']
    assert model.effect('speed_decay').tau == pytest.approx(value)
    assert len(particles.ids) == 3


def test_bad_files_are_told_in_one_line_and_leave_nothing_behind(film, tmp_path):
    session, _ = film(19, duration=5.0)
    tracks = replace(session.tracks, position=1000 * session.tracks.position)
    write_session(tmp_path / 'session', replace(session, tracks=tracks))
    with pytest.raises(InputError, match='positions in µm') as told:
        CliRunner().invoke(command, [
            str(tmp_path / 'session'), '--out', str(tmp_path / 'out')], catch_exceptions=False)
    assert 'session' in str(told.value)
    assert '\n' not in str(told.value)
    assert not (tmp_path / 'out').exists()


def exchanged(session, at):
    """Two tracks confused at a time [s]."""
    tracks = session.tracks
    late = (tracks.t > at) & (tracks.particle < 2)
    particle = np.where(late, 1 - tracks.particle, tracks.particle)
    order = np.lexsort((particle, tracks.t))
    return replace(session, tracks=replace(
        tracks, particle=particle[order], position=tracks.position[order]))


@pytest.mark.soak
def test_one_swap_of_identities_costs_no_name(film):
    session, _ = film(50, {'uniform_drift': {'wx_um_s': 0.6, 'wy_um_s': 0.0}}, duration=60.0)
    found = discover([exchanged(session, 30.0)])
    assert found.verdict == 'named'
    assert [(e.id, e.status) for e in found.effects] == [('uniform_drift', 'established')]
    assert not found.unexplained
    assert any('exchange places at 30.05 s' in remark for remark in found.remarks)
    drift = found.effects[0].parameters['wx_um_s']
    assert drift.low < 0.6e-6 < drift.high


def test_a_swap_of_unlike_particles_stands_in_for_nothing(film):
    """One fit for both halves of each track would find that speeds and angles change."""
    session, truth = film(51, duration=60.0)
    found = discover([exchanged(session, 30.0)])
    assert found.verdict == 'consistent'
    assert not found.effects
    for particle, speed in zip(found.baseline, truth['speed'], strict=True):
        assert particle.speed.low < speed < particle.speed.high


@pytest.mark.soak
def test_a_name_holds_beside_a_little_of_another_kind(film):
    """A deadband in which the speed depends on where particles face, by 5 %."""
    session, _ = film(53, {'amplifier_deadband': {'deadband_mT': 2.1},
                           'speed_by_heading': {'depth': 0.05}},
                      duration=60.0, levels=(2.5e-3, 3.5e-3, 5e-3))
    found = discover([session])
    assert found.verdict == 'named'
    assert [(e.id, e.status) for e in found.effects] == [('amplifier_deadband', 'established')]
    assert found.unexplained[0].against == 'heading'
    assert found.gap.after < 0.1 * found.gap.before
    assert 'small beside' in ' '.join(found.sentences())
