"""Discovery that drives: plans, experiments as one recording, odds, design, and when it ends."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from schemas import conforming
from scipy.special import softmax

from bench import _driven_rig
from bench._asks_worlds import hidden_world
from bench._hidden_suite import FLUID
from bench.asks import _twin
from microbot_ros.common.records import Commands, Conditions, Session, Tracks
from microbot_ros.control.contract import Workspace
from microbot_ros.discovery.discover import discover
from microbot_ros.discovery.driven.conclusion import as_json, discovered
from microbot_ros.discovery.driven.design import (
    Question,
    Range,
    Search,
    _Trial,
    choose_plan,
    random_steps,
)
from microbot_ros.discovery.driven.drive import (
    Driven,
    Insight,
    Look,
    Played,
    _unexplained,
    drive,
    lasting,
)
from microbot_ros.discovery.driven.joined import PAUSE, SETTLING, join
from microbot_ros.discovery.driven.page import section
from microbot_ros.discovery.driven.plan import Plan, marking_time
from microbot_ros.discovery.driven.questions import likeliest, questions
from microbot_ros.discovery.hypotheses import (
    Candidate,
    Slot,
    consider,
    fit_first_order,
    log_bayes_factor,
)
from microbot_ros.discovery.learned.learn import learn_term
from microbot_ros.discovery.search import compare, fit_candidate, without
from microbot_ros.discovery.verdict import Judgement, enough, judge, scrutinised
from microbot_ros.estimation.likelihood.prepared_session import prepare
from microbot_ros.model.effects import EFFECTS
from microbot_ros.virtual_rig.injected_effects import inject_effect
from microbot_ros.virtual_rig.record_session import Camera, draw_swarm
from microbot_ros.virtual_rig.world import World

FIELD = 5e-3
VIEW = Workspace(np.array([-140e-6, -104e-6]), np.array([140e-6, 104e-6]))
RIG = Range(FIELD, VIEW)
ROLLING = Range(FIELD, VIEW, (1.0, 20.0))

# Plans ------------------------------------------------------------------------------------------

HOLDS = st.lists(st.floats(0.05, 30.0), min_size=1, max_size=20)


@given(HOLDS, st.floats(0.5, 90.0))
def test_a_plan_lasts_as_long_as_it_is_asked_to_and_begins_as_it_did(holds, seconds):
    hold = np.array(holds)
    plan = Plan(np.arange(len(hold)) * 1.0, np.full(len(hold), FIELD), hold)
    cut = plan.lasting(seconds)
    assert cut.duration == pytest.approx(seconds, abs=1e-6)
    at = np.linspace(0.0, min(seconds, plan.duration) - 0.02, 50)
    before, after = plan.commands(), cut.commands()
    same = before.index_at(at) == after.index_at(at)
    edges = np.abs(at[:, None] - before.t).min(axis=1) < 1e-6
    assert (same | edges).all()


@pytest.mark.parametrize('broken', [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize('row', ['angle', 'strength', 'hold', 'frequency'])
def test_a_plan_holds_numbers_only(row, broken):
    rows = {name: np.ones(3) for name in ('angle', 'strength', 'hold', 'frequency')}
    Plan(**rows)
    rows[row] = np.array([1.0, broken, 1.0])
    with pytest.raises(ValueError, match='finite'):
        Plan(**rows)


@pytest.mark.parametrize(('strength', 'hold'), [(-1e-9, 1.0), (1.0, 0.0), (1.0, -1.0)])
def test_a_plan_has_no_negative_fields_and_takes_time(strength, hold):
    with pytest.raises(ValueError, match='negative'):
        Plan(np.zeros(1), np.array([strength]), np.array([hold]))


@pytest.mark.parametrize('last', [-3.0, 0.0, 0.7])
def test_who_marks_time_stays_and_never_turns_back(last):
    plan = marking_time(last, FIELD)
    field = plan.commands().field
    walked = np.cumsum(field / FIELD * plan.hold[:, None], axis=0)
    assert np.abs(walked[3::4]).max() < 1e-9
    assert np.hypot(*walked.T).max() < 2.2
    assert np.allclose(np.diff(plan.angle, prepend=last), np.pi / 2)


@settings(max_examples=20)
@given(st.integers(0, 1000), st.floats(5.0, 60.0))
def test_random_steps_keep_the_limits(seed, duration):
    for limits in (RIG, ROLLING):
        plan = random_steps(np.random.default_rng(seed), duration, limits)
        assert plan.duration == pytest.approx(duration)
        assert plan.strength.max() <= FIELD
        assert (plan.frequency is None) == (limits.frequency is None)
        if plan.frequency is not None:
            assert 1.0 <= plan.frequency.min() <= plan.frequency.max() <= 20.0


# Experiments as one recording -------------------------------------------------------------------

def _experiment(begin, duration, field=FIELD, told_from=None):
    t = np.arange(begin, begin + duration, 0.05)
    tracks = Tracks(np.repeat(t, 2), np.tile([3, 7], len(t)), np.zeros((2 * len(t), 2)),
                    np.full(2 * len(t), np.nan), np.full(2 * len(t), np.nan))
    start = begin if told_from is None else told_from
    switches = np.array([start, begin + duration / 2, begin + duration])
    fields = np.array([[field, 0.0], [0.0, field], [0.0, 0.0]])
    return Session(tracks, Commands(switches, fields))


def test_experiments_that_go_on_are_one_recording_without_a_break():
    joined = join([_experiment(0.0, 10.0), _experiment(10.0, 10.0)])
    assert joined.breaks.size == 0
    assert len(np.unique(joined.tracks.t)) == 400
    assert (np.diff(joined.commands.t) > 0).all()
    assert (np.hypot(*joined.commands.field.T) > 0).all()
    assert (np.diff(prepare(joined).pieces, axis=0) == 0).all()


def test_a_command_that_two_recordings_have_is_told_once_and_in_order():
    first, second = _experiment(0.0, 10.0), _experiment(10.0, 10.0)
    shared = 10.0 + 0.4 * 0.05  # after the last frame of the first, told in both
    longer = replace(first.commands, t=np.array([0.0, shared, 11.0]))
    began = replace(second.commands, t=np.array([5.0, shared, 20.0]))
    joined = join([replace(first, commands=longer), replace(second, commands=began)])
    assert (np.diff(joined.commands.t) > 0).all()
    assert (joined.commands.t == shared).sum() == 1


def test_a_pause_cuts_tracks_and_what_follows_it_is_left_out():
    joined = join([_experiment(0.0, 10.0), _experiment(10.0 + 2 * PAUSE, 10.0)])
    prepared = prepare(joined)
    across = np.flatnonzero(np.diff(prepared.times) > PAUSE)
    assert len(across) == 1
    assert not prepared.joined()[across].any()
    assert prepared.times[across[0] + 1] >= 10.0 + 2 * PAUSE + SETTLING - 1e-9
    # The clock and the particles are the same, and nothing but the field is told of the pause.
    assert prepared.ids.tolist() == [3, 7]
    assert (np.hypot(*joined.commands.field.T) > 0).all()


def test_when_it_was_recorded_changes_nothing():
    early, late = ([_experiment(at, 10.0), _experiment(at + 15.0, 10.0)] for at in (0.0, 4096.0))
    first, second = prepare(join(early)), prepare(join(late))
    assert np.allclose(first.times, second.times, atol=1e-6)
    assert (first.pieces == second.pieces).all()
    assert np.allclose(first.commands.t[1:], second.commands.t[1:], atol=1e-6)


def test_experiments_must_come_one_after_the_other():
    with pytest.raises(ValueError, match='before the previous one has ended'):
        join([_experiment(0.0, 10.0), _experiment(5.0, 10.0)])
    with pytest.raises(ValueError, match='under a field'):
        join([_experiment(0.0, 10.0, field=0.0)])
    with pytest.raises(ValueError, match='under a field'):
        join([])


# Odds -------------------------------------------------------------------------------------------

def _asked(seed, effects, evidence=10.0, experiments=2):
    """A rig with hidden effects, and what random steps showed of it."""
    rig, _ = hidden_world(seed, effects, evidence)
    rng = np.random.default_rng(seed)
    played = [rig.play(random_steps(rng, 20.0, rig.limits)).session for _ in range(experiments)]
    return rig, played


@cache
def _considered(*asked, experiments=2):
    """What random steps show of a world, and what is known by it; several tests share one."""
    _, played = _asked(*asked, experiments=experiments)
    return played, consider([prepare(join(played))])


def test_the_evidence_is_the_integral_over_the_strength():
    _, played = _asked(3, ('coil_pull',), 40.0)
    found = fit_candidate(fit_first_order([prepare(join(played))]), 'coil_pull')
    # By brute force, on a grid of strengths, at the noise of the fit.
    base = without(found.fit, 'coil_pull')
    x = np.linspace(-3.0, 3.0, 4001) * 0.2
    centre = found.fit.model.vector()[0]
    costs = np.array([found.fit.under(found.fit.model.with_vector(np.array([centre + d]))).cost
                      for d in x])
    likelihood = np.exp((base.cost - costs) / 2)
    prior = np.mean([np.exp(-((centre + x) ** 2) / (2 * s**2)) / np.sqrt(2 * np.pi * s**2)
                     for s in np.geomspace(*EFFECTS['coil_pull'].prior, 7)], axis=0)
    brute = float(np.log(np.sum(likelihood * prior) * (x[1] - x[0])))
    assert log_bayes_factor(compare(found.fit, base, 'coil_pull')) == pytest.approx(brute, abs=0.1)


def test_what_is_hidden_is_likeliest_and_odds_are_odds():
    _, known = _considered(1, ('coil_gain_mismatch',), 60.0)
    assert known.names == ('coil_gain_mismatch',)
    odds = known.odds()
    assert odds['coil_gain_mismatch'] > 0.9
    assert all(0.0 <= share <= 1.0 for share in odds.values())
    assert judge(known).named == ('coil_gain_mismatch',)


def test_where_nothing_is_hidden_nothing_is_likelier():
    _, known = _considered(5, ())
    odds = known.odds()
    assert max(odds, key=odds.__getitem__) == ''
    assert sum(odds.values()) == pytest.approx(1.0)
    assert not judge(known).named


@pytest.mark.soak
def test_a_drift_is_not_alone_before_particles_have_been_about():
    played, known = _considered(1, ('uniform_drift',), 60.0)
    soon = judge(known)
    assert soon.named == soon.early == ('uniform_drift',)
    assert not soon.settled
    found, session = discovered(Driven(played, insight=Insight(known, soon)))
    assert [(effect.id, effect.status) for effect in found.effects] == [
        ('uniform_drift', 'established')]
    assert any('uniform drift: recorded for less than 210 s' in one for one in found.remarks)
    again = discover([session]).as_json()
    assert again['effects'] == found.as_json()['effects']
    assert again['verdict'] == found.verdict == 'named'


def test_a_hint_that_is_rather_chance_keeps_no_name_open():
    _, known = _considered(1, ('coil_gain_mismatch',), 60.0)
    hint = known.more[0]
    at = {evidence: judge(replace(known, more=(replace(hint, evidence=evidence),)))
          for evidence in (2.9, 3.0)}
    assert np.log(len(EFFECTS)) == pytest.approx(2.94, abs=0.01)
    assert at[2.9].settled
    assert not at[3.0].settled
    assert at[3.0].pending == (hint.id,)


@pytest.mark.parametrize(('own', 'seen', 'explained', 'behind'), [
    ('uniform_drift', True, 24.1, 2.2), ('uniform_drift', True, 23.9, np.inf),
    ('uniform_drift', False, 24.1, np.inf),
    ('linear_flow', True, 20.0, 2.2), ('linear_flow', False, 20.0, 2.2)])
def test_a_flow_is_told_from_the_flank_of_a_spot_and_a_drift_from_a_spot_that_explains_more(
        own, seen, explained, behind):
    one, spot = (Candidate(SimpleNamespace(
        id=name, shape_seen=shown, likelihood_ratio=ratio, dof=dof), evidence)
        for name, shown, ratio, dof, evidence in (
            (own, True, 20.0, 2, 8.6), ('hot_spot', seen, explained, 4, 6.4)))
    assert Slot(None, one, (spot,)).behind(spot) == pytest.approx(behind)
    ahead = replace(spot, evidence=9.0)
    assert Slot(None, one, (ahead,)).behind(ahead) == pytest.approx(-0.4)


@pytest.mark.parametrize(('hidden', 'in_a_list'), [
    ('poiseuille_flow', False), ('uniform_drift', True),
    pytest.param('linear_flow', True, marks=pytest.mark.soak)])
def test_a_field_of_place_is_asked_for_in_place_of_the_names_that_stand_in_for_it(
        hidden, in_a_list):
    _, known = _considered(1, (hidden,), 20.0, experiments=6)
    assert known.names
    assert learn_term(known.fit) is None
    judged = judge(known)
    told = scrutinised(known, judged)
    assert told.unlisted != in_a_list
    assert in_a_list or told.left[0].against == 'position'
    assert not in_a_list or not told.doubted
    # Nor are they named where prediction needs no more than what stands in.
    assert told.foretelling_nothing().named == (judged.named if in_a_list else ())


def test_what_is_surely_there_in_a_shape_that_was_not_seen_vouches_for_no_name():
    _, known = _considered(1, ('coil_gain_mismatch',), 60.0)
    spot = fit_candidate(known.fit, 'hot_spot')
    for seen, evidence, left in ((False, 33.0, ['position']), (False, 5.0, []), (True, 33.0, [])):
        own = Candidate(replace(spot, shape_seen=seen), evidence)
        beside = replace(known, slots=(*known.slots, replace(known.slots[0], own=own)))
        told = scrutinised(beside, Judgement(known.names, {}, ('hot_spot',), ()))
        assert [one.against for one in told.left] == left
        assert all(one.fires for one in told.left)
        assert not told.unlisted
        # It may itself stand in for another field of place.
        assert ('hot_spot' in told.doubted) == bool(left)


# Design -----------------------------------------------------------------------------------------

@pytest.fixture(name='late', scope='module')
def fixture_late():
    """A world with a delay, and what was seen of it."""
    rig, played = _asked(0, ('command_delay',), 25.0)
    plain = fit_first_order([prepare(join(played))])
    return rig, [fit_candidate(plain, name).fit for name in ('command_delay', 'alignment_lag')]


def _design(late, seed=0, limits=None, questions_=None):
    rig, (delay, lag) = late
    begin = float(delay.session_fits[0].session.times[-1]) + 1.0
    asked = [Question(delay, lag, 5.0)] if questions_ is None else questions_
    return choose_plan(delay, asked, Search({}, enough()), begin, 20.0, limits or rig.limits,
                       np.random.default_rng(seed))


def test_a_delay_and_a_lag_are_told_apart_sooner_than_by_random_steps(late):
    design = _design(late)
    assert design.worth > 1.5
    assert design.best[0] > 0
    assert design.plan.duration == pytest.approx(20.0)


def test_the_same_seed_asks_the_same_and_keeps_the_limits(late):
    one, other = _design(late, 3), _design(late, 3)
    assert (one.plan.angle == other.plan.angle).all()
    assert one.plan.strength.max() <= FIELD * (1 + 1e-12)
    weak = _design(late, 3, limits=Range(1e-3, VIEW))
    assert weak.plan.strength.max() <= 1e-3 * (1 + 1e-12)


def test_nobody_to_ask_is_said(late):
    _, (delay, lag) = late
    fit = delay.session_fits[0]
    gone = fit.session.times > fit.session.times[-1] - 5.0
    session = replace(fit.session, pieces=np.where(gone[:, None], 0, fit.session.pieces),
                      z=np.where(gone[:, None], 0, fit.session.z))
    unseen = replace(delay, session_fits=(replace(fit, session=session),))
    with pytest.raises(ValueError, match='no particle is in view'):
        _design((late[0], (unseen, lag)))


def test_what_was_seen_for_long_is_worth_less_to_see_again():
    shown = []
    for experiments in (3, 8):
        rig, played = _asked(7, (), experiments=experiments)
        session = prepare(join(played))
        fit = fit_first_order([session])
        trial = _Trial.of(fit, [], Search({}, 1.0), session.times[-1] + 1.0, rig.limits)
        shown.append(trial.score(random_steps(np.random.default_rng(1), 20.0, rig.limits)).shown)
    assert 0 < shown[1] < 0.8 * shown[0]


def test_where_nothing_is_asked_particles_go_where_they_have_not_been():
    rig, _ = hidden_world(1, ('uniform_drift',), 30.0)
    hover = Plan(np.resize([0.0, np.pi], 40), np.full(40, FIELD), np.full(40, 0.5))
    session = prepare(join([rig.play(hover).session for _ in range(4)]))
    fit = fit_candidate(fit_first_order([session]), 'uniform_drift').fit
    nothing, begin = Search({}, enough()), session.times[-1] + 1.0
    design = choose_plan(fit, [], nothing, begin, 20.0, rig.limits, np.random.default_rng(0))
    trial, rng = _Trial.of(fit, [], nothing, begin, rig.limits), np.random.default_rng(3)
    usual = [trial.score(random_steps(rng, 20.0, rig.limits)) for _ in range(9)]
    chosen = trial.score(design.plan)
    assert chosen.shown > 1.25 * np.median([one.shown for one in usual])
    assert _away(chosen, trial) > 40e-6 > 4 * _away(trial.score(hover), trial)


def _away(outcome, trial):
    """How far [m] the particle that goes furthest gets."""
    return np.hypot(*(outcome.session.causal_positions - trial.start).T).max()


def test_particles_that_would_touch_are_out_of_place(late):
    rig, (delay, _) = late
    begin = float(delay.session_fits[0].session.times[-1]) + 1.0
    trial = _Trial.of(delay, [], Search({}, 1.0), begin, rig.limits)
    assert len(trial.start) == 4
    still = Plan(np.zeros(1), np.zeros(1), np.ones(1))
    apart, near = (np.array([[0, 0], [0, 40e-6], [30e-6, 0], [x, 40e-6]])
                   for x in (30e-6, 7e-6))
    assert replace(trial, start=apart).score(still).touching == 0
    assert replace(trial, start=near).score(still).touching == pytest.approx(0.5)
    assert replace(trial, start=near).score(still).spoilt == pytest.approx(11.0)
    nobody = replace(trial.fit.session_fits[0].session, conditions=Conditions())
    fits = (replace(trial.fit.session_fits[0], session=nobody),)
    unknown = replace(trial, start=near, fit=replace(trial.fit, session_fits=fits))
    assert unknown.score(still).touching == 0


def test_what_is_the_same_can_not_be_told_apart(late):
    _, (delay, _) = late
    design = _design(late, questions_=[Question(delay, delay, 5.0)])
    assert design.best[0] < 1e-6


def test_before_a_name_the_likeliest_are_set_apart_by_the_odds_of_both():
    _, known = _considered(0, ('command_delay',), 25.0, experiments=1)
    assert not known.slots
    asked = likeliest(known)
    assert len(asked) == 10
    shares = softmax([0.0, *(one.evidence for one in known.more)])
    top = np.sort(shares)[::-1][:5]
    pairs = [top[i] * top[j] for i in range(5) for j in range(i + 1, 5)]
    assert sorted(one.weight for one in asked) == pytest.approx(sorted(pairs))
    assert any(known.fit in (one.first, one.second) for one in asked)


def test_a_hint_is_followed_where_one_plan_would_settle_it(late):
    rig, (delay, lag) = late
    begin = float(delay.session_fits[0].session.times[-1]) + 1.0
    asked = [Question(delay, lag, 5.0, 1.0)]
    design = choose_plan(delay, asked, None, begin, 10.0, rig.limits, np.random.default_rng(1))
    trial = _Trial.of(delay, asked, Search({}, 1.0), begin, rig.limits)
    rng = np.random.default_rng(2)
    usual = np.median([trial.score(random_steps(rng, 10.0, rig.limits)).gains for _ in range(9)])
    chosen = trial.score(design.plan)
    assert chosen.gains[0] > 2 * usual
    assert chosen.gains[0] <= design.best[0] * (1 + 1e-9)
    assert chosen.astray < 0.2


@pytest.mark.soak
def test_rollers_that_slip_at_low_frequencies_are_named_within_two_minutes():
    rig, _ = hidden_world(0, ('drive_response',))
    driven = drive(rig, 2.0, seed=0)
    assert driven.insight.judgement.named == ('drive_response',)
    assert driven.named_after < 90


# The loop ---------------------------------------------------------------------------------------

def test_it_ends_when_it_is_settled_and_says_how_it_came_to_that():
    rig, _ = hidden_world(1, ('coil_gain_mismatch',), 60.0)
    said = []
    driven = drive(rig, 1.5, said.append)
    assert driven.decided == 'settled'
    assert driven.named_after < driven.seconds
    assert driven.insight.judgement.named == ('coil_gain_mismatch',)
    assert driven.seconds < 120
    assert said[0].startswith('looking around: turning by')
    found, session = discovered(driven)
    assert found.verdict == 'named'
    assert [(e.id, e.status) for e in found.effects] == [('coil_gain_mismatch', 'established')]
    assert session.tracks.t[-1] <= driven.seconds
    told = as_json(driven)
    conforming('discovery/verdict', json.dumps({**found.as_json(), **told}, allow_nan=False))
    assert told['decided'] == 'settled'
    assert told['experiments'][-1]['odds']['coil_gain_mismatch'] > 0.98
    page = section(driven)
    assert 'The question was settled.' in page
    assert 'data:image/svg+xml' in page


def test_twins_are_told_before_time_is_out():
    rig, _ = hidden_world(1, ('coil_gain_mismatch',), 60.0)
    with _twin('coil_gain_mismatch'):
        driven = drive(rig, 6.0)
    assert driven.decided == 'undecidable'
    assert set(driven.twins[0]) == {'coil_gain_mismatch', 'coil_gain_mismatch_twin'}
    assert driven.seconds < 180


def test_what_is_in_no_list_is_told_with_what_it_depends_on_and_learned():
    rig, _ = hidden_world(1, ('speed_by_heading',), 60.0)
    driven = drive(rig, 1.0)
    judgement = driven.insight.judgement
    assert (driven.decided, judgement.unlisted) == ('settled', True)
    assert judgement.left[0].against == 'heading, along the heading'
    assert judgement.left[0].fires
    found, _ = discovered(driven)
    assert found.verdict == 'unnamed'
    assert not any(effect.status == 'established' for effect in found.effects)
    assert found.learned[0].term.against == 'heading'
    assert found.model.learned
    assert 'to confirm the learned term' in found.next_experiment.sentence
    assert ('no effect of the library explains the data. The residuals depend on heading'
            in section(driven))


@given(st.floats(0.0, 3600.0))
def test_an_experiment_is_brief_while_there_is_little_to_look_at(seconds):
    assert 10.0 <= lasting(seconds) <= 20.0
    assert lasting(seconds) <= max(10.0, seconds / 8)
    assert lasting(seconds) <= lasting(seconds + 1.0)


@pytest.mark.soak
def test_it_looks_again_and_again_until_time_is_out_and_names_nothing_rashly():
    rig, _ = hidden_world(2, (), 10.0)
    driven = drive(rig, 1.0)
    assert [look.seconds for look in driven.looks] == pytest.approx([10, 22, 34, 46, 58])
    assert driven.decided == 'out_of_time'
    assert driven.seconds <= 60 + 3.0
    assert not driven.insight.judgement.named


@pytest.mark.parametrize(('fired', 'unexplained'), [
    ('11111', True), ('1111', False), ('111011111', True), ('1110111', False), ('11111n', False)])
def test_what_is_left_for_long_at_every_look_is_in_no_list(fired, unexplained):
    judged = {'1': Judgement((), {}, (), (None,)), '0': Judgement((), {}, (), ()), 'n': None}
    looks = [Look('', '', 10.0 + 12.0 * k, judged[one], {}) for k, one in enumerate(fired)]
    assert _unexplained(Driven(looks=looks)) == unexplained


class _Broken:
    """A rig that ends its second experiment early."""

    def __init__(self, rig):
        self._rig, self._count = rig, 0
        self.limits = rig.limits

    @property
    def seconds(self):
        return self._rig.seconds

    def play(self, plan):
        self._count += 1
        if self._count == 1:
            return self._rig.play(plan)
        return Played(self._rig.play(plan.lasting(5.0)).session, 'the gate is disarmed')


@pytest.mark.soak
@pytest.mark.parametrize('seed', [7, 12, 14])
def test_what_thermal_noise_decides_names_nothing(monkeypatch, seed):
    """A heading that lags far behind is opposite to the field after a half turn, and which way it
    comes round is chance; before the first field has aligned it, it is anywhere.

    Long thoughts in which particles were turned to and fro, a weak first field, and one that ends
    while a heading is lost: each named a second effect in some such worlds, or took particles for
    gone.
    """
    monkeypatch.setattr(_driven_rig, 'PAUSE', 25.0)
    rng = np.random.default_rng(seed)
    swarm = draw_swarm(rng, 3, FLUID, FIELD, radius=2.3e-6, half_extent=50e-6, spacing=20e-6,
                       aligns_in=5e-5)
    inject_effect(swarm, 'alignment_lag', {'tau_s': 0.4}, FIELD)
    rig = _driven_rig.SimulatedRig(
        World(swarm, rng), Camera(10.0, 0.5, 0.05e-6),
        Conditions(radius=2.3e-6, viscosity=FLUID.viscosity, reference_field=FIELD), FIELD, rng)
    found = drive(rig, 2.0, seed=seed)
    assert found.decided != 'stopped'
    assert found.insight.judgement.named == ('alignment_lag',)
    assert found.insight.judgement.left == ()


def test_what_stops_a_rig_ends_it_with_what_was_learned():
    rig, _ = hidden_world(2, ('uniform_drift',), 10.0)
    driven = drive(_Broken(rig), 5.0)
    assert (driven.decided, driven.reason) == ('stopped', 'the gate is disarmed')
    assert len(driven.experiments) == 2
    found, _ = discovered(driven)
    assert any('the gate is disarmed' in remark for remark in found.remarks)


def test_nothing_seen_is_nothing_learned():
    driven = Driven()
    assert discovered(driven) is None
    assert as_json(driven) == {'decided': 'out_of_time', 'minutes': 0.0, 'experiments': []}


def test_a_hint_is_asked_about_before_anything_is_named():
    _, known = _considered(0, ('command_delay',), 25.0, experiments=3)
    asked = questions(known)
    assert asked
    assert all(question.missing > 0 for question in asked)
