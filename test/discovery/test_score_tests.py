"""Maps say where model and data part, and are silent where they do not."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from microbot_ros.common.records import Commands
from microbot_ros.discovery.check.input_checks import check_sessions
from microbot_ros.discovery.check.score_tests import (
    _holm,
    along_and_across,
    residual_maps,
    squared_floor,
)
from microbot_ros.discovery.hypotheses import fit_first_order
from microbot_ros.discovery.result import HORIZON
from microbot_ros.estimation.likelihood.joint import Whitening, eliminate_shared
from microbot_ros.virtual_rig.record_session import Camera


def maps_of(session):
    sessions, _ = check_sessions([session])
    return {m.against: m for m in residual_maps(fit_first_order(sessions))}


def test_holm_is_that_of_the_textbook():
    assert _holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert _holm([0.9, 0.8]) == [1.0, 1.0]


def test_statistics_are_chi_square_where_nothing_is_left(film):
    """Pooled over groups and sessions, by their probability integral."""
    values = []
    for seed in range(8):
        for name, m in maps_of(film(seed, duration=15.0)[0]).items():
            assert not m.fires, name
            if m.dof > 4:
                values.append(stats.chi2.sf(m.statistic, m.dof))
    assert len(values) > 50
    assert stats.kstest(values, 'uniform').pvalue > 1e-3


@given(st.integers(0, 10**6), st.integers(1, 4), st.integers(1, 5))
def test_products_along_and_across_are_those_of_both(seed, first, more):
    draws = np.random.default_rng(seed).normal(size=(2, 30, 3, first + more))
    every = draws[0] + 1j * draws[1]
    known, white = every[..., :first], every[..., first:]
    written_out = np.concatenate([known, white, 1j * white], axis=-1)
    expected = np.einsum('tna,tnb->nab', written_out.conj(), written_out).real
    np.testing.assert_allclose(along_and_across(known, white), expected, atol=1e-12)


@pytest.mark.parametrize('size', [0.0, 1e-160, 1e-120])
def test_a_parameter_that_does_next_to_nothing_takes_nothing_with_it(size):
    """As the place of a spot that nobody came near: squares of it can't be inverted."""
    draws = np.random.default_rng(1).normal(size=(50, 5)) * [1.0, 1.0, size, 1.0, 1.0]
    left = eliminate_shared(draws.T @ draws, 2)
    np.testing.assert_allclose(left, eliminate_shared(np.delete(np.delete(
        draws.T @ draws, 2, 0), 2, 1), 1), rtol=1e-12)


def test_maps_are_the_same_without_the_short_cut(film, monkeypatch):
    """Whitening what goes across as well, as where headings are noisy."""
    session, _ = film(3, count=3)
    short = maps_of(session)
    monkeypatch.setattr(Whitening, 'is_plain', False)
    for name, one in maps_of(session).items():
        assert one.dof == short[name].dof
        assert one.statistic == pytest.approx(short[name].statistic, rel=1e-7)


@pytest.mark.parametrize(('effect', 'parameters', 'against'), [
    ('poiseuille_flow', {'speed_um_s': 1.5, 'half_width_um': 60.0}, 'position'),
    ('speed_by_place', {'length_um': 150.0}, 'position, along the heading'),
    ('speed_by_heading', {'depth': 0.3}, 'heading'),
    ('lamp_change', {'time_s': 15.0, 'factor': 0.6}, 'time, along the heading'),
    ('settling_flow', {'wx_um_s': 1.5, 'wy_um_s': 0.5, 'tau_s': 8.0}, 'time'),
    ('alignment_lag', {'tau_s': 0.3}, 'time since switch'),
    ('heading_wobble', {'angle_rad': 0.5, 'frequency_hz': 0.7}, 'rhythm, along the heading'),
    ('periodic_drift', {'amplitude_um_s': 1.0, 'frequency_hz': 1.5}, 'rhythm'),
    ('stage_jump', {'time_s': 15.0, 'x_um': 3.0, 'y_um': 1.0}, 'single steps'),
])
def test_maps_fire_against_what_it_depends_on(film, effect, parameters, against):
    found = maps_of(film(20, {effect: parameters})[0])
    assert found[against].fires
    strongest = min(found.values(), key=lambda m: m.p_value)
    assert strongest.p_value == pytest.approx(found[against].p_value, abs=1e-12)


