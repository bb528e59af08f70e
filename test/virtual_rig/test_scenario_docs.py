"""The documentation of scenarios names every key and every effect that there is."""

from pathlib import Path

import pytest

from microbot_ros.virtual_rig import scenario
from microbot_ros.virtual_rig.injected_effects import INJECTABLE, UNLISTED

DOCS = (Path(__file__).parents[2] / 'docs/reference/simulation.md').read_text(encoding='utf-8')
SECTIONS = [
    scenario.Scenario, scenario.FluidSettings, scenario.CameraSettings, scenario.SwimmerSettings,
    scenario.CommandSettings, scenario.StepSettings, scenario.RotatingSettings,
    scenario.HerdingSettings, scenario.RowSettings, scenario.ControllerSettings]


@pytest.mark.parametrize('section', SECTIONS)
def test_every_key_is_documented(section):
    assert [key for key in section.names() if f'`{key}`' not in DOCS] == []


def test_every_effect_is_documented():
    assert [effect for effect in INJECTABLE if f'`{effect}`' not in DOCS] == []
    rows = {line.split('|')[1].strip(' `'): line for line in DOCS.splitlines() if '|' in line}
    for effect, parameters in UNLISTED.items():
        assert [name for name in parameters if f'`{name}`' not in rows[effect]] == []
