"""The gap is measured on data that the fit did not see, and so is the gain."""

import numpy as np
import pytest

from microbot_ros.discovery.held_out import held_out_gap, log_e_value
from microbot_ros.discovery.input_checks import check_sessions
from microbot_ros.discovery.next_experiment import next_experiment
from microbot_ros.discovery.stepwise_selection import StepwiseSelection, contribution
from microbot_ros.model.effects import EFFECTS


@pytest.fixture(scope='module')
def drifting(film):
    session, _ = film(30, {'uniform_drift': {'wx_um_s': 0.8, 'wy_um_s': 0.0}})
    return StepwiseSelection(check_sessions([session])[0])


def test_gap_is_the_distance_that_the_drift_carries(drifting):
    """In one second 0.8 µm along one axis of two, less what v and φ absorb."""
    truth = drifting.current.model.with_effect(EFFECTS['uniform_drift'](0.8e-6, 0.0))
    gap = held_out_gap(drifting.current, drifting.fit(truth), truth)
    assert gap.horizon == 1.0
    assert gap.before == pytest.approx(0.8e-6 / np.sqrt(2), rel=0.25)
    assert gap.after < 0.2e-6
    assert gap.truth < 0.2e-6
    diffusion = drifting.fit(truth).session_fits[0].diffusion
    assert gap.floor == pytest.approx(np.sqrt(2 * diffusion + 2 * 0.1e-6**2), rel=0.1)


def test_e_value_grows_for_what_is_there_and_not_for_what_is_not(drifting):
    model = drifting.current.model
    there = drifting.fit(model.with_effect(EFFECTS['uniform_drift'](0.5e-6, 0.0)))
    assert log_e_value(there, 'uniform_drift') > 20
    absent = drifting.fit(there.model.with_effect(EFFECTS['coil_misalignment'](0.01)))
    assert log_e_value(absent, 'coil_misalignment') < 3


def test_contribution_is_the_likelihood_ratio_beside_the_rest(drifting):
    fit = drifting.fit(drifting.current.model.with_effect(EFFECTS['uniform_drift'](0.5e-6, 0.0)))
    own = contribution(fit, 'uniform_drift')
    assert own.likelihood_ratio == pytest.approx(drifting.current.cost - fit.cost, abs=0.5)
    assert own.dof == 2
    assert own.p_value < 1e-10


def test_next_experiment_changes_the_field_to_tell_a_pull_from_slowness(film):
    """A pull along the field grows with it; slowness in weak fields does not add up to one."""
    session, _ = film(31, {'coil_pull': {'rate_um_s_mT': 0.4}}, levels=(2e-3, 5e-3))
    selection = StepwiseSelection(check_sessions([session])[0])
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
    selection = StepwiseSelection(check_sessions([session])[0])
    fit = selection.fit(selection.current.model.with_effect(EFFECTS['gradient_force'](1.0)))
    still = EFFECTS['linear_flow'](0, 0, 0, 0)
    flow = selection.fit(selection.current.model.with_effect(still)).model
    found = next_experiment(fit, [flow])
    assert 'in all directions' in found.sentence
    assert 0 < found.minutes < 1
