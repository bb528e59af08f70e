"""The height above the floor on its way into the nodes that use drag."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest
from oracles import sliding_near_a_wall

from microbot_ros.common.errors import InputError
from microbot_ros.common.units import BOLTZMANN
from microbot_ros.estimation.likelihood.noise import stokes_einstein
from microbot_ros.loop.model import ModelParameters, ModelStage
from microbot_ros.model.physics.floor import rolling_factor, spinning_factor

RADIUS, HEIGHT = 2.3e-6, 2.6e-6


def test_the_model_estimates_with_the_drag_at_its_height() -> None:
    told = ModelParameters(radius_um=2.3, viscosity_mPa_s=1.245, height_um=2.6)
    diffusion, _ = stokes_einstein(ModelStage(told).estimator.conditions)  # type: ignore[misc]
    bulk = BOLTZMANN * 298.0 / (6 * math.pi * 1.245e-3 * RADIUS)
    assert diffusion == pytest.approx(bulk / sliding_near_a_wall(HEIGHT, RADIUS), rel=1e-3)
    far = ModelParameters(radius_um=2.3, viscosity_mPa_s=1.245)
    assert ModelStage(far).estimator.conditions.height is None


@pytest.mark.parametrize('node', ['model', 'virtual_rig'])
@pytest.mark.parametrize('height_um', [2.3, 1.0])
def test_a_particle_in_the_floor_is_refused(ros: Any, tmp_path: Path, node: str,
                                            height_um: float) -> None:
    values: dict[str, Any] = {'radius_um': 2.3, 'height_um': height_um}
    if node == 'virtual_rig':
        values['amplifier_log'] = str(_log(tmp_path))
    with pytest.raises(InputError, match=f'{node}: expected height_um to be more than radius_um'):
        ros({node: values}).add(node)


def test_what_lives_in_the_virtual_rig_lives_above_its_floor(ros: Any, tmp_path: Path) -> None:
    made = ros({'virtual_rig': {
        'radius_um': 2.3, 'height_um': 2.6, 'alignment_ms': 5.0, 'viscosity_mPa_s': 1.245,
        'temperature_K': 298.0, 'gains_um_s_hz': [3.0, 3.0, 3.0],
        'amplifier_log': str(_log(tmp_path))}}).add('virtual_rig')
    assert made.active, made.fault
    bulk = 6 * math.pi * 1.245e-3 * RADIUS
    assert made._world.bodies['diffusion'] == pytest.approx(
        BOLTZMANN * 298.0 / (bulk * sliding_near_a_wall(HEIGHT, RADIUS)), rel=1e-3)
    # The moment that turns a heading in 5 ms at 5 mT turns a roller, about an axis along the
    # floor, against more drag.
    assert made._rolling._mobility == pytest.approx(
        1 / (5e-3 * 5e-3) * spinning_factor(HEIGHT, RADIUS) / rolling_factor(HEIGHT, RADIUS))


def _log(folder: Path) -> Path:
    """Of an amplifier that was just switched on."""
    log = folder / 'amplifier.jsonl'
    log.write_text(json.dumps(
        {'t_monotonic_s': 0.0, 'currents_A': [0.0] * 4, 'cause': 'reset'}) + '\n')
    return log
