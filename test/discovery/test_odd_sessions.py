"""Odd sessions from search to result and report: no crash, no `nan` in a sentence."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from microbot_ros.discovery.check.input_checks import check_sessions
from microbot_ros.discovery.discover import discover
from microbot_ros.discovery.intervals import Intervals
from microbot_ros.discovery.report.figures import embedded
from microbot_ros.discovery.report.learned import draw_learned
from microbot_ros.discovery.report.page import page
from microbot_ros.discovery.report.prediction import predict
from microbot_ros.discovery.report.residual import residual
from microbot_ros.discovery.result import Learned, NamedEffect
from microbot_ros.estimation.likelihood.joint import Whitening
from microbot_ros.estimation.likelihood.model_fit import evaluate, fit_noise, maximise
from microbot_ros.estimation.likelihood.prepared_session import predictable_part
from microbot_ros.model.effects import EFFECTS
from microbot_ros.model.io.model_file import read_model, write_model
from microbot_ros.model.learned_term import AXES, COVARIATES, VALUES, LearnedTerm
from microbot_ros.model.model import Model, ParticleParameters
from microbot_ros.virtual_rig.record_session import Camera

THIRTY, TEN = (Camera(rate, 0.0, 0.1e-6) for rate in (30.0, 10.0))


def kept(session, rows):
    """Return the `session` with some `rows` (M,) bool of its tracks."""
    return replace(session, tracks=session.tracks.rows(rows))


def later(session, seconds):
    """Return the `session` on a clock that began so many `seconds` earlier."""
    return replace(session, tracks=replace(session.tracks, t=session.tracks.t + seconds),
                   commands=replace(session.commands, t=session.commands.t + seconds))


def _one_roller(film):
    return film(11, {'drive_response': {'cut_in_hz': 0.9}}, count=1, duration=12.0, camera=TEN,
                rolling=True)[0]


def _lag_in_thirds(film):
    return later(film(3, {'alignment_lag': {'tau_s': 0.39}}, count=2, duration=15.0,
                      camera=THIRTY)[0], 0.1)


def _come_and_go(film):
    session = film(5, {'uniform_drift': {'wx_um_s': 3.0, 'wy_um_s': 1.0}}, duration=12.0,
                   camera=TEN)[0]
    t, particle = session.tracks.t, session.tracks.particle
    return kept(session, (t > 8 * (particle == 1)) & (t < 12 - 5 * (particle == 2)))


def _parted_with_breaks(film):
    session = film(6, duration=12.0, camera=TEN)[0]
    t, particle = session.tracks.t, session.tracks.particle
    parted = kept(session, (t * 7 + particle).astype(int) % 5 < 3)
    return replace(parted, breaks=np.array([2.0, 4.0, 4.1, 9.95]))


def _jumps(film):
    """Steps of 30 µm; the speed of every particle ends unknown beside what they feign."""
    session, rng = film(7, duration=15.0, camera=TEN)[0], np.random.default_rng(0)
    t, position = session.tracks, session.tracks.position.copy()
    for _ in range(6):
        one, when = rng.choice(t.particles), rng.uniform(t.t[0], t.t[-1])
        position[(t.particle == one) & (t.t > when)] += rng.normal(0, 30e-6, 2)
    return replace(session, tracks=replace(t, position=position))


def _slower_some_ways(film):
    return film(4, {'speed_by_heading': {'depth': 0.6}}, duration=20.0, camera=TEN)[0]


def _channel(film):
    return film(3, {'poiseuille_flow': {'speed_um_s': 6.0, 'half_width_um': 120.0}},
                duration=20.0, camera=TEN)[0]


def _dark_in_between(film):
    session = film(13, count=2, duration=14.0, camera=TEN)[0]
    on = np.arange(len(session.commands.t)) % 3 > 0
    return replace(session, commands=replace(
        session.commands, field=session.commands.field * on[:, None]))


@pytest.mark.parametrize('odd', [
    _one_roller, _come_and_go, *(pytest.param(one, marks=pytest.mark.soak) for one in (
        _lag_in_thirds, _parted_with_breaks, _jumps, _slower_some_ways, _channel,
        _dark_in_between))])
def test_from_search_to_report(film, odd):
    session = odd(film)
    found = discover([session])
    text = json.dumps(found.as_json(), allow_nan=False)
    html = re.sub(r'base64,[^"]*', '', page(found, [session], []))
    assert not re.search(r'\b(nan|inf)\b', ' '.join([text, html, *found.sentences()]), re.I)


@pytest.fixture(name='swimmers', scope='module')
def swimmers_fixture(film):
    """Two of them, one with a gap, at times that no binary fraction holds."""
    session = later(film(8, count=2, duration=10.0, camera=THIRTY)[0], 0.1)
    t, particle = session.tracks.t, session.tracks.particle
    return kept(session, (t < 3) | (t > 3.7) | (particle > 0))


@pytest.fixture(name='judged', scope='module')
def judged_fixture(swimmers):
    """The result of a search, of which the tests exchange the model."""
    return discover([kept(swimmers, swimmers.tracks.t < 5)])


@pytest.mark.parametrize('end', ['low', 'high'])
@pytest.mark.parametrize('name', EFFECTS)
def test_an_effect_at_its_bound(film, swimmers, judged, tmp_path, name, end):
    """A gain ratio of 0.19999999999999996 was once below its bound of 0.2, and an interval that
    reached beyond infinity ended at the other bound.
    """
    session = swimmers if name != 'drive_response' else film(
        11, duration=8.0, camera=TEN, rolling=True)[0]
    prepared, _ = check_sessions([session])
    effect = EFFECTS[name](**{p.field: getattr(p, end) for p in EFFECTS[name].parameters()})
    model = Model.baseline(session.conditions, prepared[0].commands).with_effect(effect)
    part = predictable_part(prepared[0], model)
    fit = fit_noise(evaluate(model, [part], [Whitening(part.interval)]))
    known, last = Intervals(fit, complete=False), fit.session_fits[0]
    entry = NamedEffect(name, 'suggested', known.effect(name), 1.0, 2.0, 0.1)
    json.dumps(entry.as_json(), allow_nan=False)
    assert 'nan' not in entry.sentence()
    main = last.session.main
    particles = ParticleParameters.from_velocity_phasor(
        last.session.ids[main], last.velocity_phasor[main])
    back = fit.model.with_vector(fit.model.vector())
    write_model(tmp_path / 'model.yaml', back, particles)
    assert read_model(tmp_path / 'model.yaml')[0] == back
    for p, value in back.effect(name).values().items():
        assert p.low <= value <= p.high
    for estimate in Intervals(maximise(fit)).effect(name).values():
        estimate.as_json('x')
        assert not estimate.low > estimate.value
        assert not estimate.high < estimate.value
    found = replace(judged, model=model, diffusion=known.diffusion(),
                    localisation=known.localisation(), particles=particles)
    prediction = predict(found, residual(found, session))
    assert np.isfinite(prediction.measured).any()


def _kinds():
    for against in COVARIATES:
        for frame, acts_on in VALUES:
            if (frame == 'radial') == (against == 'neighbour distance'):
                yield against, frame, acts_on


@pytest.mark.parametrize(('against', 'frame', 'acts_on'), list(_kinds()))
@pytest.mark.parametrize('size', [-1.0, 1e-3])
def test_a_learned_term_of_any_kind(swimmers, judged, against, frame, acts_on, size):
    """A factor of −1 stops the particles; a term against heading needs φ of them."""
    axes = (np.linspace(-3.0, 3.0, 4),) * len(AXES[against])
    values = np.full((4 ** len(axes), len(VALUES[frame, acts_on])),
                     size * (1e-3 if acts_on == 'velocity' else 1.0))
    seen = np.arange(len(values)) == 1
    term = LearnedTerm(against, frame, acts_on, axes, values, values, values, seen)
    found = replace(judged, model=replace(judged.model, effects=(), learned=(term,)))
    assert np.isfinite(predict(found, residual(found, swimmers)).measured).any()
    learned = Learned(term, '', 9.0, {})
    assert 'nan' not in json.dumps(learned.as_json(np.nan), allow_nan=False)
    if against in ('position', 'heading', 'neighbour distance'):
        assert embedded(draw_learned(term)).startswith('data:image')
