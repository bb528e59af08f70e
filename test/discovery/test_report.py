"""The report: what it says, that it stands alone, and that its band is the right width."""

from __future__ import annotations

import base64
import hashlib
import re
from dataclasses import replace

import numpy as np
import pytest

from microbot_ros.common.records import Tracks
from microbot_ros.discovery.discover import discover
from microbot_ros.discovery.report.drive import drive
from microbot_ros.discovery.report.figures import draw_bands, draw_places, embedded
from microbot_ros.discovery.report.page import digests, headline, page, write_report
from microbot_ros.discovery.report.prediction import predict
from microbot_ros.discovery.report.residual import by_place, residual
from microbot_ros.discovery.report.summary import summary
from microbot_ros.discovery.report.words import chance, interval, limit, listed, number, odds
from microbot_ros.discovery.result import Estimate, Limit, NextExperiment
from microbot_ros.model.effects import EFFECTS

DRIFT = {'uniform_drift': {'wx_um_s': 0.8, 'wy_um_s': -0.5}}


@pytest.fixture(scope='module')
def drifting(film):
    session, _ = film(11, DRIFT)
    return discover([session]), replace(session, name='<script>alert(1)</script>')


@pytest.fixture(scope='module')
def written(drifting, tmp_path_factory):
    """The folder of a report and of the data that it says it is of."""
    found, session = drifting
    folder = tmp_path_factory.mktemp('report')
    data = folder / 'session'
    data.mkdir()
    (data / 'tracks.csv').write_text('t_s,particle,x_um,y_um\n')
    write_report(folder, found, [session], [data])
    return folder


def test_the_report_stands_alone_and_says_what_was_found(written, drifting):
    found, session = drifting
    data, html = written / 'session', (written / 'report.html').read_text()
    icon, *pictures = re.findall(r'\b(?:src|href)\s*=\s*["\']?([^"\'\s>]*)', html)
    assert icon == 'data:,'  # none, so that no browser asks for /favicon.ico
    assert len(pictures) == 4
    assert all(a.startswith('data:image/svg+xml;base64,') for a in pictures)
    assert 'http' not in re.sub(r'base64,[^"]*', '', html)
    for said in (
        'uniform drift', interval('wx_um_s', found.effects[0].parameters['wx_um_s']),
        'Looked for and not found', 'µm/s', 'numpy',
        hashlib.sha256((data / 'tracks.csv').read_bytes()).hexdigest(),
    ):
        assert said in html, said
    assert html == page(found, [session], [data])


def test_what_people_call_things_can_not_break_the_page(written):
    html = (written / 'report.html').read_text()
    assert '<script>' not in html
    assert '&lt;script&gt;alert(1)' in html


def test_pictures_are_whole(written):
    for address in re.findall(r'base64,([^"]*)', (written / 'report.html').read_text()):
        picture = base64.b64decode(address).decode()
        assert picture.rstrip().endswith('</svg>')
        assert 'NaN' not in picture


def test_headlines_follow_the_verdict(drifting):
    found, _ = drifting
    named = headline(found)
    assert 'uniform drift' in named
    assert '±' in named
    assert 'ΔBIC' in named
    proxy = tuple(replace(e, status='proxy') for e in found.effects)
    left = tuple(replace(m, p_value=1e-6) for m in found.maps_after if m.against == 'position')
    unnamed = headline(replace(found, verdict='unnamed', effects=proxy, unexplained=left))
    assert 'depends on position (p = 1·10⁻⁶)' in unnamed
    assert 'can only stand in' in unnamed
    assert 'No effect was found' in headline(replace(found, verdict='consistent', effects=()))
    beside = headline(replace(
        found, verdict='unnamed', unexplained=left,
        effects=(*found.effects, replace(proxy[0], id='hot_spot'))))
    assert 'Established as well: uniform drift' in beside
    assert 'hot spot can only stand in' in beside
    hint = tuple(replace(e, status='suggested') for e in found.effects)
    assert 'hint of uniform drift' in headline(
        replace(found, verdict='consistent', effects=hint))


