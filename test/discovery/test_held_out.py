"""The gap is measured on data that the fit did not see, and so is the gain."""

from dataclasses import replace
from unittest import mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from microbot_ros.discovery.check.held_out import HeldOut, hold_out, mean_by_stretch
from microbot_ros.discovery.check.input_checks import check_sessions
from microbot_ros.discovery.hypotheses import add_effects, fit_first_order
from microbot_ros.discovery.next_experiment import next_experiment
from microbot_ros.discovery.result import Gap
from microbot_ros.discovery.search import contribution
from microbot_ros.estimation.likelihood.model_fit import fit_sessions
from microbot_ros.model.effects import EFFECTS
from microbot_ros.model.physics.vectors import as_vectors


def held_out_gap(fit, *rest):
    """Return the gap over the noise of the `fit` itself."""
    return hold_out(fit, *rest).gap(fit)


class Start:
    """A session as discovery begins with it: prepared, and fitted by the first-order model."""

    def __init__(self, session):
        self.sessions, _ = check_sessions([session])
        self.current = fit_first_order(self.sessions)

    def fit(self, model):
        """Return a `model` fitted to the session."""
        return fit_sessions(model, self.sessions)


@pytest.fixture(scope='module')
def drifting(film):
    session, _ = film(30, {'uniform_drift': {'wx_um_s': 0.8, 'wy_um_s': 0.0}})
    return Start(session)


def test_gap_is_the_distance_that_the_drift_carries(drifting):
    """In one second 0.8 µm along one axis of two, less what v and φ absorb."""
    truth = drifting.current.model.with_effect(EFFECTS['uniform_drift'](0.8e-6, 0.0))
    gap = held_out_gap(drifting.fit(truth), drifting.sessions, EFFECTS, truth)
    assert gap.horizon == 1.0
    assert gap.before == pytest.approx(0.8e-6 / np.sqrt(2), rel=0.25)
    assert gap.after < 0.2e-6
    assert gap.truth < 0.2e-6
    # Of the same displacements: what the floor is does not matter.
    assert gap.closed.value == pytest.approx(gap.before**2 - gap.after**2, abs=0.01e-12)
    assert 0 < gap.closed.low < gap.closed.value < gap.closed.high < 2 * gap.closed.value
    diffusion = drifting.fit(truth).session_fits[0].diffusion
    assert gap.floor == pytest.approx(np.sqrt(2 * diffusion + 2 * 0.1e-6**2), rel=0.1)


@pytest.mark.parametrize(('after', 'learned', 'worth', 'in_doubt'), [
    (1.5, 1.0, True, True), (1.005, 1.0, False, True), (1.0, 1.5, False, True),
    (1.1, None, True, True), (1.005, None, False, True), (0.5, None, False, True),
    (1.005, 1.995, False, False)])
