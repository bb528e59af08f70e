"""The composition of effects into a model, and its parameters as one vector."""

import itertools
from dataclasses import dataclass

import numpy as np
import pytest

from microbot_ros.common.records import Commands, Conditions
from microbot_ros.model.effect import Effect
from microbot_ros.model.effects import EFFECTS
from microbot_ros.model.effects.field.background_field import BackgroundField
from microbot_ros.model.effects.field.coil_gain_mismatch import CoilGainMismatch
from microbot_ros.model.effects.field.command_delay import CommandDelay
from microbot_ros.model.effects.heading.alignment_lag import AlignmentLag
from microbot_ros.model.effects.velocity.periodic_drift import PeriodicDrift
from microbot_ros.model.effects.velocity.speed_decay import SpeedDecay
from microbot_ros.model.effects.velocity.uniform_drift import UniformDrift
from microbot_ros.model.model import Model
from microbot_ros.model.parameter import parameter


def test_the_order_of_discovery_does_not_matter():
    effects = (UniformDrift(1e-6, 0.0), BackgroundField(1e-4, 0.0), CoilGainMismatch(1.2))
    models = {Model(1e-3, effects=order) for order in itertools.permutations(effects)}
    assert len(models) == 1
    # The coils act on the command, the background on neither.
    np.testing.assert_allclose(models.pop().field(np.array([0.0, 1e-3])), [1e-4, 1.2e-3])


def test_effects_are_added_replaced_and_taken_away():
    model = Model(1e-3).with_effect(AlignmentLag(0.1)).with_effect(UniformDrift(1e-6, 0.0))
    assert model.with_effect(AlignmentLag(0.2)).effect('alignment_lag') == AlignmentLag(0.2)
    assert model.without('alignment_lag') == Model(1e-3, effects=(UniformDrift(1e-6, 0.0),))
    assert model.without('hot_spot') == model
    assert model.effect('hot_spot') is None


def test_two_of_a_kind_are_refused():
    with pytest.raises(ValueError, match='one of a kind'):
        Model(1e-3, effects=(AlignmentLag(0.1), AlignmentLag(0.2)))


@pytest.mark.parametrize('field', [0.0, -1e-3, np.nan, np.inf])
def test_the_reference_field_must_be_positive(field):
    with pytest.raises(ValueError, match='reference_field must be positive'):
        Model(field)


def test_the_vector_goes_to_parameters_and_back():
    model = Model(1e-3, effects=tuple(effect.null() for effect in EFFECTS.values()))
    strengths = [not p.shape for _, p in model.parameters]
    assert not model.vector()[strengths].any()
    at = np.random.default_rng(0).uniform(0.5, 2.0, len(model.parameters))
    np.testing.assert_allclose(model.with_vector(at).vector(), at, rtol=1e-12)
    assert model.with_vector(model.vector()) == model


def test_what_vanishes_at_infinity_is_fitted_by_its_rate():
    model = Model(1e-3, effects=(SpeedDecay(50.0),))
    np.testing.assert_allclose(model.vector(), [2.0])
    assert model.with_vector(np.zeros(1)).effects == (SpeedDecay(np.inf),)


def test_a_baseline_takes_its_reference_from_the_conditions_or_the_commands():
    commands = Commands(np.arange(4.0), np.array([[2e-3, 0], [0, 0], [0, -3e-3], [2e-3, 0]]))
    stated = Conditions(propulsion='rolling', reference_field=1.5e-3)
    assert Model.baseline(stated, commands) == Model(1.5e-3, 'rolling')
    assert Model.baseline(Conditions(), commands) == Model(2e-3)
    silent = Commands(np.zeros(0), np.zeros((0, 2)))
    assert Model.baseline(Conditions(), silent) == Model(1e-3)


@dataclass(frozen=True)
class SlowWhereItIsFar(Effect):
    """A lag of another package: at the origin twice `tau`, however strong the field."""

    id = 'far_lag'
    stage = 'heading'
    summary = 'It lags.'
    required_excitation = 'any'
    confounded_with = ('alignment_lag',)
    needs_position = True
    tau: float = parameter('tau_s', 'time', 0.0, 10.0, 1.0)

    def alignment_rate(self, context):
        return 1 / (self.tau * (2 + np.abs(context.position).sum(axis=-1)))

    def latency(self):
        return 0.25


def test_any_effect_that_lags_or_delays_counts_as_such():
    model = Model(1e-3, effects=(UniformDrift(1e-6, 0.0), PeriodicDrift(1e-6, 0.2)))
    assert not model.lags
    assert model.alignment_time == 0
    assert model.undelayed() == model
    assert model.without_swings() == model.without('periodic_drift')
    assert Model(1e-3, effects=(AlignmentLag(0.0),)).lags
    assert Model(1e-3, effects=(AlignmentLag(0.0),)).alignment_time == 0
    for tau in np.random.default_rng(0).uniform(0.01, 5, 20):
        assert Model(3e-3, effects=(AlignmentLag(tau),)).alignment_time == pytest.approx(
            tau, rel=1e-15)
    late = model.with_effect(SlowWhereItIsFar(0.3)).with_effect(CommandDelay(0.5))
    assert late.lags
    assert late.alignment_time == pytest.approx(0.6)
    assert late.delay == 0.75
    assert late.undelayed() == model
    decaying = model.with_effect(SpeedDecay(20.0))
    assert decaying.without_swings() == decaying.without('periodic_drift')