def test_the_summary_says_in_two_sentences_what_moves_particles_and_what_to_do(drifting):
    found, _ = drifting
    [drift] = found.effects
    gap = replace(found.gap, horizon=1.0, before=0.5e-6, after=0.1e-6)
    named = replace(found, gap=gap)
    left = tuple(replace(m, p_value=1e-6) for m in found.maps_after if m.against == 'position')
    nothing = replace(found, verdict='consistent', effects=())
    bounded = tuple(replace(one, limit=1e-6) for one in found.limits)
    unbounded = tuple(replace(one, limit=np.inf) if one.id == 'speed_decay' else one
                      for one in bounded)
    unnamed = replace(found, verdict='unnamed', unexplained=left, next_experiment=None)
    for case, first, second in (
            (named, 'lacks one effect: uniform drift (all particles drift at the same',
             'predictions 1 s ahead miss by 0.1 µm beyond the noise, in place of 0.5 µm'),
            (replace(named, effects=(replace(drift, indistinguishable_from=('linear_flow',)),)),
             'uniform drift', 'fits linear flow as well: record the experiment proposed below'),
            (replace(named, gap=replace(gap, before=np.nan)), 'uniform drift', 'Use model.yaml'),
            (replace(nothing, limits=bounded), 'diffusion explains this recording',
             'Effects below the limits'),
            (replace(nothing, limits=unbounded), 'diffusion explains this recording',
             'could not have shown speed decay'),
            (replace(nothing, effects=(replace(drift, status='suggested'),)),
             'apart from a weak sign of uniform drift', ''),
            (unnamed, 'no known effect explains; it depends on “position”', 'Do not rely on'),
            (replace(unnamed, next_experiment=NextExperiment('record steps', 5.0)),
             'it depends on “position”', 'yet: record steps.')):
        one, two = re.split(r'(?<=\.) (?=[A-Z])', summary(case))
        assert first in one
        assert second in two
        assert not re.search(r'BIC|log |p =|±', one + two)


@pytest.mark.soak
def test_the_band_holds_nine_in_ten_and_the_poorer_model_leaves_it(film):
    """Many starts of a quick simulation: inside is a mean over correlated positions."""
    found, session = (lambda s: (discover([s]), s))(film(21, DRIFT, count=4, duration=60.0)[0])
    prediction = predict(found, residual(found, session))
    assert 0.78 < prediction.inside <= 0.98
    assert replace(prediction, measured=prediction.without).inside < prediction.inside - 0.2
    assert prediction.measured.shape == (4, len(prediction.times), 2)


def test_the_band_counts_from_the_last_start_and_gaps_stay_gaps(drifting):
    found, session = drifting
    times, seen = session.tracks.grid()
    gone = (times > 5) & (times < 12)
    tracks = session.tracks
    first = tracks.particle == tracks.particles[0]
    torn = replace(session, tracks=tracks.rows(~(first & np.isin(tracks.t, times[gone]))))
    prediction = predict(found, residual(found, torn))
    missing = np.isin(prediction.times, times[gone])
    assert np.isnan(prediction.measured[0, missing]).all()
    assert np.isfinite(prediction.measured[1, missing]).all()
    again = prediction.times[~missing & (prediction.times > 10)][0]
    start = prediction.times == again
    assert (prediction.elapsed[0, start] == 0).all()
    assert (prediction.measured[0, start] == 0).all()
    assert seen.shape[1] == 3


def test_the_band_holds_how_well_speed_and_phi_are_known(drifting):
    """Until the first switch a particle is as far off as its velocity times the time."""
    found, session = drifting
    certain = replace(
        found, diffusion=Estimate.normal(0.0, 0.0), localisation=Estimate.normal(0.0, 0.0))
    left = residual(found, session)
    assert left.speed_std == pytest.approx([p.speed.std for p in found.baseline], rel=0.1)
    known = replace(left, speed_std=1e-7 * np.arange(1, len(left.names) + 1))
    prediction = predict(certain, known)
    straight = prediction.times < session.commands.t[1]
    for n, band in enumerate(prediction.band[:, straight]):
        expected = 1.645 * 1e-7 * (n + 1) * prediction.elapsed[n, straight]
        assert band == pytest.approx(expected, rel=1e-6, abs=1e-12)


