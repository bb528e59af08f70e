"""An effect is named only if one half of the recordings foretells the other by it."""

from dataclasses import replace

import numpy as np
import pytest

from microbot_ros.discovery.check.halves import CONTRADICTED, foretold
from microbot_ros.discovery.check.input_checks import check_sessions
from microbot_ros.discovery.discover import _reservations
from microbot_ros.discovery.hypotheses import (
    Candidate,
    Hypotheses,
    Slot,
    fit_first_order,
)
from microbot_ros.discovery.search import fit_candidate
from microbot_ros.discovery.verdict import enough, judge

DRIFT = np.array([0.6e-6, -0.4e-6])


def drifting(film, when=lambda t: t, of=lambda n: n >= 0, count=4, seed=60):
    """A session in which particles drift with the strength of the speed of `when`(t)."""
    session, _ = film(seed, count=count)
    tracks = session.tracks
    moved = DRIFT * (when(tracks.t) * of(tracks.particle))[:, None]
    return replace(session, tracks=replace(tracks, position=tracks.position + moved))


def first_half(t):
    """A motion that stops after 15 of 30 s."""
    return np.minimum(t, 15.0)


@pytest.mark.parametrize(('how', 'contradicted'), [
    ({}, False), ({'count': 1}, False), ({'when': first_half}, True),
    ({'when': first_half, 'count': 1}, True), ({'of': lambda n: n % 2 == 0}, True)])
def test_a_drift_of_half_of_the_time_or_of_the_particles_is_contradicted(
        film, how, contradicted):
    sessions, _ = check_sessions([drifting(film, **how)])
    found = fit_candidate(fit_first_order(sessions), 'uniform_drift')
    assert found.log_p < -10
    assert (foretold(found.fit, 'uniform_drift') < CONTRADICTED) == contradicted


@pytest.mark.parametrize(('of', 'named'), [
    (lambda n: n >= 0, ('uniform_drift',)), (lambda n: n % 2 == 0, ())])
def test_what_is_contradicted_is_told_and_not_named(film, of, named):
    sessions, _ = check_sessions([drifting(film, of=of)])
    start = fit_first_order(sessions)
    own = Candidate.of(fit_candidate(start, 'uniform_drift'))
    assert own.evidence > enough()
    known = Hypotheses(start, own.found.fit, (Slot(start, own, ()),), ())
    judgement = judge(known)
    assert judgement.named == named
    assert (judgement.contradicted == ()) == bool(named)
    told = any('not the same in the whole recording' in one
               for one in _reservations(known, judgement))
    assert told != bool(named)


@pytest.mark.parametrize('doubted', [(), ('uniform_drift',)])
def test_what_is_in_doubt_is_told_and_not_named(film, doubted):
    sessions, _ = check_sessions([drifting(film)])
    start = fit_first_order(sessions)
    own = Candidate.of(fit_candidate(start, 'uniform_drift'))
    known = Hypotheses(start, own.found.fit, (Slot(start, own, ()),), ())
    judgement = judge(known)
    one = next(m for m in judgement.maps if m.against == 'time')
    judgement = replace(judgement, left=(one,), doubted=doubted)
    assert judgement.status('uniform_drift') == 'proxy'
    assert not any('stand in' in one for one in _reservations(known, judgement))
    judgement = judgement.foretelling_nothing()
    assert judgement.beside[0] is one
    assert judgement.verdict == ('consistent' if doubted else 'named')
    assert judgement.status('uniform_drift') == ('suggested' if doubted else 'established')
    assert any('stand in' in one for one in _reservations(known, judgement)) == bool(doubted)
