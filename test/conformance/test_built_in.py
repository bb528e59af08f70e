"""The built-in effects pass the kit that other packages' effects are tried by."""

import pytest

from microbot_ros.conformance import exercise, exercise_discovery
from microbot_ros.model.effects import BUILT_IN, EFFECTS

# But for those of pairs, which need particles nearer together than the kit's.
PLAINLY_THERE = {
    'command_delay': {'delay': 0.5},
    'amplifier_deadband': {'deadband': 1e-3},
    'coil_gain_mismatch': {'gain_ratio': 0.6},
    'coil_misalignment': {'skew': 0.4},
    'background_field': {'bx': 1.2e-3, 'by': 0.8e-3},
    'alignment_lag': {'tau': 0.4},
    'heading_slip': {'rate': 0.05},
    'incomplete_alignment': {'field_scale': 2e-3},
    'drive_response': {'cut_in': 2.0, 'slip': 0.0, 'step_out': 50.0},
    'speed_decay': {'tau': 20.0},
    'uniform_drift': {'wx': 1.2e-6, 'wy': -0.6e-6},
    'linear_flow': {'gxx': 0.03, 'gxy': -0.04, 'gyx': 0.02, 'gyy': -0.03},
    'periodic_drift': {'amplitude': 2e-6, 'frequency': 0.25, 'direction': 0.7},
    'hot_spot': {'x': 5e-6, 'y': 5e-6, 'speed': 6e-6, 'width': 20e-6},
    'gradient_force': {'rate': 20.0},
    'coil_pull': {'rate': 6e-4},
    'pixel_anisotropy': {'aspect': 1.4},
}


@pytest.mark.parametrize('kind', BUILT_IN, ids=lambda kind: kind.id)
def test_every_built_in_effect_keeps_the_contract(kind):
    exercise(kind)


@pytest.mark.parametrize(('name', 'values'), PLAINLY_THERE.items(), ids=PLAINLY_THERE)
def test_discovery_finds_it_where_it_is(name, values):
    exercise_discovery(EFFECTS[name](**values))
