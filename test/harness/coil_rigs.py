"""Rigs for the tests of coils: those of config, and coils scattered anywhere."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from microbot_ros.common.files import read_yaml
from microbot_ros.magnetics import CoilSet, CoilSettings

CONFIG = Path(__file__).parents[2] / 'config'
SIX, EIGHT = (read_yaml(CONFIG / f'coils_{number}.yaml', CoilSettings)
              for number in ('six', 'eight'))


def scattered(seed: int, count: int, axes: str = 'xyz', background: float = 0.05) -> CoilSet:
    """Coils anywhere around the workspace, none like the other, facing it roughly."""
    rng = np.random.default_rng(seed)
    windings = []
    for k in range(count):
        outward = rng.normal(size=3)
        outward /= np.linalg.norm(outward)
        windings.append({
            'name': f'coil_{k}', 'position_mm': rng.uniform(40, 80) * outward,
            'axis': outward + rng.normal(0, 0.2, 3), 'radius_mm': rng.uniform(15, 30),
            'turns': int(rng.integers(300, 900)), 'resistance_ohm': rng.uniform(1, 6),
            'max_current_A': rng.uniform(1, 4), 'sign': int(rng.choice([-1, 1]))})
    return CoilSet(CoilSettings.from_content({
        'windings': windings, 'axes': axes,
        'background_mT': rng.uniform(-background, background, len(axes))}))
