"""The composition of effects into a model, and its parameters as one vector."""

import itertools

import numpy as np
import pytest

from microbot_ros.model.effects import EFFECTS
from microbot_ros.model.effects.alignment_lag import AlignmentLag
from microbot_ros.model.effects.background_field import BackgroundField
from microbot_ros.model.effects.coil_gain_mismatch import CoilGainMismatch
from microbot_ros.model.effects.speed_decay import SpeedDecay
from microbot_ros.model.effects.uniform_drift import UniformDrift
from microbot_ros.model.model import Model, ParticleParameters
from microbot_ros.records import Commands, Conditions


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


def test_velocity_in_the_frame_of_the_field_and_back():
    particles = ParticleParameters(np.array([4, 7]), np.array([1e-6, 2e-6]), np.array([0.3, -3.0]))
    back = ParticleParameters.from_velocity_phasor(particles.ids, particles.velocity_phasor)
    np.testing.assert_allclose(back.speed, particles.speed)
    np.testing.assert_allclose(back.phi, particles.phi)
