"""The cockpit's node beside nodes of a rig in this process: what a page is told and may ask."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip('uvicorn', reason='the extra `cockpit` is not installed')

from cockpit.conftest import Page, page_in_control
from geometry_msgs.msg import Vector3Stamped
from in_process import Ros

from bench._emulator import Served
from microbot_ros.nodes.client.graph_client import GraphClient
from microbot_ros.session.mcap.recording import Recording

# Nodes and pictures in one process: on an overloaded machine no picture comes within a minute.
pytestmark = pytest.mark.rig

NODES = ('tracker', 'model', 'controller', 'coil_driver', 'recorder', 'virtual_rig', 'cockpit')


class Rig:
    """Nodes in this process with an emulated amplifier and microscope, served by a thread."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.emulator = folder, Served(folder)
        self.graph = Ros(folder, {
            'virtual_rig': {'amplifier_log': str(self.emulator.log), 'frame_rate_hz': 10.0},
            'tracker': {'pixel_size_um': 0.45}, 'coil_driver': {'port': self.emulator.url},
            'recorder': {'recording': False, 'folder': str(folder / 'recording')},
            'cockpit': {'port': 0, 'token': False, 'discoveries': str(folder / 'discoveries')}})
        for name in NODES:
            assert self.graph.add(name).active, name

    @property
    def address(self) -> str:
        """Where the page is served."""
        address: str = self.graph.nodes['cockpit']._server.address
        return address

    def end(self) -> None:
        """Leave nothing running."""
        self.graph.end()
        self.emulator.end()


@pytest.fixture(scope='module')
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    """One rig for all tests here: each leaves it as it found it."""
    made = Rig(tmp_path_factory.mktemp('rig'))
    try:
        with made.graph.spinning():
            yield made
    finally:
        made.end()


@pytest.fixture
def page(rig: Rig) -> Iterator[Page]:
    """A page in control of a rig that ends disarmed and at rest."""
    with page_in_control(rig.address) as made:
        made.until(lambda message: message['kind'] == 'particles' and message['particles'], 60.0)
        yield made
        made.ask('switch_controller', name='hold')
        made.ask('stop')


def until(page: Page, true: Callable[[], Any]) -> None:
    """Read what the page is told until something is true; fail if it does not become so."""
    page.until(lambda _: true(), 60.0)


def steered(page: Page, rig: Rig, x: float, y: float) -> None:
    """Arm the rig and hold a stick until currents flow."""
    assert page.ask('switch_controller', name='teleop')['ok']

    def flows() -> bool:
        if not rig.graph.nodes['coil_driver']._driver.gate.armed:
            page.say('stick', x=0.0, y=0.0)
            page.ask('arm', attended=False)
        page.say('stick', x=x, y=y)
        return not rig.emulator.zero
    page.say('stick', x=0.0, y=0.0)
    until(page, flows)


def test_particles_lie_where_the_tracker_has_them(page: Page) -> None:
    camera = [one for one in page.told if one['kind'] == 'hello'][-1]['camera']
    assert camera == {'width_px': 640, 'height_px': 480, 'pixel_size_um': 0.45, 'to_um': [
        [0.45, 0.0, -143.775], [0.0, -0.45, 107.775]]}
    seen = page.until(lambda message: message['kind'] == 'particles' and message['particles'])
    assert int(seen['stamp']) in page.pictures
    for one in seen['particles']:
        # 640×480 px of 0.45 µm, the workspace's origin in the middle, y up.
        assert one['x_px'] == pytest.approx(319.5 + one['x_um'] / 0.45, abs=0.01)
        assert one['y_px'] == pytest.approx(239.5 - one['y_um'] / 0.45, abs=0.01)


def test_the_state_tells_how_the_rig_is(page: Page) -> None:
    names = {'tracker', 'model', 'controller', 'coil_driver', 'recorder', 'virtual_rig'}
    until(page, lambda: {one['name'] for one in page.known.get('health', ())} >= names)
    known = page.known
    assert known['rig'] == 'disarmed'
    assert 'zero' in known['sentence']
    assert known['picture_age_ms'] >= 0
    assert known['recording']['on'] is False
    assert {'waypoint', 'hold', 'teleop'} <= {
        one['name'] for one in known['controller']['available']}
    json.dumps(known, allow_nan=False)


def test_a_goal_is_shown_once_the_controller_has_it(page: Page) -> None:
    refused = page.ask('goal', x_um=12.5, y_um=-7.0)
    assert refused['ok'] is False
    assert refused['reason'].startswith('hold takes no goals; controllers that do: ')
    assert 'waypoint' in refused['reason']
    assert page.ask('switch_controller', name='waypoint')['ok']
    assert page.ask('goal', x_um=12.5, y_um=-7.0)['ok']
    told = page.until(lambda message: (message.get('controller') or {}).get('goals'))
    goal, = told['controller']['goals']
    assert (goal['x_um'], goal['y_um'], goal['id']) == (12.5, -7.0, None)
    for particle in (0, 1):
        assert page.ask('goal', x_um=3.0 * particle, y_um=1.0, particle=particle)['ok']
    told = page.until(lambda message: len((message.get('controller') or {}).get('goals', ())) == 2)
    assert [goal['id'] for goal in told['controller']['goals']] == [0, 1]
    assert page.ask('switch_controller', name='path_following')['ok']
    assert page.ask('path', points_um=[[0, 0], [10, 5], [20, 0]])['ok']
    told = page.until(lambda message: (message.get('controller') or {}).get('path'))
    assert told['controller']['path'] == [[0, 0], [10, 5], [20, 0]]
    assert page.ask('clear_goals')['ok']
    page.until(lambda message: (message.get('controller') or {}).get('goals') == []
               and message['controller']['path'] == [])


