"""Fluctuating speeds and learned terms explain alike; the likelier of them is used."""

from __future__ import annotations

import pytest

from bench._hidden_suite import blind
from microbot_ros.discovery.check.input_checks import check_sessions
from microbot_ros.discovery.hypotheses import consider, fit_first_order
from microbot_ros.discovery.verdict import judge, scrutinised
from microbot_ros.estimation.likelihood.model_fit import unsteady


@pytest.fixture(scope='module')
def sessions():
    """Return a session of two swimmers, faster towards one side, at λ = 100."""
    return check_sessions([blind(950001, 'paper', ('speed_by_place',), 100.0).session])[0]


def test_a_speed_that_depends_on_place_is_no_fluctuation(sessions):
    first = fit_first_order(sessions)
    assert unsteady(sessions, first, first) is not None
    known = consider(sessions)
    assert not any(p.session.speeds_fluctuate for p in known.fit.session_fits)
    judgement = scrutinised(known, judge(known))
    assert judgement.verdict == 'unnamed'
    assert judgement.unlisted
    term = known.term_beside(known.fit).term
    assert (term.against, term.frame, term.acts_on) == ('position', 'heading', 'speed')
