"""What a cockpit does to a rig of real processes beside what stories/test_on_the_rig.py tells."""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest
from cockpit.conftest import page_in_control
from cockpit.virtual import VirtualRig

pytestmark = [pytest.mark.rig, pytest.mark.timeout(240)]


@pytest.fixture(scope='module')
def virtual(tmp_path_factory: pytest.TempPathFactory) -> Iterator[VirtualRig]:
    """One rig for all tests here: each leaves it as it found it."""
    with VirtualRig(tmp_path_factory.mktemp('rig'), coil_driver={
            'command_timeout_ms': 250.0, 'max_command_age_ms': 250.0}) as made:
        yield made


@pytest.fixture
def page(virtual: VirtualRig) -> Iterator[Any]:
    """A page in control of a rig that ends disarmed and at rest."""
    with page_in_control(virtual.address) as made:
        made.until(lambda message: message['kind'] == 'particles' and message['particles'], 60.0)
        yield made


def armed(page: Any, controller: str) -> None:
    """The rig is armed, and a `controller` drives it; a cockpit may not have found the driver yet,
    which it does not arm later than it was told to."""
    switched = page.ask('switch_controller', name=controller)
    assert switched['ok'], switched
    deadline = time.monotonic() + 10
    while not (told := page.ask('arm', attended=False))['ok']:
        assert time.monotonic() < deadline, told
        page.drain(0.1)


def test_the_cockpit_leaves_the_processors_to_the_loop(virtual: VirtualRig) -> None:
    """All threads are of ordinary priority, but the one that does nothing but wait for the end."""
    tasks = Path(f'/proc/{virtual.graph.process_id("cockpit")}/task').iterdir()
    prior = [task for task in tasks if os.sched_getscheduler(int(task.name)) != os.SCHED_OTHER]
    assert len(prior) <= 1


def test_the_death_of_the_cockpit_harms_nothing(page: Any, virtual: VirtualRig) -> None:
    """What drives by itself drives on."""
    assert page.ask('switch_controller', name='waypoint')['ok']
    assert page.ask('goal', x_um=100.0, y_um=80.0)['ok']
    armed(page, 'waypoint')
    virtual.until(lambda: not virtual.zero)
    virtual.signal('cockpit', signal.SIGKILL)
    begin = time.monotonic()
    time.sleep(1.5)
    # Commands that stopped would be zeroed by the gate within 0.1 s, and by the board's watchdog.
    assert not virtual.zero
    assert all(any(one['currents_A']) for one in virtual.entries() if one['t_monotonic_s'] > begin)
    assert set(virtual.graph.ended()) == {'cockpit'}
    virtual.restart_cockpit()


def test_a_cockpit_that_has_just_started_finds_whom_it_asks(virtual: VirtualRig) -> None:
    virtual.signal('cockpit', signal.SIGKILL)
    virtual.restart_cockpit()
    with page_in_control(virtual.address) as page:
        answer = page.ask('switch_controller', name='hold')
    assert answer['ok'], answer


def test_discovery_ends_with_the_cockpit(page: Any, virtual: VirtualRig) -> None:
    """However that ends; and with it what it had drive."""
    armed(page, 'hold')
    assert page.ask('discover', on=True, minutes=5)['ok']
    assert page.ask('discover', on=True, minutes=5)['ok'] is False
    page.until(lambda message: (message.get('controller') or {}).get('name') == 'experiment', 90.0)
    child, = psutil.Process(virtual.graph.process_id('cockpit')).children()
    assert page.known['discovery']['running']
    virtual.until(lambda: not virtual.zero)
    virtual.signal('cockpit', signal.SIGKILL)
    child.wait(30.0)
    virtual.until(lambda: virtual.zero, 5.0)
    virtual.restart_cockpit()
    with page_in_control(virtual.address) as again:
        again.until(lambda message: (message.get('controller') or {}).get('name') == 'hold')


def test_discovery_that_is_told_to_end_says_so(page: Any, virtual: VirtualRig) -> None:
    armed(page, 'hold')
    assert page.ask('discover', on=True, minutes=5)['ok']
    page.until(lambda message: (message.get('controller') or {}).get('name') == 'experiment', 90.0)
    assert page.ask('stop')['ok']
    told = page.until(lambda message: (message.get('discovery') or {}).get('running') is False,
                      60.0)['discovery']
    assert told['sentence']
    newest = max((virtual.folder / 'discoveries').glob('*/result.json'))
    found = json.loads(newest.read_text())
    assert told['decided'] == found['decided'] == 'stopped'
    assert told['verdict'] == found.get('verdict')


@pytest.fixture(autouse=True)
def _at_rest() -> Iterator[None]:
    """Nothing flows after a test, whatever became of its page."""
    yield
    from microbot_ros.nodes.client.graph_client import GraphClient

    with GraphClient() as client:
        client.set('controller', controller='hold')
        client.stop()