def test_what_foretells_nothing_is_not_worth_explaining(drifting, after, learned, worth, in_doubt):
    """A hundredth of the squared noise floor, of what a term closes or of what is left.

    Beside effects that may stand in for another cause, of what is there without them.
    """
    fit = drifting.current
    squared = held_out_gap(fit, drifting.sessions, ()).floor ** 2
    squares = {'before': 2.0, 'after': after} | ({} if learned is None else {'learned': learned})
    held = HeldOut(1.0, {name: np.full(40, one * squared) for name, one in squares.items()},
                   np.arange(40) // 2)
    assert held.worth_explaining(fit) == worth
    assert held.worth_explaining(fit, 'before') == in_doubt


def test_nothing_held_out_leaves_the_verdict(drifting):
    empty = HeldOut(1.0, dict.fromkeys(('before', 'after'), np.empty(0)), np.empty(0))
    assert empty.worth_explaining(drifting.current)


def test_what_is_selected_in_each_block_is_what_is_judged(drifting):
    """Names that were found on all rows do not count: a model without them has the same gap."""
    truth = drifting.current.model.with_effect(EFFECTS['uniform_drift'](0.8e-6, 0.0))
    named, bare = (held_out_gap(one, drifting.sessions, EFFECTS)
                   for one in (drifting.fit(truth), drifting.current))
    assert bare.closed.value == pytest.approx(named.closed.value, rel=1e-3)
    none = held_out_gap(drifting.current, drifting.sessions, ())
    assert none.before == none.after
    assert (none.closed.value, none.closed.std) == (0, 0)
    assert len(none.sentences()) == 1


def test_a_heading_is_known_from_the_rows_before_a_prediction(film):
    """Turns of nearly 180° scatter headings, and a lag keeps for long what scattered them."""
    session, _ = film(60, {'alignment_lag': {'tau_s': 0.76}}, duration=60.0)
    lagging = Start(session)
    fit = lagging.fit(lagging.current.model.with_effect(EFFECTS['alignment_lag'](0.7)))
    with mock.patch('microbot_ros.discovery.check.held_out._by_headings', return_value=0.0):
        without = held_out_gap(fit, lagging.sessions, {'alignment_lag'})
    gap = held_out_gap(fit, lagging.sessions, {'alignment_lag'})
    assert gap.after < without.after
    assert gap.before == without.before


def test_the_interval_of_what_was_closed_covers_where_rows_overlap():
    """Differences of displacements over 20 frames hang together for as long."""
    rng, stretch = np.random.default_rng(1), np.arange(600) // 50
    covered = 0
    for _ in range(300):
        rows = np.convolve(rng.normal(size=619), np.ones(20) / 20, 'valid')
        found = mean_by_stretch(rows, stretch)
        covered += found.low < 0 < found.high
    assert 0.90 < covered / 300 <= 0.98
    assert np.isnan(mean_by_stretch(np.ones(5), np.zeros(5)).low)


def test_a_gap_that_is_not_known_is_said_to_be():
    said, = Gap(1.0, np.nan, np.nan, 1e-7).sentences()
    assert 'not known' in said
    assert 'nan' not in said


def test_headings_that_chance_has_scattered_are_no_gap(film):
    """Turns of nearly 180° under a lag: what the lag can't foretell is not judged."""
    session, _ = film(34, {'alignment_lag': {'tau_s': 0.4}}, duration=60.0, dwell=(0.4, 1.5))
    lagging = Start(session)
    fit = lagging.fit(lagging.current.model.with_effect(EFFECTS['alignment_lag'](0.4)))
    assert fit.session_fits[0].session.seen.sum() < lagging.sessions[0].seen.sum()
    gap = held_out_gap(fit, lagging.sessions, {'alignment_lag'})
    assert gap.after < 0.1 * gap.before


def block_of(session, blocks):
    """The block (T,) of every frame, of so many of equal length."""
    times = session.times
    return np.minimum((times - times[0]) / np.ptp(times) * blocks, blocks - 1).astype(int)


def _searched(sessions):
    return add_effects(fit_first_order(sessions), sessions, EFFECTS)


@given(block=st.integers(0, 3), strength=st.floats(0.1, 100.0), seed=st.integers(0, 99))
@settings(max_examples=3)
def test_no_change_of_a_hidden_block_moves_a_fit_by_a_bit(drifting, block, strength, seed):
    session, = drifting.sessions
    hidden = block_of(session, 4) == block
    moved = np.random.default_rng(seed).normal(size=(hidden.sum(), len(session.ids), 2))
    places = session.causal_positions.copy()
    places[hidden] += np.cumsum(strength * 1e-6 * moved, axis=0)
    other = replace(session, causal_positions=places, z=places @ [1, 1j])
    here, there = (_searched([s.only(~hidden)]) for s in (session, other))
    assert here.model.effect('uniform_drift')
    assert (here.model.vector() == there.model.vector()).all()
    known, found = here.session_fits[0], there.session_fits[0]
    assert (known.velocity_phasor == found.velocity_phasor).all()
    assert (known.diffusion, known.whitening) == (found.diffusion, found.whitening)
    assert here.cost == there.cost
    assert known.count < drifting.current.session_fits[0].count


def test_what_happens_in_a_hidden_block_is_not_found_in_the_others(film):
    """Drift in the second of four blocks alone: the rest says nothing of it."""
    session, _ = film(32, duration=60.0)
    whole, = check_sessions([session])[0]
    pushed = np.cumsum(np.where(block_of(whole, 4) == 1, 2e-6 * whole.interval, 0))[:, None]
    z = whole.z + pushed
    moved = replace(whole, z=z, causal_positions=as_vectors(z))
    shown = block_of(whole, 4) != 1
    assert not _searched([moved.only(shown)]).model.effects
    assert _searched([moved]).model.effects


def test_contribution_is_the_likelihood_ratio_beside_the_rest(drifting):
    fit = drifting.fit(drifting.current.model.with_effect(EFFECTS['uniform_drift'](0.5e-6, 0.0)))
    own = contribution(fit, 'uniform_drift')
    assert own.likelihood_ratio == pytest.approx(drifting.current.cost - fit.cost, abs=0.5)
    assert own.dof == 2
    assert own.p_value < 1e-10


def test_next_experiment_changes_the_field_to_tell_a_pull_from_slowness(film):
    """A pull along the field grows with it; slowness in weak fields does not add up to one."""
    session, _ = film(31, {'coil_pull': {'rate_um_s_mT': 0.4}}, levels=(2e-3, 5e-3))
    selection = Start(session)
    pull, slow = (selection.fit(selection.current.model.with_effect(EFFECTS[name](start)))
                  for name, start in (('coil_pull', 1e-4), ('incomplete_alignment', 1e-4)))
    found = next_experiment(pull, [slow.model])
    assert 'a third of the field' in found.sentence
    assert 0 < found.minutes < 10
    assert next_experiment(pull, []) is None
    # What is the same model under every command can't be told by any.
    assert np.isinf(next_experiment(pull, [pull.model]).minutes)


def test_next_experiment_turns_the_field_to_tell_a_gradient_from_a_flow(film):
    session, _ = film(31, {'gradient_force': {'rate_per_s_mT': 0.003}})
    selection = Start(session)
    fit = selection.fit(selection.current.model.with_effect(EFFECTS['gradient_force'](1.0)))
    still = EFFECTS['linear_flow'](0, 0, 0, 0)
    flow = selection.fit(selection.current.model.with_effect(still)).model
    found = next_experiment(fit, [flow])
    assert 'in all directions' in found.sentence
    assert 0 < found.minutes < 1