def test_a_refused_switch_leaves_the_old_one_and_says_why(page: Page) -> None:
    assert page.ask('switch_controller', name='waypoint')['ok']
    answer = page.ask('switch_controller', name='nonsense')
    assert not answer['ok']
    assert 'nonsense' in answer['reason']
    assert 'waypoint' in answer['reason']
    page.until(lambda message: (message.get('controller') or {}).get('name') == 'waypoint')


def test_parameters_are_set_as_their_descriptors_say(page: Page) -> None:
    assert page.ask('switch_controller', name='teleop')['ok']
    told = page.until(lambda message: any(
        one['name'] == 'teleop.field_mT'
        for one in (message.get('controller') or {}).get('parameters', ())))
    parameters = {one['name']: one for one in told['controller']['parameters']}
    field = parameters['teleop.field_mT']
    assert (field['type'], field['unit'], field['minimum'], field['maximum']) == (
        'number', 'mT', 0.01, 100.0)
    assert not any(name.startswith('waypoint.') for name in parameters)
    assert not {'controller', 'model_file', 'use_sim_time'} & set(parameters)
    before = field['value']
    assert page.ask('set', name='teleop.field_mT', value=3)['ok']
    page.until(lambda message: any(
        one['name'] == 'teleop.field_mT' and one['value'] == 3.0 and one['type'] == 'number'
        for one in (message.get('controller') or {}).get('parameters', ())))
    for name, value in (('teleop.field_mT', 1e6), ('teleop.field_mT', 'x'),
                        ('teleop.field_mT', True), ('teleop.field_mT', [1.0]),
                        ('max_field_mT', 1.0), ('model_file', '/etc/passwd'),
                        ('controller', 'hold'), ('nonsense', 1)):
        assert not page.ask('set', name=name, value=value)['ok'], (name, value)
    assert page.ask('set', name='teleop.field_mT', value=before)['ok']


def test_stop_ends_what_flows(page: Page, rig: Rig) -> None:
    steered(page, rig, 1.0, 0.0)
    assert page.ask('stop')['ok']
    assert rig.emulator.zero  # when it is answered, and not some time later
    until(page, lambda: page.known['rig'] == 'disarmed')


def test_a_viewer_may_stop(page: Page, rig: Rig) -> None:
    steered(page, rig, 1.0, 0.0)
    with page_in_control(rig.address) as viewer:
        page.ask('take_control')
        assert viewer.ask('stop')['ok']
        assert rig.emulator.zero


def test_a_stick_steers_and_letting_go_ends_it(page: Page, rig: Rig) -> None:
    angle = math.radians(30.0)

    def along() -> bool:
        page.say('stick', x=math.cos(angle), y=math.sin(angle))
        x, y = (page.known.get('field') or {}).get('applied_mT') or (0.0, 0.0)
        return math.hypot(x, y) > 1.0 and abs(
            math.remainder(math.atan2(y, x) - angle, math.tau)) < math.radians(5.0)
    steered(page, rig, math.cos(angle), math.sin(angle))
    until(page, along)
    page.say('stick', x=0.0, y=0.0)
    until(page, lambda: rig.emulator.zero)


def test_a_page_that_is_gone_steers_no_more(page: Page, rig: Rig) -> None:
    with page_in_control(rig.address) as other:
        steered(other, rig, 0.0, 1.0)
    until(page, lambda: rig.emulator.zero)
    page.ask('take_control')


def test_a_refusal_to_arm_comes_word_for_word(page: Page, rig: Rig) -> None:
    """A second one who commands, and the driver says so."""
    with GraphClient('intruder') as client:
        client.node.create_publisher(Vector3Stamped, 'field/command', 1)
        driver = rig.graph.nodes['coil_driver']
        until(page, lambda: '/intruder' in driver._commanders()[0])
        answer = page.ask('arm', attended=False)
        assert not answer['ok']
        assert '2 nodes publish commands, expected one' in answer['reason']
        assert 'intruder' in answer['reason']


def test_what_is_noted_is_in_the_recording(page: Page, rig: Rig) -> None:
    assert page.ask('note', text='too early')['ok'] is False
    assert page.ask('record', on=True, title='batch 7')['ok']
    told = page.until(lambda message: (message.get('recording') or {}).get('on'))
    assert told['recording']['title'] == 'batch 7'
    assert page.ask('record', on=True, title='another')['ok'] is False
    assert page.ask('note', text='5 % peroxide')['ok']
    assert page.ask('note', text='bubbles')['ok']
    with page_in_control(rig.address) as again:  # a reload
        told = again.until(lambda message: (message.get('recording') or {}).get('on'))
        assert told['recording']['title'] == 'batch 7'
        assert told['recording']['seconds'] > 0
        assert again.ask('record', on=False)['ok']
    with Recording(rig.folder / 'recording') as recording:
        kept = recording.metadata()['recording']
    assert kept['title'] == 'batch 7'
    assert [line.partition(' ')[2] for line in kept['notes'].splitlines()] == [
        '5 % peroxide', 'bubbles']
    page.ask('take_control')
