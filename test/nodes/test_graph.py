"""A graph of processes: what its children say is heard, and all of them are seen to end."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

import psutil
import pytest

from microbot_ros.common.compiled import COMPILES
from microbot_ros.common.errors import InputError
from microbot_ros.nodes.client.graph import Graph

pytestmark = pytest.mark.rig

Said = list[tuple[str, str]]
_TOLD = """
import signal, sys, time
def told(*_):
    print("told", time.monotonic(), flush=True)
    time.sleep(float(sys.argv[1]))
    print("ended", time.monotonic(), flush=True)
    sys.exit()
signal.signal(signal.SIGTERM, told)
print("ready", flush=True)
while True:
    time.sleep(1)
"""


@pytest.fixture
def said() -> Said:
    """What children said."""
    return []


def _start(graph: Graph, name: str, program: str, *arguments: str) -> None:
    graph.start(name, [sys.executable, '-c', program, *arguments], 'ready')


def test_a_line_and_the_ready_line_that_come_together_are_both_heard(said: Said) -> None:
    with Graph(lambda *line: said.append(line)) as graph:
        _start(graph, 'child', 'import os, time; '
               'os.write(1, b"first\\nready\\nlast\\nhalf"); time.sleep(60)')
        graph.wait_ready(20.0)
        assert said == [('child', 'first'), ('child', 'last')]


def test_a_ready_line_in_two_pieces_is_one(said: Said) -> None:
    with Graph(lambda *line: said.append(line)) as graph:
        reader, writer = os.pipe()
        _start(graph, 'child', f'import os; os.write(1, b"rea"); '
               f'open("/proc/{os.getpid()}/fd/{reader}", "rb").read(1); os.write(1, b"dy\\n")')
        graph.pump(20.0)
        os.write(writer, b'x')
        graph.wait_ready(20.0)
        assert not said


def test_last_words_are_heard_and_are_the_reason(said: Said) -> None:
    with Graph(lambda *line: said.append(line)) as graph:
        _start(graph, 'child', 'import os; os.write(1, b"one\\nport is gone"); os._exit(2)')
        with pytest.raises(InputError, match='child: ended while starting: port is gone'):
            graph.wait_ready(20.0)
    assert said == [('child', 'one'), ('child', 'port is gone')]


def test_what_all_say_while_they_compile_is_told_once(said: Said) -> None:
    program = f'print({COMPILES!r}); print("ready", flush=True); import time; time.sleep(60)'
    with Graph(lambda *line: said.append(line)) as graph:
        for number in range(3):
            _start(graph, f'child {number}', program)
        graph.wait_ready(20.0)
    assert [line for _, line in said] == [COMPILES]


def test_the_reason_is_what_a_child_says_of_itself_and_not_of_its_end(said: Said) -> None:
    with Graph(lambda *line: said.append(line)) as graph:
        _start(graph, 'child', 'print("microbot: no port"); print("a warning at the end")')
        with pytest.raises(InputError, match=r'^child: no port$'):
            graph.wait_ready(20.0)
    assert said == [('child', 'a warning at the end')]


def test_all_end_side_by_side(said: Said) -> None:
    with Graph(lambda *line: said.append(line)) as graph:
        for number in range(3):
            _start(graph, f'child {number}', _TOLD, '1.5')
        graph.wait_ready(20.0)
    told = [float(line.split()[1]) for _, line in said if line.startswith('told')]
    ended = [float(line.split()[1]) for _, line in said if line.startswith('ended')]
    assert len(told) == len(ended) == 3
    assert max(told) < min(ended)
    assert {name for name, line in said if 'still ending' in line} == {
        'child 0', 'child 1', 'child 2'}
    assert not graph.killed


def test_what_hangs_is_killed_and_named(said: Said) -> None:
    with Graph(lambda *line: said.append(line)) as graph:
        _start(graph, 'child', _TOLD, '3600')
        graph.wait_ready(20.0)
        process = psutil.Process(graph.process_id('child'))
        graph.stop(['child'], seconds=1.2)
        assert not process.is_running()
        assert graph.killed == ['child']


def test_what_is_started_once_all_are_to_end_is_told_too(tmp_path: Path) -> None:
    with Graph(lambda *_: None) as graph:
        graph.tell_to_end()
        graph.start_node('coil_driver', tmp_path / 'none.yaml')
        process = psutil.Process(graph.process_id('coil_driver'))
        process.wait(5)  # not yet listening to signals, it ends of the first


def test_a_grandchild_that_keeps_the_pipe_holds_nothing_up(said: Said) -> None:
    began = time.monotonic()
    with Graph(lambda *line: said.append(line)) as graph:
        _start(graph, 'child', 'import subprocess, sys; p = subprocess.Popen(["sleep", "60"]); '
               'print(p.pid, flush=True); print("ready", flush=True); import time; time.sleep(60)')
        graph.wait_ready(20.0)
    grandchild = psutil.Process(int(said[0][1]))
    grandchild.kill()
    assert time.monotonic() - began < 30
