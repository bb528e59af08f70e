"""How much a recording says for an effect, alone, beside others and against its rivals."""

from __future__ import annotations

import numpy as np
import pytest

from microbot_ros.discovery.check.input_checks import check_sessions
from microbot_ros.discovery.hypotheses import (
    Candidate,
    Slot,
    consider,
    fit_first_order,
    joint_log_bayes_factor,
    log_bayes_factor,
)
from microbot_ros.discovery.search import contribution, fit_candidate
from microbot_ros.discovery.verdict import judge


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
