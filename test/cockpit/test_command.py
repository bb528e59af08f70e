"""`microbot cockpit` beside no rig at all, and `microbot run --cockpit`."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from cockpit.conftest import get, page_at

from microbot_ros.cockpit.address import WORDS

pytestmark = [pytest.mark.rig, pytest.mark.timeout(180)]


@pytest.fixture
def microbot(tmp_path: Path) -> Iterator[Callable[..., Any]]:
    """Starts commands that end with the test."""
    made: list[subprocess.Popen[str]] = []

    def start(*words: str) -> subprocess.Popen[str]:
        made.append(subprocess.Popen(
            [sys.executable, '-m', 'microbot_ros.cli', *words], cwd=tmp_path, text=True,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT))
        return made[-1]
    yield start
    for one in made:
        one.terminate()
        one.communicate(timeout=30)


def address_of(command: Any) -> str:
    """What is to be opened, from the file that it names; what it prints holds no token."""
    for line in command.stdout:
        assert 'token=' not in line
        if WORDS in line:
            return Path(line.partition(WORDS)[2].strip()).read_text().strip()
    raise AssertionError('it ended without an address')


def test_without_a_rig_the_page_says_so_and_the_command_ends_on_a_signal(microbot: Any) -> None:
    command = microbot('cockpit', '--port', '0', '--no-token', '--namespace', 'rig_2')
    with page_at(address_of(command)) as page:
        page.becomes('rig', 'unknown')
        assert page.known['controller'] is None
        assert page.known['recording'] is None
        begin = time.monotonic()
        answer = page.ask('arm', attended=False)
        assert not answer['ok']
        assert answer['reason'] == (
            'coil_driver was not found in the namespace /rig_2: is it running?')
        assert not page.ask('goal', x_um=0, y_um=0)['ok']
        answer = page.ask('stop')
        assert not answer['ok']
        assert answer['reason'].startswith('not reachable')
        assert answer['zero'] == 'unreachable'
        assert time.monotonic() - begin < 9.0
        begin = time.monotonic()
        command.send_signal(signal.SIGTERM)
        assert command.wait(15.0) == 0
        assert time.monotonic() - begin < 8.0


def test_the_address_holds_a_token(microbot: Any) -> None:
    address = address_of(microbot('cockpit', '--port', '0', '--host', '0.0.0.0'))
    place, _, token = address.removeprefix('http://').partition('/?token=')
    port = int(place.rpartition(':')[2])
    for path, status in (('/', 403), (f'/?token={token}', 303)):
        assert get(port, path).status == status


def test_run_has_it_beside_its_nodes(microbot: Any, tmp_path: Path) -> None:
    (tmp_path / 'rig.yaml').write_text(
        '/**/recorder:\n  ros__parameters: {recording: false}\n'
        '/**/cockpit:\n  ros__parameters: {port: 0, token: false}\n')
    command = microbot('run', '--config', 'rig.yaml', '--cockpit')
    with page_at(address_of(command)) as page:
        page.becomes('recording', {'on': False, 'seconds': 0.0, 'lost': 0, 'title': ''})
        assert page.ask('record', on=True, title='x')['ok']
        assert page.ask('note', text='y')['ok']
        assert page.ask('record', on=False)['ok']
    assert len(list(tmp_path.glob('recordings/*/*.mcap'))) == 1
