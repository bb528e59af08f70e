"""p-values mean what they say, scans included; far tails; swings."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from microbot_ros.common.records import Session
from microbot_ros.discovery.check.input_checks import check_sessions
from microbot_ros.discovery.check.tail_probabilities import (
    chi_square_tail,
    log_chi_square_tail,
    log_of_any,
)
from microbot_ros.discovery.evidence import FitEvidence
from microbot_ros.discovery.hypotheses import fit_first_order
from microbot_ros.discovery.search import compare, fit_candidate
from microbot_ros.discovery.starting_points import rotating_components
from microbot_ros.model.effects import EFFECTS
from microbot_ros.session.tables.folder import NOMINAL_FIELD
from microbot_ros.virtual_rig.commands import rotating

FIELD = 5e-3


@pytest.mark.parametrize('dof', [1, 2, 4, 17])
def test_tail_is_that_of_chi_square(dof):
    for value in (0.0, 0.5, 3.0, 40.0, 600.0):
        assert chi_square_tail(value, dof) == pytest.approx(stats.chi2.sf(value, dof))
    expected = stats.chi2.logsf(5000.0, dof)
    assert log_chi_square_tail(5000.0, dof) == pytest.approx(expected, rel=1e-6) or (
        not np.isfinite(expected))
    # Continuous where the series takes over, near P = 1e-280.
    values = [log_chi_square_tail(x, dof) for x in np.linspace(1270, 1400, 60)]
    assert np.ptp(np.diff(values)) < 0.02


def test_one_of_many_trials():
    assert log_of_any(np.log(0.01), 1) == pytest.approx(np.log(0.01))
    assert np.exp(log_of_any(np.log(0.01), 50)) == pytest.approx(1 - 0.99**50)
    assert log_of_any(-500.0, 10) == pytest.approx(-500 + np.log(10))
    assert log_of_any(0.0, 10) == 0.0


def test_parts_that_turn_either_way():
    times = np.sort(np.random.default_rng(0).choice(np.arange(400), 350, replace=False)) * 0.05
    signal = 3 * np.exp(2j * np.pi * 0.5 * times + 0.3j) + 1j * np.exp(-2j * np.pi * 0.5 * times)
    frequency, forward, back = rotating_components(times, signal, 2.0)
    k = np.argmax(np.abs(forward))
    assert frequency[k] == pytest.approx(0.5, abs=0.02)
    assert np.angle(forward[k]) == pytest.approx(0.3, abs=0.15)
    assert np.abs(forward[k]) / len(times) == pytest.approx(3, rel=0.05)
    assert np.angle(back[np.argmax(np.abs(back))]) == pytest.approx(np.pi / 2, abs=0.3)
    assert frequency.max() <= 2.0


def test_scanned_effects_pay_for_the_scan(film):
    """On nothing at all p-values are not smaller than chance makes them."""
    found = {'hot_spot': [], 'periodic_drift': [], 'uniform_drift': []}
    for seed in range(12):
        sessions, _ = check_sessions([film(seed, count=2, duration=12.0)[0]])
        fit = fit_first_order(sessions)
        for name, values in found.items():
            one = fit_candidate(fit, name)
            values.append(1.0 if one is None else one.p_value)
    for values in found.values():
        assert stats.kstest(values, 'uniform', alternative='greater').pvalue > 1e-3
        assert min(values) > 1e-3


def test_slow_swings_and_wide_spots_have_fewer_places(film):
    """Every octave is given the same part of all chances."""
    fit = fit_first_order(check_sessions([film(1, duration=20.0)[0]])[0])
    slow, fast = (
        compare(beside(fit, EFFECTS['periodic_drift'](1e-6, f)), fit, 'periodic_drift').trials
        for f in (0.2, 0.8))
    assert fast == pytest.approx(4 * slow)
    wide, narrow = (
        compare(beside(fit, EFFECTS['hot_spot'](0, 0, 1e-6, w)), fit, 'hot_spot').trials
        for w in (1e-5, 5e-6))
    assert narrow == pytest.approx(4 * wide)


def beside(fit, *effects):
    """A fit with these effects, as they are."""
    return fit.under(replace(fit.model, effects=effects))


@pytest.mark.parametrize('strength', [0.4, -0.3])
def test_a_pull_along_the_field_takes_several_strengths(film, strength):
    """At one strength it is v e^{iφ} to the last digit: no evidence, however strong it is."""
    hidden = {'coil_pull': {'rate_um_s_mT': strength}}
    one, several = (
        fit_candidate(fit_first_order(check_sessions([session])[0]), 'coil_pull')
        for session in (film(4, hidden, duration=20.0)[0],
                        film(4, hidden, duration=20.0, levels=(1e-3, 2e-3, 5e-3))[0]))
    assert one.likelihood_ratio == pytest.approx(0, abs=1e-6)
    assert several.p_value < 1e-6
    spread = 1e-4 * np.sqrt(several.fit.covariance[0, 0])
    assert abs(several.fit.model.effect('coil_pull').rate - 1e-3 * strength) < 3 * spread


def test_where_only_a_direction_was_told_no_effect_of_strength_is_looked_for(film):
    session, _ = film(3, duration=20.0, rolling=True)
    field = session.commands.field * NOMINAL_FIELD / FIELD
    told = replace(session, commands=replace(session.commands, field=field),
                   conditions=replace(session.conditions, reference_field=None))
    known, unknown = (fit_first_order(check_sessions([s])[0]) for s in (session, told))
    for name in ('gradient_force', 'coil_pull'):
        assert fit_candidate(known, name) is not None
        assert fit_candidate(unknown, name) is None
    of_strength = {name for name, kind in EFFECTS.items()
                   if not kind.applies(FitEvidence(unknown)) and kind.applies(FitEvidence(known))}
    assert of_strength == {
        'background_field', 'incomplete_alignment', 'gradient_force', 'coil_pull',
        'dipole_interaction'}
    assert fit_candidate(unknown, 'amplifier_deadband') is not None  # a share of full scale


def test_a_field_that_turns_one_way_hides_a_lag_in_phi(film):
    session, _ = film(3, duration=20.0)
    fit = fit_first_order(check_sessions([session])[0])
    assert not EFFECTS['alignment_lag'].absorbed_by_phi(FitEvidence(fit))
    turning = Session(session.tracks, rotating(20.0, 5e-3, 5.0), session.conditions, 'turning')
    fit = fit_first_order(check_sessions([turning])[0])
    assert EFFECTS['alignment_lag'].absorbed_by_phi(FitEvidence(fit))
    assert fit_candidate(fit, 'alignment_lag') is None


@pytest.mark.parametrize('rolling', [False, True])
def test_fits_begin_inside_the_bounds(film, rolling):
    sessions, _ = check_sessions([film(5, duration=10.0, rolling=rolling)[0]])
    evidence = FitEvidence(fit_first_order(sessions))
    for kind in EFFECTS.values():
        starts = kind.starts(evidence)
        assert starts
        for start in starts:
            assert isinstance(start, kind)
            for p, value in start.values().items():
                assert p.low <= value <= p.high, p.name
