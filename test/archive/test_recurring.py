"""Which sessions have an effect, and whether its parameter is the same in all of them."""

import numpy as np
import pytest

from microbot_ros.archive.recurring import (
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
    # In one of a hundred chance hides it: that one can't tell.
    assert len(found.present) >= 57
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
    assert 'tau_s varies by session' in varying.sentence()


def test_who_cannot_see_is_not_said_to_be_without():
    told = measured([0.2] * 10) | {'blind': {'effects': {'alignment_lag': None}}}
    weak = measured([0.2], std=3.0)['s0']
    weak['effects']['alignment_lag']['likelihood_ratio'] = 0.0
    [found] = recurring_effects(told | {'weak': weak})
    assert 'blind' in found.undecided
    assert 'weak' not in found.absent


def test_reciprocals_are_told_as_such():
    decay = EFFECTS['speed_decay'].parameters()[0]
    rows = {f's{k}': {'effects': {'speed_decay': {
        'parameters': {decay.name: [decay.scale / 50.0, 0.02]}, 'dof': 1,
        'likelihood_ratio': 200.0, 'p_value': 0.0}}} for k in range(6)}
    [found] = recurring_effects(rows)
    assert found.parameters['tau_s'].mean == pytest.approx(1 / 50)
    assert found.unit('tau_s') == '1/(s)'


def discovered(names, candidates=(), reference=5e-3):
    return {'result': {'effects': [{'id': name, 'status': 'established'} for name in names]},
            'candidates': list(candidates), 'reference_field': reference}


def test_what_is_asked_of_all():
    quiet = [discovered([]) for _ in range(100)]
    often = quiet + [discovered(['alignment_lag'])] * 10
    once = [*quiet, discovered(['alignment_lag'])]
    numbered = [dict(enumerate(some)) for some in (quiet, often, once)]
    assert [candidates_for_all(one) for one in numbered] == [[], ['alignment_lag'], []]
    weak = [discovered([], [['uniform_drift', 4.0, 2], ['hot_spot', 9.0, 4]]) for _ in range(100)]
    assert candidates_for_all(dict(enumerate(weak))) == ['uniform_drift']
    few = {0: {'refused': 'empty'}, 1: discovered(['hot_spot'])}
    assert candidates_for_all(few) == ['hot_spot']


def test_most_sessions_state_the_reference():
    told = [discovered([], reference=one) for one in (5e-3, 2e-3, 5e-3)]
    assert common_reference({0: {'refused': 'x'}} | dict(enumerate(told, 1))) == 5e-3


def test_proxies_and_sessions_with_something_unnamed_count_for_nothing():
    """Each of twelve sessions says to trust no name: none recurs, and all are told apart."""
    one = {'result': {'verdict': 'unnamed',
                      'effects': [{'id': 'pixel_anisotropy', 'status': 'proxy'}]},
           'candidates': [('uniform_drift', 100.0, 2)]}
    results = {f's{k}': one for k in range(12)}
    assert candidates_for_all(results) == []
    assert proxies(results) == {'pixel_anisotropy': list(results)}