def test_where_no_speed_is_known_no_band_is_drawn(drifting):
    """As beside an effect at a bound at which particles stop."""
    found, session = drifting
    left = residual(found, session)
    prediction = predict(found, replace(left, speed_std=np.full(3, np.inf)))
    assert np.isnan(prediction.band).all()
    assert np.isnan(prediction.inside)
    assert embedded(draw_bands(prediction)).startswith('data:image')
    nowhere = replace(left, found=np.full_like(left.found, np.nan))
    assert [len(one) for one in by_place(nowhere, nowhere.found)] == [0, 0, 0]


def test_predictions_start_anew_where_a_particle_jumps(drifting):
    found, session = drifting
    moved = session.tracks.position.copy()
    first = session.tracks.particle == session.tracks.particles[0]
    moved[first & (session.tracks.t > 17)] += 50e-6
    torn = replace(session, tracks=replace(session.tracks, position=moved))
    prediction = predict(found, residual(found, torn))
    jump = np.flatnonzero(prediction.times > 17)[0]
    assert prediction.elapsed[0, jump] == 0
    assert prediction.elapsed[1, jump] > 5
    assert np.nanmax(np.abs(prediction.measured[0])) < 20e-6


def test_particles_that_rest_are_drawn_in_their_one_place(drifting):
    """As where positions are rounded to pixels, and their mean is nearly nothing."""
    found, session = drifting
    left = residual(found, session)
    resting = replace(left, places=np.broadcast_to([2.4e-24, -1.7e-8], left.places.shape))
    assert embedded(draw_places(resting, found.diffusion.value)).startswith('data:image')


def test_arrows_of_a_drift_point_its_way_before_and_vanish_after(drifting):
    found, session = drifting
    left = residual(found, session)
    place, before, time = by_place(left, left.plain)
    _, after, _ = by_place(left, left.found)
    assert (time > 0).all()
    assert (place >= session.tracks.position.min(axis=0)).all()
    mean = (before * time[:, None]).sum(axis=0) / time.sum()
    # v and φ of the first-order model absorb some of it: commands do not average out exactly.
    assert mean == pytest.approx([0.8e-6, -0.5e-6], abs=0.3e-6)
    assert np.hypot(*(after * time[:, None]).sum(axis=0)) / time.sum() < 0.05e-6


def test_the_drive_of_rollers_is_told_by_frequency(film):
    """With a cut-in f_c the speed is √(f² − f_c²) at best: it falls short at low frequencies."""
    session, truth = film(15, {'drive_response': {'cut_in_hz': 0.9}}, rolling=True)
    found = discover([session])
    assert ('drive_response', 'established') in [(e.id, e.status) for e in found.effects]
    assert found.as_json()['baseline']['particles']['0']['gain_um_s_hz']['value'] > 0.5
    left = residual(found, session)
    told = drive(left, found.particles.phi, found.diffusion.value)
    assert told.frequency == pytest.approx(np.unique(session.commands.frequency), rel=1e-3)
    true = truth['gain'].mean()
    assert told.measured[-1] == pytest.approx(true, abs=4 * told.measured_std[-1] + 0.02 * true)
    assert told.measured[0] < 0.2 * true
    assert np.abs(told.found - told.measured).max() < np.abs(told.plain - told.measured).max() / 3
    assert 'Speed over frequency' in page(found, [session], [])


def test_particles_that_were_left_out_are_not_drawn(drifting):
    """Such as one pressed against a wall, seen before all others: it shifts no clock."""
    found, session = drifting
    t = session.tracks
    held = t.of(t.particles[0])
    shifted = replace(session, commands=replace(session.commands, t=session.commands.t + 2),
                      tracks=Tracks(*(np.concatenate([a, b]) for a, b in (
                          (held.t, t.t + 2), (held.particle + 99, t.particle),
                          (held.position, t.position), (held.theta, t.theta),
                          (held.sigma, t.sigma)))))
    left, without = residual(found, shifted), residual(found, session)
    np.testing.assert_allclose(left.found, without.found, atol=1e-12)
    np.testing.assert_allclose(left.times, without.times, atol=1e-12)
    assert 'particle 99' not in page(found, [shifted], [])


def test_broken_tracks_are_drawn_to_their_end(drifting):
    found, session = drifting
    t = session.tracks
    at = (t.t[0] + t.t[-1]) / 2
    later = t.t > at + 0.3
    named = replace(t, particle=np.where(later, t.particle + 50, t.particle))
    broken = replace(session, tracks=named.rows((t.t < at) | later))
    left = residual(found, broken).found
    assert left.shape[1:] == (len(t.particles), 2)
    assert np.isfinite(left[-1]).all()


