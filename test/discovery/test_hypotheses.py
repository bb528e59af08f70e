"""How much a recording says for an effect, alone, beside others and against its rivals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from microbot_ros.discovery.check.input_checks import check_sessions
from microbot_ros.discovery.hypotheses import (
    Candidate,
    Slot,
    _exchange,
    consider,
    fit_first_order,
    joint_log_bayes_factor,
    log_bayes_factor,
)
from microbot_ros.discovery.search import contribution, fit_candidate
from microbot_ros.discovery.verdict import judge
from microbot_ros.model.effects.field.command_delay import CommandDelay
from microbot_ros.model.effects.velocity.speed_decay import SpeedDecay
from microbot_ros.model.effects.velocity.uniform_drift import UniformDrift


@pytest.fixture(scope='module')
def drifting(film):
    session, _ = film(30, {'uniform_drift': {'wx_um_s': 0.8, 'wy_um_s': 0.0}}, duration=30.0)
    return check_sessions([session])[0]


def test_evidence_of_one_effect_together_is_its_own(drifting):
    rest = fit_first_order(drifting)
    found = fit_candidate(rest, 'uniform_drift')
    assert joint_log_bayes_factor(found.fit, rest, [found]) == pytest.approx(
        log_bayes_factor(found), abs=1e-6)


def test_effects_that_explain_the_same_are_not_counted_twice(drifting):
    """A spot as wide as the view is a drift: beside each other neither says what both do."""
    rest = fit_first_order(drifting)
    drift = fit_candidate(rest, 'uniform_drift')
    both = fit_candidate(drift.fit, 'linear_flow').fit
    parts = [contribution(both, name) for name in ('uniform_drift', 'linear_flow')]
    together = joint_log_bayes_factor(both, rest, parts)
    chained = log_bayes_factor(drift) + log_bayes_factor(parts[1])
    assert together == pytest.approx(chained, abs=3.0)


def test_a_rival_that_explains_a_little_less_is_within_reach(drifting):
    rest = fit_first_order(drifting)
    own = Candidate(fit_candidate(rest, 'alignment_lag'), 14.9)
    other = Candidate(fit_candidate(rest, 'command_delay'), 14.5)
    slot = Slot(rest, own, (other,))
    assert slot.behind(other) == pytest.approx(0.4)
    assert slot.within_reach == (other,)
    far = Candidate(other.found, 9.0)
    assert Slot(rest, own, (far,)).within_reach == ()


def test_effects_are_looked_for_in_all_recordings_together(film):
    """Each half says too little to name the drift, both together name it."""
    sessions = [film(seed, {'uniform_drift': {'wx_um_s': 0.17, 'wy_um_s': 0.0}},
                     duration=20.0)[0] for seed in (40, 41, 42, 43)]
    prepared, _ = check_sessions(sessions)
    one, several = consider(prepared[:1]), consider(prepared)
    assert judge(one).named == ()
    assert judge(several).named == ('uniform_drift',)
    assert np.isfinite(several.evidence)
    assert several.evidence > one.evidence


def test_shapes_are_looked_for_in_all_recordings(film):
    """The spot is where only particles of the second recording come by."""
    away = film(50, duration=10.0, half_extent=50e-6)[0]
    away = replace(away, tracks=replace(away.tracks, position=away.tracks.position + 3e-4))
    near = film(51, {'hot_spot': {'x_um': 10.0, 'y_um': -20.0, 'speed_um_s': 3.0,
                                  'width_um': 25.0}}, duration=40.0, half_extent=50e-6)[0]
    known = consider(check_sessions([away, near])[0])
    spot = known.fit.model.effect('hot_spot')
    assert np.hypot(spot.x - 10e-6, spot.y + 20e-6) < 10e-6


def test_what_is_smaller_than_the_floor_is_the_instruments(drifting):
    known = consider(drifting)
    small = known.fit.model.with_effect(CommandDelay(2e-3))
    judgement = judge(replace(known, fit=known.fit.under(small)))
    assert judgement.of_instrument == ('command_delay',)
    assert judgement.status('command_delay') == 'suggested'
    assert not CommandDelay(5e-3).below_floor()
    assert not SpeedDecay.null().below_floor()


def test_a_rotational_diffusion_that_a_lag_frees_is_paid(film):
    session, _ = film(52, {'alignment_lag': {'tau_s': 0.4}}, duration=30.0)
    prices = []
    for conditions in (session.conditions, replace(session.conditions, radius=None)):
        prepared, _ = check_sessions([replace(session, conditions=conditions)])
        found = fit_candidate(fit_first_order(prepared), 'alignment_lag')
        prices.append(found.price_of_turning)
    assert prices[0] == 0
    assert 0 < prices[1] < 10


def test_a_prior_that_is_off_by_three_hardly_matters(drifting):
    found = fit_candidate(fit_first_order(drifting), 'uniform_drift')
    narrow, declared, wide = (log_bayes_factor(found, wider) for wider in (1 / 3, 1.0, 3.0))
    assert narrow == pytest.approx(declared, abs=0.5)
    assert wide == pytest.approx(declared, abs=0.5)
    # All of its widths are larger than what was found by a factor of ten and more.
    assert log_bayes_factor(found, 1e4) < declared - 2 * np.log(10)


def test_the_search_ends_where_models_repeat(drifting, monkeypatch):
    """An exchange that is always proposed ends the search instead of going round."""
    other = fit_first_order(drifting).model.with_effect(UniformDrift(1e-7, 0.0))
    monkeypatch.setattr('microbot_ros.discovery.hypotheses._exchange', lambda *_: other)
    assert consider(drifting).names == ('uniform_drift',)


def test_effects_are_not_exchanged_back(drifting):
    """Two that are each likelier than the other may both be there."""
    fit = fit_first_order(drifting)
    one, other = (Candidate(fit_candidate(fit, name), evidence) for name, evidence in (
        ('uniform_drift', 20.0), ('linear_flow', 30.0)))
    slot = Slot(fit, one, (other,))
    assert _exchange([slot], [('uniform_drift',)]) is other.found.fit.model
    assert _exchange([slot], [('linear_flow',), ('uniform_drift',)]) is None
    unlikely = Slot(fit, replace(one, evidence=0.0), ())
    assert _exchange([unlikely], [()]) is fit.model
