"""A walk over the built-in effects: what the kit does not ask of each."""

import dataclasses

import numpy as np
import pytest

from microbot_ros.common import units
from microbot_ros.conformance import plain
from microbot_ros.model.effects import EFFECTS
from microbot_ros.model.effects.velocity.incomplete_alignment import langevin_function

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


def test_the_library_is_the_public_one():
    assert set(EFFECTS) == set(PUBLIC)
    for name, expected in PUBLIC.items():
        parameters = EFFECTS[name].parameters()
        assert tuple(p.name for p in parameters)[:len(expected)] == expected
        if expected:  # what the interface does not list need not be given
            more = {p.field for p in parameters[len(expected):]}
            assert set(EFFECTS[name].defaults()) == more


@pytest.mark.parametrize('effect', EFFECTS.values(), ids=EFFECTS)
def test_parameters_are_in_si_in_files_and_fits_and_lookalikes_name_each_other(effect):
    fields = [field.name for field in dataclasses.fields(effect)]
    assert [p.field for p in effect.parameters()] == fields
    for p in effect.parameters():
        dimensionless = {'gain_ratio', 'aspect', 'slip', 'cut_in_steepness', 'step_out_steepness'}
        assert (units.suffix(p.name) == '') == (p.name in dimensionless)
        assert p.from_fit(0.0) == p.null_value
        value = getattr(plain(effect), p.field)
        assert p.from_fit(p.to_fit(value)) == pytest.approx(value, rel=1e-12)
        assert p.fit_bounds[0] <= p.to_fit(value) <= p.fit_bounds[1]
        for bound, beyond in zip(p.fit_bounds, (-1.0, 1.0), strict=True):
            assert p.from_fit(bound + beyond) == pytest.approx(p.from_fit(bound), rel=1e-12)
    assert effect.confounded_with
    for other in effect.confounded_with:
        named_back = EFFECTS[other].confounded_with
        assert effect.id in named_back, f'{other} does not name {effect.id} back'


def test_langevin_between_its_limits():
    x = np.array([0.0, 1e-6, 9.999e-3, 1.0001e-2, 1.0, 50.0, 1e9])
    exact = [0.0, 1e-6 / 3, 9.999e-3 / 3 - 9.999e-3**3 / 45, 1.0001e-2 / 3 - 1.0001e-2**3 / 45,
             0.31303528549933130, 1 - 1 / 50, 1 - 1e-9]
    np.testing.assert_allclose(langevin_function(x), exact, rtol=1e-9)
