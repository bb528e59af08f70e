"""The middleware of a node: what it lets in, what it remembers and leaves of who was killed."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

from microbot_ros.nodes.base.transport import asked_reach, clear_shared_memory
from microbot_ros.nodes.client.graph_client import GraphClient

FORGOTTEN_S = 4.0
"""A lease of 3 s, and a look around each second."""


TALKER = """
import rclpy
from microbot_ros.nodes.base.participant import join
from std_msgs.msg import String
join([])
node = rclpy.create_node("talker")
publisher = node.create_publisher(String, "chat", 1)
print("up", flush=True)
while True:
    rclpy.spin_once(node)
"""

@pytest.fixture
def node() -> Iterator[subprocess.Popen[str]]:
    """A process that publishes on the topic `chat`."""
    with subprocess.Popen([sys.executable, '-c', TALKER], stdout=subprocess.PIPE,
                          text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == 'up\n'
        yield process
        process.kill()


def _publishers(client: GraphClient) -> int:
    client.spin(0.02)
    return len(client.node.get_publishers_info_by_topic('chat'))


@pytest.mark.rig
def test_a_killed_publisher_is_soon_forgotten(node: subprocess.Popen[str]) -> None:
    with GraphClient('listener') as client:
        deadline = time.monotonic() + 20
        while not _publishers(client):
            assert time.monotonic() < deadline
        node.kill()
        killed = time.monotonic()
        while _publishers(client):
            assert time.monotonic() < killed + FORGOTTEN_S


def _waiting(socket_port: int) -> int:
    """Bytes that wait in the kernel for whoever has a UDP port open to read them."""
    rows = [row.split() for row in Path('/proc/net/udp').read_text().splitlines()[1:]]
    return next(int(row[4].split(':')[1], 16) for row in rows
                if int(row[1].split(':')[1], 16) == socket_port)


@pytest.mark.rig
def test_no_socket_is_open_to_others(node: subprocess.Popen[str]) -> None:
    open_to = psutil.Process(node.pid).net_connections('inet')
    assert open_to
    assert {one.laddr.ip for one in open_to} == {'127.0.0.1'}


@pytest.mark.rig
@pytest.mark.parametrize('asks', ['LOCALHOST', 'SUBNET'])
def test_who_would_be_open_to_others_is_refused_unless_that_is_asked_for(asks: str) -> None:
    """As with a middleware that reads no profile: it looked for one before it was there."""
    program = ('import os, rclpy\n'
               'os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "OFF"\n'
               'rclpy.init()\n'
               'first = rclpy.create_node("first")\n'
               f'os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "{asks}"\n'
               'from microbot_ros.common.errors import InputError\n'
               'from microbot_ros.nodes.client.graph_client import GraphClient\n'
               'from microbot_ros.nodes.base.participant import leave\n'
               'try:\n'
               '    GraphClient("guest").echo()\n'
               'except InputError as error:\n'
               '    print(error)\n'
               'leave(0)\n')
    done = subprocess.run([sys.executable, '-c', program], capture_output=True, text=True,
                          timeout=60)
    assert (done.returncode, done.stderr) == (0, '')
    assert done.stdout == ('' if asks == 'SUBNET' else
        'ROS_AUTOMATIC_DISCOVERY_RANGE: other computers could reach this process: the middleware '
        'did not read client_transport.xml; set ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET to allow '
        'that\n')


@pytest.mark.parametrize(('name', 'value', 'reach'), [
    ('ROS_DOMAIN_ID', '7', None),
    ('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST', None),
    ('ROS_AUTOMATIC_DISCOVERY_RANGE', 'SUBNET', 'SUBNET'),
    ('FASTRTPS_DEFAULT_PROFILES_FILE', '/mine.xml', 'LOCALHOST'),
    ('ROS_STATIC_PEERS', '192.168.1.20', 'LOCALHOST')])
def test_what_the_environment_asks_for_comes_first(
        monkeypatch: pytest.MonkeyPatch, name: str, value: str, reach: str | None) -> None:
    monkeypatch.delenv('ROS_AUTOMATIC_DISCOVERY_RANGE', raising=False)
    monkeypatch.setenv(name, value)
    assert asked_reach('rmw_fastrtps_cpp') == reach
    assert asked_reach('rmw_cyclonedds_cpp') == (reach or 'LOCALHOST')


@pytest.mark.rig
def test_the_shared_memory_of_the_killed_goes_and_that_of_the_living_stays(
        node: subprocess.Popen[str]) -> None:
    # Its own alone: it maps those of whoever it has found as well.
    locks = {Path(file.path) for file in psutil.Process(node.pid).open_files()
             if re.fullmatch('fastrtps_[0-9a-f]{16}_el', Path(file.path).name)}
    own = {path.with_name(path.name.removesuffix('_el')) for path in locks}
    assert own
    for lock in locks:  # as if they had been there for a while
        os.utime(lock, (0, 0))
    clear_shared_memory()
    assert all(path.exists() for path in own | locks)
    node.kill()
    node.wait()
    clear_shared_memory()
    assert not any(path.exists() for path in own | locks)


@pytest.mark.rig
def test_clients_that_come_and_go_are_one_participant() -> None:
    """To delete one can hang for ever, in Fast DDS 2.14."""
    def threads() -> int:
        return sum(task.read_text().startswith('dds') for task in Path(
            '/proc/self/task').glob('*/comm'))
    with GraphClient('first') as client:
        client.spin(0.05)
        alive = threads()
    assert alive
    assert threads() == alive
    with GraphClient('second') as client:
        client.spin(0.05)
        assert 'first' not in client.node.get_node_names()
        assert threads() == alive


@pytest.mark.rig
@pytest.mark.parametrize('status', [0, 3])
def test_who_leaves_says_its_last_words_and_leaves_no_memory(status: int) -> None:
    program = ('import atexit, os, sys\n'
               'from pathlib import Path\n'
               'from microbot_ros.nodes.base.participant import join, leave\n'
               'atexit.register(print, "closed")\n'
               'import rclpy\n'
               'join([])\n'
               'guest = rclpy.create_node("guest")\n'
               'for one in Path("/proc/self/fd").iterdir():\n'
               '    if "fastrtps" in os.readlink(one):\n'
               '        print(os.readlink(one))\n'
               '        break\n'
               f'leave({status})\n')
    done = subprocess.run([sys.executable, '-c', program], capture_output=True, text=True,
                          timeout=60)
    lock, closed = done.stdout.split()
    assert done.returncode == status
    assert closed == 'closed'
    assert not Path(lock).exists()
    assert not Path(lock.removesuffix('_el')).exists()


@pytest.mark.rig
@pytest.mark.usefixtures('node')
def test_a_client_takes_no_shared_memory() -> None:
    """For seconds after a process has gone, what is sent to its port in there reaches nobody, and
    not who has the port next: the next client."""
    program = ('import psutil\n'
               'from microbot_ros.nodes.client.graph_client import GraphClient\n'
               'from microbot_ros.nodes.base.participant import leave\n'
               'with GraphClient("guest") as client:\n'
               '    assert client.until(lambda: client.runs("talker"), 30)\n'
               '    print(*(one.path for one in psutil.Process().open_files()\n'
               '            if "fastrtps" in one.path), end="")\n'
               'leave(0)\n')
    for _ in range(3):
        done = subprocess.run([sys.executable, '-c', program], capture_output=True, text=True,
                              timeout=60)
        assert (done.returncode, done.stdout, done.stderr) == (0, '', '')
