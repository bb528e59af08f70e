"""Which sessions have an effect, and whether its parameter is the same in all of them."""

import numpy as np
import pytest

from microbot_ros.archive.conclusions.recurring import (
    candidates_for_all,
    common_reference,
    proxies,
    recurring_effects,
)
from microbot_ros.model.effects import EFFECTS

LAG = EFFECTS['alignment_lag'].parameters()[0]


def measured(taus, std=0.02, seed=1, effect='alignment_lag', name=LAG.name):
    """What sessions with these lags [s] would tell, each with an error `std` [s]."""
    rng = np.random.default_rng(seed)
    result = {}
    for k, tau in enumerate(taus):
        x = max(tau + std * rng.standard_normal(), 0.0) / LAG.scale
        result[f's{k}'] = {'effects': {effect: {
            'parameters': {name: [x, std / LAG.scale]}, 'dof': 1,
            'likelihood_ratio': (x * LAG.scale / std) ** 2, 'p_value': 0.5}}}
    return result


def test_thirty_of_two_hundred_are_named():
    taus = np.where(np.arange(200) % 7 == 0, 0.15, 0.0)
    having = {f's{k}' for k in np.flatnonzero(taus)}
    [found] = recurring_effects(measured(taus))
    assert len(having & {*found.present}) >= 0.95 * len(having)
    assert len({*found.present} - having) <= 0.01 * 171
    assert len({*found.absent} & having) == 0
    assert len(found.absent) > 160


def test_a_weak_effect_that_all_have_is_seen_by_all_together():
    [found] = recurring_effects(measured(np.full(60, 0.04)))  # two standard deviations each
    # One that shows less than 0.4 standard deviations cannot decide, against 61 to 1 by all:
    # 5.6 % of such sessions, and at most 7 of 60 in 98 of a hundred archives.
    assert len(found.present) >= 53
    assert found.absent == []
    assert found.parameters['tau_s'].mean == pytest.approx(0.04, abs=0.008)


@pytest.mark.parametrize('seed', range(5))
def test_nothing_is_nothing(seed):
    assert recurring_effects(measured(np.zeros(100), seed=seed)) == []


def test_common_and_varying_are_told_apart():
    [common] = recurring_effects(measured(np.full(30, 0.2)))
    assert common.varying == []
    assert 'common parameters' in common.sentence()
    spread = 0.2 + 0.08 * np.random.default_rng(2).standard_normal(30)
    [varying] = recurring_effects(measured(spread))
    assert varying.varying == ['tau_s']
    found = varying.parameters['tau_s']
    assert found.between_low < 0.08 < found.between_high
    assert 'its tau varies by session' in varying.sentence()


def test_who_cannot_see_is_not_said_to_be_without():
    told = measured([0.2] * 10) | {'blind': {'effects': {'alignment_lag': None}}}
    weak = measured([0.2], std=0.5)['s0']
    weak['effects']['alignment_lag']['likelihood_ratio'] = 0.0
    [found] = recurring_effects(told | {'weak': weak})
    assert 'blind' in found.undecided
    assert 'weak' not in found.absent


def test_a_parameter_that_no_session_determines_hides_no_effect():
    """Whether a session has an effect is not a question of all of its parameters."""
    told = measured([0.2] * 10)
    half = {f's{k}': {'effects': {'drive_response': {
        'parameters': {p.name: [1.0, None if p.name == unknown else 0.01]
                       for p in EFFECTS['drive_response'].parameters()},
        'dof': 5, 'likelihood_ratio': 300.0, 'p_value': 0.0}}}
        for k, unknown in enumerate(['cut_in_hz'] * 5 + ['step_out_hz'] * 5)}
    blind = {'blind': {'effects': {'drive_response': {
        'parameters': {p.name: [1.0, None] for p in EFFECTS['drive_response'].parameters()},
        'dof': 5, 'likelihood_ratio': 0.0, 'p_value': 1.0}}}}
    [lag] = recurring_effects(told)
    [found] = recurring_effects(half | blind)
    assert [*found.present] == [*half] == lag.present
    assert found.undecided == ['blind']
    assert found.sentence().startswith('drive_response in 10 of 11 sessions (1 cannot decide)')
    assert found.parameters['cut_in_hz'].count == found.parameters['step_out_hz'].count == 5
    assert found.parameters['slip'].count == 10


def test_an_error_as_wide_as_the_bounds_tells_no_parameter():
    wide = measured([0.2], std=LAG.high)['s0']
    [found] = recurring_effects(measured([0.2] * 10) | {'wide': wide})
    assert found.undecided == ['wide']
    assert 'wide' not in found.estimates['tau_s']


def test_a_session_that_tells_nothing_is_not_decided_by_ten_others():
    silent = {'effects': {'alignment_lag': {
        'parameters': {LAG.name: [0.2 / LAG.scale, 0.5 / LAG.scale]}, 'dof': 1,
        'likelihood_ratio': 0.16, 'p_value': 0.7}}}
    [found] = recurring_effects(measured([0.2] * 10) | {'silent': silent})
    assert len(found.present) == 10
    assert found.undecided == ['silent']


def test_reciprocals_are_told_as_such():
    decay = EFFECTS['speed_decay'].parameters()[0]
    rows = {f's{k}': {'effects': {'speed_decay': {
        'parameters': {decay.name: [decay.scale / 50.0, 0.02]}, 'dof': 1,
        'likelihood_ratio': 200.0, 'p_value': 0.0}}} for k in range(6)}
    [found] = recurring_effects(rows)
    assert found.parameters['tau_s'].mean == pytest.approx(1 / 50)
    assert found.unit('tau_s') == '1/(s)'


def discovered(names, reference=5e-3, status='established'):
    return {'result': {'effects': [{'id': name, 'status': status} for name in names]},
            'reference_field': reference}


def test_what_is_asked_of_all():
    quiet = [discovered([]) for _ in range(100)]
    often = quiet + [discovered(['alignment_lag'])] * 10
    once = [*quiet, discovered(['alignment_lag'])]
    numbered = [dict(enumerate(some)) for some in (quiet, often, once)]
    assert [candidates_for_all(one) for one in numbered] == [[], ['alignment_lag'], []]
    hints = [discovered(['uniform_drift'], status='suggested') for _ in range(100)]
    assert candidates_for_all(dict(enumerate(hints))) == []
    few = {0: {'refused': 'empty'}, 1: discovered(['hot_spot'])}
    assert candidates_for_all(few) == ['hot_spot']


def test_most_sessions_state_the_reference():
    told = [discovered([], reference=one) for one in (5e-3, 2e-3, 5e-3)]
    assert common_reference({0: {'refused': 'x'}} | dict(enumerate(told, 1))) == 5e-3


def test_proxies_and_sessions_with_something_unnamed_count_for_nothing():
    """Each of twelve sessions says to trust no name: none recurs, and all are told apart."""
    one = {'result': {'verdict': 'unnamed',
                      'effects': [{'id': 'pixel_anisotropy', 'status': 'proxy'}]}}
    results = {f's{k}': one for k in range(12)}
    assert candidates_for_all(results) == []
    assert proxies(results) == {'pixel_anisotropy': list(results)}
