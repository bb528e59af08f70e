"""The node `virtual_rig`: what its pictures show."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from microbot_ros.common.errors import InputError


def test_an_effect_of_rollers_is_refused_where_particles_swim(ros: Any, tmp_path: Path) -> None:
    with pytest.raises(InputError, match='set gains_um_s_hz'):
        ros({'virtual_rig': {
            'amplifier_log': str(tmp_path / 'amplifier.jsonl'), 'effect': 'drive_response',
            'effect_parameters': ['cut_in_hz=0.9']}}).add('virtual_rig')


def test_what_stretches_the_picture_is_in_the_picture_and_not_in_the_truth(
        ros: Any, tmp_path: Path, monkeypatch: Any) -> None:
    log = tmp_path / 'amplifier.jsonl'
    log.write_text('')
    node = ros({'virtual_rig': {
        'amplifier_log': str(log), 'effect': 'pixel_anisotropy',
        'effect_parameters': ['aspect=1.2']}}).add('virtual_rig')
    rendered = node._microscope.render
    shown: list[np.ndarray] = []

    def render(position: np.ndarray, *rest: Any) -> Any:
        shown.append(position)
        return rendered(position, *rest)
    monkeypatch.setattr(node._microscope, 'render', render)
    node._expose()
    np.testing.assert_allclose(shown[-1], node._world.position * [1.0, 1.2])
