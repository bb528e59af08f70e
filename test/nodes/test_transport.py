"""The middleware of a node: what it lets in, what it remembers and leaves of who was killed."""

from __future__ import annotations

import os
import re
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

from microbot_ros.nodes.graph_client import GraphClient
from microbot_ros.nodes.transport import clear_shared_memory

pytestmark = [pytest.mark.graph, pytest.mark.timeout(120)]

FORGOTTEN_S = 4.0
"""A lease of 3 s, and a look around each second."""


@pytest.fixture
def node() -> Iterator[subprocess.Popen[str]]:
    """A process that publishes on the topic `chat`."""
    program = ('from microbot_ros.nodes.graph_client import GraphClient\n'
               'from std_msgs.msg import String\n'
               'with GraphClient("talker") as client:\n'
               '    client.node.create_publisher(String, "chat", 1)\n'
               '    print("up", flush=True)\n'
               '    client.spin(3600)\n')
    with subprocess.Popen([sys.executable, '-c', program], stdout=subprocess.PIPE,
                          text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == 'up\n'
        yield process
        process.kill()


def _publishers(client: GraphClient) -> int:
    client.spin(0.02)
    return len(client.node.get_publishers_info_by_topic('chat'))


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


def test_nothing_that_comes_from_beyond_loopback_is_ever_read(
        node: subprocess.Popen[str]) -> None:
    """The middleware sends from sockets that are open to all, and never reads from them."""
    bound = {one.laddr for one in psutil.Process(node.pid).net_connections('inet')}
    assert not psutil.Process(node.pid).net_connections('tcp')
    local = [port for host, port in bound if host == '127.0.0.1']
    others = [(host, port) for host, port in bound if host != '127.0.0.1']
    own = next((address.address for addresses in psutil.net_if_addrs().values()
                for address in addresses if address.family == socket.AF_INET
                and not address.address.startswith('127.')), '127.0.0.1')
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.bind((own, 0))
        for host, port in others:
            sender.sendto(b'RTPS' + bytes(60), (own if host == '0.0.0.0' else host, port))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for port in local:
            sender.sendto(b'RTPS' + bytes(60), ('127.0.0.1', port))
    deadline = time.monotonic() + 10
    while all(_waiting(port) for port in local):  # those that are read, are read by now
        assert time.monotonic() < deadline
    with GraphClient('asker') as client:  # and the process has talked to another meanwhile
        while not _publishers(client):
            assert time.monotonic() < deadline
    assert all(_waiting(port) for _, port in others)


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


@pytest.mark.parametrize('status', [0, 3])
def test_who_leaves_says_its_last_words_and_leaves_no_memory(status: int) -> None:
    program = ('import atexit, os, sys\n'
               'from pathlib import Path\n'
               'from microbot_ros.nodes.graph_client import GraphClient\n'
               'from microbot_ros.nodes.participant import leave\n'
               'atexit.register(print, "closed")\n'
               'with GraphClient("guest") as client:\n'
               '    client.spin(0.05)\n'
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
