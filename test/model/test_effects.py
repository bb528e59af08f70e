"""A walk over the built-in effects: names, units, strength zero; the rest is in the kit."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from microbot_ros.common import units
from microbot_ros.common.records import Commands
from microbot_ros.model.effects import EFFECTS
from microbot_ros.model.effects.velocity.incomplete_alignment import langevin_function
from microbot_ros.model.increments import respond
from microbot_ros.model.model import Model, ParticleParameters
from microbot_ros.model.timeline import Timeline

# The public names, as the interface states them.
PUBLIC = {
    'uniform_drift': ('wx_um_s', 'wy_um_s'),
    'linear_flow': ('gxx_per_s', 'gxy_per_s', 'gyx_per_s', 'gyy_per_s'),
    'alignment_lag': ('tau_s',),
    'background_field': ('bx_mT', 'by_mT'),
    'coil_gain_mismatch': ('gain_ratio',),
    'coil_misalignment': ('skew_rad',),
    'speed_decay': ('tau_s',),
    'command_delay': ('delay_s',),
    'heading_slip': ('rate_rad_s',),
    'dipole_interaction': ('strength_um5_s',),
    'hydrodynamic_slowdown': ('length_um',),
    'hot_spot': ('x_um', 'y_um', 'speed_um_s', 'width_um'),
    'periodic_drift': ('amplitude_um_s', 'frequency_hz'),
    'amplifier_deadband': ('deadband_mT',),
    'pixel_anisotropy': ('aspect',),
    'gradient_force': ('rate_per_s_mT',),
    'coil_pull': ('rate_um_s_mT',),
    'incomplete_alignment': ('field_scale_mT',),
    'drive_response': (),
}
# An instance of each at plain strength; shapes away from their stand-ins.
PLAIN = {
    name: effect(**{
        p.field: p.from_fit(1.3) if p.shape or p.inverse else p.null_value + 0.7 * p.scale
        for p in effect.parameters()
    })
    for name, effect in EFFECTS.items()
}
every_effect = pytest.mark.parametrize('effect', EFFECTS.values(), ids=EFFECTS)


def commands() -> Commands:
    """Random steps of direction, strength and frequency, a zero and switches inside frames."""
    rng = np.random.default_rng(5)
    t = np.array([-1.0, 0.0, 0.91, 2.017, 2.8, 3.55, 4.49])
    angle = rng.uniform(-np.pi, np.pi, len(t))
    field = rng.uniform(1e-3, 4e-3, len(t))[:, None] * np.stack([np.cos(angle), np.sin(angle)], 1)
    field[4] = 0.0
    return Commands(t, field, rng.uniform(0.5, 20.0, len(t)))


def particles(count: int = 3) -> ParticleParameters:
    return ParticleParameters(
        np.arange(count), np.linspace(3e-6, 5e-6, count), np.linspace(-2.0, 3.0, count))


def timeline(count: int = 3, frames: int = 151) -> Timeline:
    rng = np.random.default_rng(6)
    start = rng.uniform(-30e-6, 30e-6, (1, count, 2))
    walk = np.cumsum(rng.normal(0, 1e-7, (frames, count, 2)), axis=0)
    return Timeline(commands(), np.arange(frames) / 30, start + walk)


def model_of(effect) -> Model:
    return Model(2e-3, 'rolling' if effect.id == 'drive_response' else 'catalytic', (effect,))


def moved(effect, line: Timeline | None = None) -> np.ndarray:
    line = line or timeline()
    count = line.positions.shape[1]
    return respond(model_of(effect), line).increments(particles(count))


def baseline(effect, line: Timeline) -> np.ndarray:
    model = dataclasses.replace(model_of(effect), effects=())
    return respond(model, line).increments(particles())


def test_the_library_is_the_public_one():
    assert set(EFFECTS) == set(PUBLIC)
    for name, expected in PUBLIC.items():
        parameters = EFFECTS[name].parameters()
        assert tuple(p.name for p in parameters)[:len(expected)] == expected
        if expected:  # what the interface does not list need not be given
            more = {p.field for p in parameters[len(expected):]}
            assert set(EFFECTS[name].defaults()) == more


@every_effect
def test_parameters_have_units_ranges_and_a_field_in_si(effect):
    fields = [field.name for field in dataclasses.fields(effect)]
    assert [p.field for p in effect.parameters()] == fields
    for p in effect.parameters():
        dimensionless = {'gain_ratio', 'aspect', 'slip', 'cut_in_steepness', 'step_out_steepness'}
        assert (units.suffix(p.name) == '') == (p.name in dimensionless)
        assert p.meaning
        assert p.scale > 0
        assert p.low < p.high
        assert p.low <= p.null_value <= p.high
        assert p.to_fit(p.null_value) == 0
        assert p.from_fit(0.0) == p.null_value
        value = getattr(PLAIN[effect.id], p.field)
        assert p.from_fit(p.to_fit(value)) == pytest.approx(value, rel=1e-12)
        assert p.fit_bounds[0] <= p.to_fit(value) <= p.fit_bounds[1]
    assert any(not p.shape for p in effect.parameters())


@every_effect
def test_it_says_what_it_is_and_what_it_is_mistaken_for(effect):
    assert effect.stage in ('field', 'heading', 'velocity', 'observation')
    assert effect.__doc__
    assert effect.summary.endswith('.')
    assert effect.required_excitation
    assert effect.id not in effect.confounded_with
    assert effect.confounded_with
    for other in effect.confounded_with:
        named_back = EFFECTS[other].confounded_with
        assert effect.id in named_back, f'{other} does not name {effect.id} back'


@every_effect
@settings(max_examples=10)
@given(data=st.data())
def test_at_strength_zero_it_does_nothing_whatever_its_shape(effect, data):
    shapes = {
        p.field: data.draw(st.floats(p.low, p.high), p.name)
        for p in effect.parameters() if p.shape
    }
    line = timeline(frames=31)
    off = dataclasses.replace(effect.null(), **shapes)
    np.testing.assert_allclose(moved(off, line), baseline(effect, line), rtol=1e-12, atol=1e-21)


def test_langevin_between_its_limits():
    x = np.array([0.0, 1e-6, 9.999e-3, 1.0001e-2, 1.0, 50.0, 1e9])
    exact = [0.0, 1e-6 / 3, 9.999e-3 / 3 - 9.999e-3**3 / 45, 1.0001e-2 / 3 - 1.0001e-2**3 / 45,
             0.31303528549933130, 1 - 1 / 50, 1 - 1e-9]
    np.testing.assert_allclose(langevin_function(x), exact, rtol=1e-9)


@pytest.mark.parametrize('name', ['hot_spot', 'linear_flow', 'gradient_force',
                                  'dipole_interaction', 'hydrodynamic_slowdown'])
def test_without_positions_an_effect_that_needs_them_says_so(name):
    assert EFFECTS[name].needs_position
    blind = Timeline(commands(), np.arange(31) / 30)
    with pytest.raises(ValueError, match='needs positions'):
        respond(model_of(PLAIN[name]), blind)
