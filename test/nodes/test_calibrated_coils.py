"""From gaussmeter readings to a rig that is driven by them: calibrate, then run."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from geometry_msgs.msg import Vector3Stamped
from in_process import command
from rig_file import write_rig
from std_srvs.srv import SetBool

from microbot_ros.magnetics import CoilSettings
from microbot_ros.nodes.base import messages

magpylib = pytest.importorskip('magpylib')

GAIN = np.array([0.8, 1.15, -0.95, 1.05])
BACKGROUND_T = np.array([40e-6, -25e-6])
PLACES_MM = [(0, 0, 0), (3, 0, 0), (0, 3, 0), (-2, 2, 1)]


def _other_coils() -> dict[str, Any]:
    """Not the default's: smaller and nearer, and the y pair with fewer turns."""
    content = CoilSettings().content('not none')
    for winding in content['windings']:
        along_y = winding['name'].endswith('y')
        winding |= {'radius_mm': 12.0, 'turns': 150 if along_y else 220, 'position_mm': [
            22.0 * component for component in winding['axis']]}
    return content


def _field_per_ampere(content: dict[str, Any], place_mm: Any) -> np.ndarray:
    """Of each coil as it really is (4, 3) [T/A], by magpylib."""
    fields = []
    for gain, winding in zip(GAIN, content['windings'], strict=True):
        loop = magpylib.current.Circle(diameter=2e-3 * winding['radius_mm'],
                                       current=gain * winding['turns'])
        # Its axis is z; turned about z × axis by a right angle it points along `axis`.
        loop.rotate_from_angax(90, np.cross([0, 0, 1], winding['axis']))
        loop.position = 1e-3 * np.array(winding['position_mm'])
        fields.append(loop.getB(1e-3 * np.array(place_mm)))
    return np.array(fields)


def _measure(file: Path, content: dict[str, Any]) -> None:
    """Each coil by itself, both ways, with 2 µT of noise."""
    rng = np.random.default_rng(4)
    with file.open('w') as stream:
        rows = csv.writer(stream)
        rows.writerow([*(f'{winding["name"]}_A' for winding in content['windings']),
                       'x_mm', 'y_mm', 'z_mm', 'bx_mT', 'by_mT'])
        for place in PLACES_MM:
            for currents in np.vstack([np.eye(4), -np.eye(4)]):
                field = (currents @ _field_per_ampere(content, place))[:2] + BACKGROUND_T
                rows.writerow([*currents, *place, *1e3 * (field + rng.normal(0, 2e-6, 2))])


def _rig(folder: Path, emulator: Any, coils: Path | None) -> Path:
    """A rig's file, with nothing but the coil driver."""
    values = {'port': emulator.url, 'full_scale_A': 2.0}
    if coils:
        values['coils_file'] = str(coils)
    return write_rig(folder / 'rig.yaml', {'coil_driver': values})


@pytest.mark.parametrize('default', [True, False])
def test_a_rig_is_driven_by_what_was_calibrated(
        ros: Any, tmp_path: Path, emulator: Any, default: bool) -> None:
    content = (CoilSettings().content('not none') if default
               else _other_coils())
    readings, out, known = tmp_path / 'readings.csv', tmp_path / 'out', tmp_path / 'known.yaml'
    _measure(readings, content)
    known.write_text(yaml.safe_dump(content))
    start = [] if default else ['--config', _rig(tmp_path, emulator, known)]
    status, said, error = command('calibrate', 'coils', readings, '--out', out, *start)
    assert status == 0, error
    assert f'started from the coils of {"the default rig" if default else known}' in said
    config = _rig(tmp_path, emulator, out / 'coils.yaml')
    assert f'coil_driver; coils of {out / "coils.yaml"}' in command(
        'doctor', '--config', config)[1]
    graph = ros({'coil_driver': yaml.safe_load(config.read_text())['coil_driver'][
        'ros__parameters']})
    driver = graph.add('coil_driver')
    commands = graph.probe.create_publisher(Vector3Stamped, 'field/command', 10)
    graph.until(lambda: graph.call(
        SetBool, 'coil_driver/arm', SetBool.Request(data=True)).success)
    wanted = np.array([1.2e-3, -0.7e-3])

    def command_field(field: np.ndarray) -> None:
        commands.publish(messages.field_vector(field, messages.to_stamp(driver.seconds())))

    def made() -> bool:
        command_field(wanted)
        field = emulator.currents @ _field_per_ampere(content, (0, 0, 0))
        off = field[:2] + BACKGROUND_T - wanted
        return not emulator.zero and bool(np.hypot(*off) < 0.005 * np.hypot(*wanted))
    graph.until(lambda: command_field(np.zeros(2)) or not driver._driver.gate.holding)
    graph.until(made)
