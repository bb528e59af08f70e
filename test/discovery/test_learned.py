"""Terms that are learned where no effect has a name: evidence, curve, formula, band, gap."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from microbot_ros.discovery.check.input_checks import check_sessions
from microbot_ros.discovery.discover import discover
from microbot_ros.discovery.hypotheses import fit_first_order
from microbot_ros.discovery.learned.candidates import accumulated, candidates, steps
from microbot_ros.discovery.learned.curve import Curve, Kernel, kernels
from microbot_ros.discovery.learned.grammar import fit as fit_formula
from microbot_ros.discovery.learned.grammar import grammar
from microbot_ros.discovery.learned.learn import (
    finish,
    learn_term,
    learn_terms,
    relearn,
    told,
    with_terms,
)
from microbot_ros.discovery.learned.moments import FOLDS, Moments, _folds, whiten_track
from microbot_ros.discovery.result import Learned
from microbot_ros.model.io.model_file import read_model, write_model
from microbot_ros.model.learned_term import LearnedTerm
from microbot_ros.virtual_rig.record_session import Camera

CHANNEL = {'poiseuille_flow': {'speed_um_s': 3.0, 'half_width_um': 120.0}}


def baseline(session):
    return fit_first_order(check_sessions([session])[0])


@pytest.fixture(name='channel', scope='module')
def channel_fixture(film):
    session, _ = film(3, CHANNEL, count=4, duration=40.0)
    return baseline(session)


@pytest.fixture(name='first', scope='module')
def first_fixture(channel):
    return learn_term(channel)


@pytest.fixture(name='findings', scope='module')
def findings_fixture(channel, first):
    return learn_terms(channel, first)


def moments_of(fit, against, acts_on):
    known = told(fit)
    (table,) = (one for one in candidates(known)
                if (one.against, one.acts_on) == (against, acts_on))
    return Moments.of(known, table, [p.diffusion for p in known.session_fits])


# Covariate and frame -----------------------------------------------------------------------------

def test_a_flow_of_place_is_learned_as_one(findings, channel):
    first = findings[0]
    assert (first.term.against, first.term.acts_on) == ('position', 'velocity')
    assert first.odds['position', 'laboratory', 'velocity'] > 0.9
    assert sum(first.odds.values()) == pytest.approx(1)
    better = with_terms(channel, findings)
    assert better.log_likelihood > channel.log_likelihood + 20


def test_what_faces_some_ways_is_slower_and_learned_against_the_heading(film):
    session, _ = film(4, {'speed_by_heading': {'depth': 0.4}}, count=4)
    found = learn_term(baseline(session))
    assert (found.term.against, found.term.acts_on) == ('heading', 'speed')
    found = finish(found)
    assert '3θ' in found.term.formula
    own = {k: v for k, v in found.term.parameters.items() if k != 'c0'}
    assert np.hypot(*own.values()) == pytest.approx(0.4, abs=0.1)


@pytest.mark.parametrize('seed', range(3))
def test_where_nothing_is_missing_nothing_is_learned(film, seed):
    session, _ = film(20 + seed)
    assert learn_term(baseline(session)) is None


# Curve ------------------------------------------------------------------------------------------

def test_the_evidence_is_that_of_a_gaussian():
    """Against the density of the data themselves, prior and noise integrated by covariance."""
    rng = np.random.default_rng(2)
    design, basis = rng.normal(size=(30, 6)), rng.normal(size=(6, 3))
    data = rng.normal(size=30)
    curve = Curve.of([Kernel('any', basis, 1.0)], design.T @ design, design.T @ data)
    (reduced,) = curve.reduced
    for a, found in zip(reduced.amplitudes, reduced.log_evidence, strict=True):
        with_it = np.eye(30) + a * design @ basis @ basis.T @ design.T
        expected = multivariate_normal.logpdf(data, cov=with_it) - multivariate_normal.logpdf(
            data, cov=np.eye(30))
        assert found == pytest.approx(expected, rel=1e-8)


def test_fields_without_sources_have_none(channel):
    table = moments_of(channel, 'position', 'velocity').term
    for kernel in kernels(table):
        if kernel.kind == 'any':
            continue
        u, v = kernel.basis[:, -1].reshape(2, *(len(axis) for axis in table.axes))
        step = np.diff(table.axes[0])[0]
        inside = (slice(3, -3), slice(3, -3))
        ux, uy = np.gradient(u, step)
        vx, vy = np.gradient(v, step)
        sources, turning = (np.abs(x[inside]).mean() for x in (ux + vy, vx - uy))
        assert (sources < 0.1 * turning) == (
            kernel.kind in ('without sources', 'along a line'))


def test_columns_are_what_the_term_does(channel):
    """The derivative of the expected displacement by a value, by another path."""
    known = told(channel)
    (p,) = known.session_fits
    for table in candidates(known):
        k = int(np.flatnonzero(table.seen)[len(np.flatnonzero(table.seen)) // 2])
        little = 1e-6 if table.acts_on == 'velocity' else 1e-4
        values = np.zeros_like(table.values)
        values[k, 0] = little
        term = replace(table, values=values)
        moved = [known.under(replace(known.model, learned=learned)).session_fits[0].expected.at(
            p.velocity_phasor) for learned in ((term,), ())]
        expected = (moved[0] - moved[1]) / little
        for n, column in enumerate(map(accumulated, steps(known, p, table))):
            np.testing.assert_allclose(
                np.diff(column[:, k]), np.diff(expected[:, n]),
                atol=1e-12 + 2e-3 * np.abs(np.diff(expected, axis=0)).max())


def test_products_are_those_of_all_columns_whitened(film):
    """Row by row and knot by knot, as if every knot were felt at every frame."""
    session, _ = film(5, count=3, camera=Camera(20.0, 0.5, 0.1e-6, missed=0.1, run=3.0))
    known = told(baseline(session))
    (p,) = known.session_fits
    noise = p.diffusion
    for table in candidates(known):
        found = Moments.of(known, table, [noise]).grams
        fold = _folds(p.session.times)
        for n, moved in enumerate(map(accumulated, steps(known, p, table))):
            white = np.concatenate(
                [p.white[:, n], whiten_track(p, n, moved)], axis=1) / np.sqrt(noise)
            for k in range(FOLDS):
                rows = np.concatenate([white[fold == k].real, white[fold == k].imag])
                expected = rows.T @ rows
                np.testing.assert_allclose(
                    found[k, n], expected, rtol=1e-9, atol=1e-10 * np.abs(expected).max())


# Formula ----------------------------------------------------------------------------------------

def test_a_formula_is_found_again(channel):
    """Every formula explains data without noise that it made: half of their λ of 200."""
    rng = np.random.default_rng(3)
    missed = []
    for against, acts in (('time', 'speed'), ('position', 'velocity'), ('heading', 'speed')):
        moments = moments_of(channel, against, acts)
        gram = moments.total[0]
        rules = grammar(moments.term)
        for rule in rules:
            shape = rule.starts[len(rule.starts) // 2]
            values = rule.basis(shape) @ rng.uniform(0.5, 1.0, len(rule.coefficients))
            values *= np.sqrt(200 / (values @ gram @ values))
            found = fit_formula(rule, gram, gram @ values)
            if not 97 < found.gain < 100.01:
                missed.append((against, rule.text, found.gain))
    assert not missed


def test_a_formula_acts_in_a_pause_but_not_outside_of_the_data():
    """Of time; where no angle was commanded nothing is known."""
    seen = np.array([0, 0, 1, 1, 0, 0, 0, 0, 1, 1, 0, 0], bool)
    knots = np.linspace(-3.0, 3.0, 12)
    term = LearnedTerm('time', 'heading', 'speed', (knots,), *np.zeros((3, 12, 1)), seen)
    acts = {against: (grammar(replace(term, against=against))[0].basis(()) != 0).any(axis=1)
            for against in ('time', 'command angle')}
    np.testing.assert_array_equal(acts['time'], [0, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 0])
    np.testing.assert_array_equal(acts['command angle'], [0, 1, 1, 1, 1, 0, 0, 1, 1, 1, 1, 0])


# Held out ---------------------------------------------------------------------------------------

def test_nothing_inside_a_hidden_block_moves_what_is_learned(film, findings):
    session, _ = film(3, CHANNEL, count=4, duration=40.0)
    prepared, _ = check_sessions([session])
    (whole,) = prepared
    kept = (whole.times < 15) | (whole.times > 25)
    changed = replace(whole, z=whole.z + np.where(kept, 0, 5e-6)[:, None])
    terms = []
    for one in (whole, changed):
        terms.append(relearn(findings, fit_first_order([one.only(kept)])).model.learned)
    assert terms[0]
    assert terms[0] == terms[1]


# Through and through ----------------------------------------------------------------------------

@pytest.fixture(name='found', scope='module')
def found_fixture(film):
    session, _ = film(4, {'speed_by_heading': {'depth': 0.4}}, count=4)
    return discover([session])


def test_the_verdict_stays_unnamed_and_the_gap_shrinks(found):
    assert found.verdict == 'unnamed'
    assert isinstance(found.model.learned[0], LearnedTerm)
    assert found.gap.learned < found.gap.before / 2
    (entry, *_) = found.as_json()['learned']
    assert {'against', 'frame', 'acts_on', 'formula', 'parameters', 'looks_like', 'gap_after_um',
            'band_95'} <= set(entry)
    assert 'A fitted curve does not name a cause' in ' '.join(found.sentences())
    assert 'to confirm' in found.next_experiment.sentence


def test_its_model_comes_back_from_model_yaml(found, tmp_path):
    write_model(tmp_path / 'model.yaml', found.model, found.particles)
    assert read_model(tmp_path / 'model.yaml')[0] == found.model


def test_a_flow_is_told_as_arrows_where_data_were():
    term = LearnedTerm(
        'position', 'laboratory', 'velocity',
        (np.array([-1e-5, 1e-5]), np.array([0.0, 1e-5, 2e-5])),
        values=1e-6 * np.arange(12.0).reshape(6, 2), low=np.zeros((6, 2)), high=np.zeros((6, 2)),
        seen=np.array([True, False, True, True, False, False]))
    told = Learned(term, '', 9.0, {}).as_json(1e-7)
    np.testing.assert_allclose(told['arrows'], [
        [-10, 0, 0, 1], [-10, 20, 4, 5], [10, 0, 6, 7]], atol=1e-9)
    assert 'velocity' in told['sentence']
    elsewhere = replace(term, frame='radial', against='neighbour distance',
                                    axes=(np.arange(1.0, 7.0),))
    assert Learned(elsewhere, '', 9.0, {}).as_json(1e-7)['arrows'] == []
