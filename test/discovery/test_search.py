"""p-values mean what they say, scans included; far tails; swings."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from microbot_ros.discovery.discover import _suggestions
from microbot_ros.discovery.drive_levels import curve_p_value, scattered
from microbot_ros.discovery.evidence import FitEvidence
from microbot_ros.discovery.input_checks import check_sessions
from microbot_ros.discovery.intervals import Intervals
from microbot_ros.discovery.search import compare, fit_candidate
from microbot_ros.discovery.starting_points import rotating_components
from microbot_ros.discovery.stepwise_selection import StepwiseSelection, is_cancelled
from microbot_ros.discovery.tail_probabilities import (
    chi_square_tail,
    log_chi_square_tail,
    log_of_any,
)
from microbot_ros.estimation.model_fit import fit_sessions, maximise
from microbot_ros.model.effects import EFFECTS
from microbot_ros.model.model import Model, ParticleParameters
from microbot_ros.model.model_file import read_model, write_model
from microbot_ros.records import Session
from microbot_ros.session.folder import NOMINAL_FIELD
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
        fit = StepwiseSelection(sessions).current
        for name, values in found.items():
            one = fit_candidate(fit, name)
            values.append(1.0 if one is None else one.p_value)
    for values in found.values():
        assert stats.kstest(values, 'uniform', alternative='greater').pvalue > 1e-3
        assert min(values) > 1e-3


def test_slow_swings_and_wide_spots_have_fewer_places(film):
    """Every octave is given the same part of all chances."""
    fit = StepwiseSelection(check_sessions([film(1, duration=20.0)[0]])[0]).current
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


def test_fields_that_cancel_take_each_other_back(film):
    fit = StepwiseSelection(check_sessions([film(2, duration=20.0)[0]])[0]).current
    # Near its middle a wide spot is a flow, outwards as the square root of e times speed/width.
    flow, against, along = (EFFECTS['linear_flow'](0.1, 0.0, 0.0, 0.1),
                            *(EFFECTS['hot_spot'](0, 0, s * 6e-5, 1e-3) for s in (-1, 1)))
    for name in ('linear_flow', 'hot_spot'):
        assert is_cancelled(beside(fit, flow, against), name)
        assert not is_cancelled(beside(fit, flow, along), name)
    assert not is_cancelled(beside(fit, flow), 'linear_flow')
    drifting = beside(fit, flow, EFFECTS['uniform_drift'](1e-6, 0.0))
    assert not is_cancelled(drifting, 'linear_flow')
    assert not is_cancelled(drifting, 'uniform_drift')


def test_what_is_too_weak_for_the_model_is_suggested_whole_shapes_first(film):
    sessions, _ = check_sessions([film(1, duration=20.0)[0]])
    fit = StepwiseSelection(sessions).current
    weak = replace(fit_candidate(fit, 'uniform_drift'), likelihood_ratio=12.0)
    assert [case.own for case in _suggestions([weak], sessions)] == [weak]
    assert not _suggestions([replace(weak, likelihood_ratio=5.0)], sessions)
    assert not _suggestions([], sessions)
    flank = replace(fit_candidate(fit, 'linear_flow'), likelihood_ratio=20.0, shape_seen=False)
    case, = _suggestions([flank, weak], sessions)
    assert case.own is weak
    assert case.rivals == [flank]
    assert not case.sure
    plain = replace(flank, likelihood_ratio=40.0)
    assert [case.own for case in _suggestions([plain, weak], sessions)] == [plain]


def test_a_hint_of_a_drive_response_stands_in_where_something_is_left(film):
    sessions, _ = check_sessions([film(15, rolling=True)[0]])
    fit = StepwiseSelection(sessions).current
    hint = replace(fit_candidate(fit, 'drive_response'), likelihood_ratio=30.0)
    case, = _suggestions([hint], sessions)
    assert case.entry(Intervals(case.own.fit), doubted=True).status == 'proxy'
    assert case.entry(Intervals(case.own.fit), doubted=False).status == 'suggested'


@pytest.mark.parametrize('strength', [0.4, -0.3])
def test_a_pull_along_the_field_takes_several_strengths(film, strength):
    """At one strength it is v e^{iφ} to the last digit: no evidence, however strong it is."""
    hidden = {'coil_pull': {'rate_um_s_mT': strength}}
    one, several = (
        fit_candidate(StepwiseSelection(check_sessions([session])[0]).current, 'coil_pull')
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
    known, unknown = (StepwiseSelection(check_sessions([s])[0]).current for s in (session, told))
    for name in ('gradient_force', 'coil_pull'):
        assert fit_candidate(known, name) is not None
        assert fit_candidate(unknown, name) is None
    of_strength = {name for name, kind in EFFECTS.items()
                   if not kind.applies(FitEvidence(unknown)) and kind.applies(FitEvidence(known))}
    assert of_strength == {
        'amplifier_deadband', 'background_field', 'incomplete_alignment', 'gradient_force',
        'coil_pull', 'dipole_interaction'}


def test_a_field_that_turns_one_way_hides_a_lag_in_phi(film):
    session, _ = film(3, duration=20.0)
    fit = StepwiseSelection(check_sessions([session])[0]).current
    assert not EFFECTS['alignment_lag'].absorbed_by_phi(FitEvidence(fit))
    turning = Session(session.tracks, rotating(20.0, 5e-3, 5.0), session.conditions, 'turning')
    fit = StepwiseSelection(check_sessions([turning])[0]).current
    assert EFFECTS['alignment_lag'].absorbed_by_phi(FitEvidence(fit))
    assert fit_candidate(fit, 'alignment_lag') is None


def test_levels_of_the_drive_judge_its_curve(film):
    """Gains that scatter ten times their noise: a step shows, one lucky level does not."""
    rng = np.random.default_rng(0)
    noise = np.full(40, 0.02)
    step = np.where(np.arange(40) < 10, 1.0, 0.7)
    flat, stepped = (curve + rng.normal(0, 0.1, 40) for curve in (np.ones(40), step))
    assert scattered(stepped, noise, step) - scattered(stepped, noise, np.ones(40)) > 15
    assert scattered(flat, noise, step) < scattered(flat, noise, np.ones(40))
    lucky = np.where(np.arange(40) == 3, 1.3, 1.0)
    assert scattered(lucky * flat, noise, lucky) - scattered(lucky * flat, noise, np.ones(40)) < 8
    with pytest.raises(ValueError, match='no curve drive_response'):
        curve_p_value(StepwiseSelection(check_sessions([film(15, rolling=True)[0]])[0]).current,
                      'drive_response')


@pytest.mark.parametrize('rolling', [False, True])
def test_fits_begin_inside_the_bounds(film, rolling):
    sessions, _ = check_sessions([film(5, duration=10.0, rolling=rolling)[0]])
    evidence = FitEvidence(StepwiseSelection(sessions).current)
    for kind in EFFECTS.values():
        starts = kind.starts(evidence)
        assert starts
        for start in starts:
            assert isinstance(start, kind)
            for p, value in start.values().items():
                assert p.low <= value <= p.high, p.name


@pytest.mark.parametrize('end', ['low', 'high'])
@pytest.mark.parametrize('name', EFFECTS)
def test_an_effect_at_its_bound_goes_through_fit_result_and_file(film, tmp_path, name, end):
    """A gain ratio of 0.19999999999999996 was once below its bound of 0.2."""
    rolling = name == 'drive_response'
    session, _ = film(40, duration=8.0, count=2, rolling=rolling)
    prepared, _ = check_sessions([session])
    effect = EFFECTS[name](**{p.field: getattr(p, end) for p in EFFECTS[name].parameters()})
    plain = fit_sessions(Model.baseline(session.conditions, session.commands), prepared)
    fit = plain.under(plain.model.with_effect(effect))
    back = fit.model.with_vector(fit.model.vector())
    write_model(tmp_path / 'model.yaml', back, ParticleParameters.from_velocity_phasor(
        prepared[0].ids, fit.session_fits[0].velocity_phasor))
    assert read_model(tmp_path / 'model.yaml')[0] == back
    for p, value in back.effect(name).values().items():
        assert p.low <= value <= p.high
    for estimate in Intervals(maximise(fit)).effect(name).values():
        estimate.as_json('x')
        assert not estimate.low > estimate.value
        assert not estimate.high < estimate.value