def test_a_step_that_lasts_shows_where_places_are_known_badly(film):
    """Half the reading error: no single frame shows it, the frames after it do together."""
    blurred = Camera(20.0, 0.0, 0.4e-6)
    for size, fires in ((0.9, True), (0.0, False)):
        session, _ = film(20, {'stage_jump': {'time_s': 15.0, 'x_um': size, 'y_um': 0.0}},
                          camera=blurred)
        assert maps_of(session)['single steps'].fires == fires


def test_frames_that_nobody_saw_make_no_step(film):
    """Of many particles at once: what the frames around a gap hold is not one particle's."""
    session, _ = film(23, count=20, duration=20.0, half_extent=400e-6,
                      camera=Camera(20.0, 0.0, 0.3e-6, dropped=0.1))
    assert maps_of(session)['single steps'].p_value > 0.05


def test_neighbours_show(film):
    session, _ = film(21, {'repulsion': {'speed_um_s': 8.0, 'range_um': 12.0}}, count=6,
                      half_extent=50e-6)
    assert maps_of(session)['neighbours'].fires


def test_curves_show_the_velocity_that_is_missing(film):
    session, _ = film(22, {'uniform_drift': {'wx_um_s': 1.0, 'wy_um_s': -0.5}}, duration=40.0)
    m = maps_of(session)['time']
    mean, spread = m.curves['x']
    assert len(m.middles) == len(mean) == len(spread)
    assert np.average(mean, weights=spread**-2) == pytest.approx(1e-6, rel=0.4)
    assert np.average(m.curves['y'][0]) < 0


def test_a_command_that_changes_with_every_row_has_no_switches(film):
    """A ramp of angles has none, steps have, also where each row says the command again."""
    session, _ = film(24)
    commands, t = session.commands, np.arange(0.0, 30.0, 0.05)
    again = Commands(t, commands.field_at(np.maximum(t, commands.t[0])))
    angle = 0.3 * t
    ramp = Commands(t, 5e-3 * np.stack([np.cos(angle), np.sin(angle)], axis=1))
    assert 'time since switch' in maps_of(replace(session, commands=again))
    assert 'time since switch' not in maps_of(replace(session, commands=ramp))


def test_the_size_of_what_is_left_does_not_grow_with_the_recording(film):
    """Evidence does: three times as long, it is more than twice as much."""
    short, long = (maps_of(film(
        8, {'poiseuille_flow': {'speed_um_s': 3.0, 'half_width_um': 120.0}},
        duration=duration)[0])['position'] for duration in (20.0, 60.0))
    assert long.statistic - long.dof > 2 * (short.statistic - short.dof)
    assert long.size == pytest.approx(short.size, rel=0.35)
    assert long.decides
    assert replace(long, size=0.05).fires
    assert not replace(long, size=0.05).decides


@pytest.mark.parametrize(('depth', 'frequency', 'decides'), [
    (0.5, 0.7, True), (0.5, 2.0, True), (0.08, 2.0, False)])
def test_a_rhythm_decides_if_it_moves_particles(film, depth, frequency, decides):
    """Speeds swing by a `depth`, which displaces by v·depth/πf over half a period at most."""
    session, bodies = film(20, {'pulsing_speed': {'depth': depth, 'frequency_hz': frequency}},
                           duration=120.0)
    fit = fit_first_order(check_sessions([session])[0])
    shown = {m.against: m for m in residual_maps(fit)}['rhythm, along the heading']
    assert shown.middles[shown.curves['power'][0].argmax()] == pytest.approx(frequency, abs=0.01)
    moved = np.sqrt((bodies['speed'] ** 2).mean()) * depth / (np.pi * frequency) / 2
    floor = np.sqrt(squared_floor(fit.session_fits[0], HORIZON))
    assert shown.size == pytest.approx(moved / floor, rel=0.2)
    assert shown.fires
    assert shown.decides == decides