def test_lists_are_read_aloud():
    assert listed(['hot_spot']) == 'hot spot'
    assert listed(['hot_spot', 'linear_flow', 'trap']) == 'hot spot, linear flow and trap'


@pytest.mark.parametrize(('x', 'said'), [
    (0.034, '0.034'), (1.0, '1'), (4.2e-9, '4.2·10⁻⁹'), (4e-9, '4·10⁻⁹'), (0.0, '0'),
    (-123456.0, '−1.2·10⁵'), (6.6e10, '6.6·10¹⁰'), (-3.0, '−3'), (1234.0, '1234'), (np.nan, '–'),
    (np.inf, 'beyond computing'),
])
def test_numbers(x, said):
    assert number(x) == said


def test_a_chance_too_small_to_compute_is_bounded():
    assert chance(0.0) == chance(9.7e-305) == 'p < 10⁻³⁰⁰'
    assert odds(700.0) == 'more than 10³⁰⁰ times'
    assert odds(np.log(42.0)) == '42 times'
    assert chance(0.02) == 'p = 0.02'


@pytest.mark.parametrize(('name', 'value', 'std', 'said'), [
    ('wx_um_s', 4.13e-7, 3.1e-8, '0.413 ± 0.061 µm/s'),
    ('delay_s', -0.02, 0.001, '−0.0200 ± 0.0020 s'),
    ('gain_ratio', 1.1, np.nan, '1.1'), ('tau_s', np.inf, 1.0, '–'),
    ('tau_s', 120.0, 60.0, '120 ± 118 s'), ('tau_s', 5.1e-4, 5e-5, '(5.10 ± 0.98)·10⁻⁴ s'),
    ('phi_rad', 1.0, 0.0, '1 rad'), ('cut_in_hz', -2e-10, 2.6e-9, '(−0.2 ± 5.1)·10⁻⁹ Hz'),
])
def test_intervals(name, value, std, said):
    assert interval(name, Estimate.normal(value, std)) == said


def test_interval_that_is_not_even_is_told_by_its_ends():
    assert interval('field_scale_mT', Estimate(2.2e-3, 4e-4, 1.5e-3, 4.3e-3)) == (
        '2.2 (1.5 to 4.3) mT')
    assert interval('tau_s', Estimate(120.0, 60.0, 70.0, np.inf)) == '120 (70 to ∞) s'


@pytest.mark.parametrize(('effect', 'name', 'value', 'said'), [
    ('uniform_drift', 'wx_um_s', 1.2e-7, 'up to 0.12 µm/s'),
    ('speed_decay', 'tau_s', 2590.0, '2590 s or longer'),
    ('dipole_interaction', 'strength_um5_s', 1.4e-24, 'up to 1.4·10⁶ µm⁵/s'),
    ('coil_gain_mismatch', 'gain_ratio', 1.03, 'within 1 ± 0.03'),
    ('uniform_drift', 'wx_um_s', np.nan, 'not bounded by these data'),
])
def test_limits(effect, name, value, said):
    parameter = next(p for p in EFFECTS[effect].parameters() if p.name == name)
    assert limit(Limit(effect, parameter, value)) == said


def test_files_are_hashed_as_sha256sum_does(tmp_path):
    folder = tmp_path / 'run'
    folder.mkdir()
    (folder / 'tracks.csv').write_bytes(b'abc')
    (folder / 'notes.txt').write_bytes(b'not data')
    known = 'ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad'
    assert digests(folder) == [('run/tracks.csv', known)]
    assert digests(folder / 'tracks.csv') == [('tracks.csv', known)]


@pytest.mark.parametrize(('effect', 'name', 'value', 'lower', 'upper'), [
    ('uniform_drift', 'wx_um_s', 1.2e-7, None, 0.12),
    ('speed_decay', 'tau_s', 2590.0, 2590, None)])
def test_a_limit_from_below_is_no_upper_limit(effect, name, value, lower, upper):
    parameter = next(p for p in EFFECTS[effect].parameters() if p.name == name)
    found = Limit(effect, parameter, value).as_json()
    assert found == {'id': effect, 'parameter': name, 'lower_limit_95': pytest.approx(lower),
                     'upper_limit_95': pytest.approx(upper)}
