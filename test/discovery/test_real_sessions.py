"""Verdicts on recordings of another laboratory hold: docs/explanation/real_sessions.md."""

from pathlib import Path

import pytest

from microbot_ros.common.errors import InputError
from microbot_ros.discovery.discover import discover
from microbot_ros.session.spreadsheets.assemble import import_session
from microbot_ros.session.spreadsheets.sheets import Answers

SHARED = Path(__file__).parents[2].parent / 'shared' / 'data' / 'speed_vs_frequency'
pytestmark = [pytest.mark.timeout(900), pytest.mark.skipif(
    not SHARED.is_dir(), reason='needs shared/data')]

ROLLERS = {
    'command_delay': ('delay_s', 0.09, 0.15),
    'coil_gain_mismatch': ('gain_ratio', 1.3, 2.1),
    'amplifier_deadband': ('deadband_mT', 0.1e-3, 0.2e-3),
    'drive_response': ('slip', 0.0, 1.0),
}
"""Effects that a physicist expects of rollers on this rig, with a parameter and its range, SI."""


@pytest.mark.parametrize(('table', 'names'), [
    # 20 s of one processor, too long for the suite that a newcomer runs.
    pytest.param('spheres_20um/2024.03.01-15.17.12',
                 {'command_delay', 'coil_gain_mismatch', 'amplifier_deadband'},
                 marks=pytest.mark.rig),
    *(pytest.param(table, {'command_delay', 'drive_response'}, marks=pytest.mark.soak)
      for table in ('dimers_20um/20umDimer6', 'cellbots/1botcellbot', 'cellbots/1botcellbot3'))])
def test_rollers_have_what_rollers_have(table, names):
    session, _ = import_session(SHARED / f'{table}.xlsx', Answers())
    found = discover([session])
    assert found.verdict == 'named'
    established = {e.id: e.parameters for e in found.effects if e.status == 'established'}
    assert names <= established.keys() <= ROLLERS.keys()
    for name, parameters in established.items():
        of, low, high = ROLLERS[name]
        assert low <= parameters[of].value <= high
    assert found.gap.before > 0.5 * found.gap.floor
    assert found.gap.after < 0.25 * found.gap.before


def test_a_robot_without_a_rotating_field_is_refused():
    session, _ = import_session(SHARED / 'dimers_20um' / '2024.03.21-12.41.51.xlsx', Answers())
    with pytest.raises(InputError, match='expected commands with a rotating field'):
        discover([session])
