"""Start, supervision and stop of a graph of nodes as processes, without launch."""

from __future__ import annotations

import math
import os
import selectors
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from microbot_ros.common.compiled import COMPILES
from microbot_ros.common.ending import PARENT
from microbot_ros.common.errors import InputError
from microbot_ros.nodes.base.transport import clear_shared_memory

WORD = 'microbot: '
"""Beginning of a line that a child prints itself, in contrast to its libraries."""
READY = f'{WORD}ready'
"""Line that a child prints on standard output when it works."""

_START_S = 600.0
"""Time [s] in which children must get ready. Choice: if all compile, two busy cores need
minutes."""
_END_S = 15.0
"""Time [s] in which children must end. Choice: a recorder on a slow disk has much to write."""
_REMARK_S = 1.0
"""Time [s] after which children that are still ending are reported. Choice: most end within it."""


@dataclass
class _Child:
    name: str
    is_node: bool
    process: subprocess.Popen[bytes]
    says_when_ready: str
    ready: bool = False
    unfinished: bytes = b''
    """Printed part of a line that has no end yet."""
    said: list[str] = field(default_factory=list)


class Graph:
    """Child processes of one rig, as a context: leaving it stops those that still run.

    Parameters
    ----------
    tell : callable
        Function that is called with the name of a child and each line that it prints.
    """

    def __init__(self, tell: Callable[[str, str], None]) -> None:
        self.killed: list[str] = []
        """Children that did not end when requested."""
        self._tell = tell
        self._environment = {**os.environ, PARENT: str(os.getpid())}
        self._children: dict[str, _Child] = {}
        self._selector = selectors.DefaultSelector()
        self._ending = self._compiling = False
        self._starting = threading.Lock()

    def __enter__(self) -> Graph:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop(list(self._children))
        self._selector.close()
        clear_shared_memory()

    @property
    def count(self) -> int:
        """Number of children that were started and not yet stopped."""
        return len(self._children)

    def start_node(self, name: str, parameters: Path, namespace: str = '/') -> None:
        """Start a process with a node.

        Parameters
        ----------
        name : str
            Name of the node.
        parameters : Path
            File of its parameters.
        namespace : str
            Namespace of the rig; '/' for the root.
        """
        self._start(name, [sys.executable, '-m', 'microbot_ros.nodes', name,
                           '--ros-args', '--params-file', str(parameters),
                           '-r', f'__ns:={namespace}'], READY, True)

    def start(self, name: str, command: Sequence[str], says_when_ready: str = READY) -> None:
        """Start a child that is no node, such as an emulated amplifier.

        It ends after the nodes.

        Parameters
        ----------
        name : str
            Name of the child.
        command : sequence of str
            Its command.
        says_when_ready : str
            Beginning of the line that it prints when it works.
        """
        self._start(name, command, says_when_ready, False)

    def _start(self, name: str, command: Sequence[str], says_when_ready: str,
               is_node: bool) -> None:
        with self._starting:
            # In its own session, so that Ctrl-C reaches only this process.
            process = subprocess.Popen(
                command, env=self._environment, bufsize=0, stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE, stderr=subprocess.STDOUT, start_new_session=True)
            child = self._children[name] = _Child(name, is_node, process, says_when_ready)
            if self._ending:
                _end([child])
        os.set_blocking(_output(child), False)
        self._selector.register(_output(child), selectors.EVENT_READ, child)

    def wait_ready(self, seconds: float = _START_S) -> None:
        """Return when every child works.

        Parameters
        ----------
        seconds : float
            Longest time to wait [s].

        Raises
        ------
        InputError
            If a child ends or takes too long.
        """
        deadline = time.monotonic() + seconds
        while waiting := [c for c in self._children.values() if not c.ready]:
            self.pump(0.1)
            for child in waiting:
                ended = child.process.poll() is not None
                if ended:
                    self._read(child)  # it may have printed lines before its end
                if ended and not child.ready:
                    raise _reason(child)
                if not child.ready and time.monotonic() > deadline:
                    raise InputError(child.name, f'did not get ready within {seconds:g} s')

    def pump(self, seconds: float) -> None:
        """Pass on the lines that children print, until one has printed.

        Parameters
        ----------
        seconds : float
            Longest time to wait [s].
        """
        for key, _ in self._selector.select(seconds):
            self._read(key.data)

    def _read(self, child: _Child) -> None:
        """Pass on every line that a child has printed, at its end also an unfinished one."""
        output = _output(child)
        while output in self._selector.get_map():
            try:
                data = os.read(output, 65536)
            except BlockingIOError:
                return
            if not data:
                self._selector.unregister(output)
            *lines, child.unfinished = (child.unfinished + data).split(b'\n')
            if not data and child.unfinished:
                lines.append(child.unfinished)
            for line in lines:
                self._heard(child, line.decode(errors='replace').rstrip())

    def _heard(self, child: _Child, line: str) -> None:
        if line.startswith(child.says_when_ready):
            child.ready = True
        else:
            child.said.append(line)
            del child.said[:-20]
            twice = line == COMPILES and self._compiling
            self._compiling |= line == COMPILES
            # Before it is ready, its own message is the reason of its end and reported as such.
            if not twice and (child.ready or not line.startswith(WORD)):
                self._tell(child.name, line)

    def ended(self) -> dict[str, int]:
        """Return the children that have ended by themselves.

        Returns
        -------
        dict of str to int
            Exit status by name.
        """
        return {
            name: child.process.returncode for name, child in self._children.items()
            if child.process.poll() is not None
        }

    def process_id(self, name: str) -> int:
        """Return the process id of a child.

        Parameters
        ----------
        name : str
            Name of the child.

        Returns
        -------
        int
            Process id.
        """
        return self._children[name].process.pid

    def tell_to_end(self) -> None:
        """Send SIGTERM to every node, the coil driver first, without waiting; from any thread.

        Children that are started later receive it at once.
        """
        with self._starting:
            self._ending = True
            _end([child for child in self._children.values() if child.is_node])

    def stop(self, names: Sequence[str], seconds: float = _END_S) -> None:
        """Send SIGTERM to children, the coil driver first, and wait for their end.

        Children that are no nodes, such as an emulated amplifier, receive it when the nodes have
        ended. Children that hang are killed.

        Parameters
        ----------
        names : sequence of str
            Names of the children.
        seconds : float
            Time [s] after which a child is killed.
        """
        children = [self._children[name] for name in names]
        for group in ([child for child in children if child.is_node],
                      [child for child in children if not child.is_node]):
            _end(group)
            self._see_end(group, seconds)
            for child in group:
                del self._children[child.name]

    def _see_end(self, children: list[_Child], seconds: float) -> None:
        for child in self._await_end(children, _REMARK_S):
            if child.ready:
                self._tell(child.name, f'still ending; it has {seconds:g} s')
        for child in self._await_end(children, seconds - _REMARK_S):
            self._tell(child.name, f'did not end within {seconds:g} s: killed')
            self.killed.append(child.name)
            child.process.kill()
        self._await_end(children, math.inf)
        for child in children:
            self._read(child)
            if _output(child) in self._selector.get_map():  # a process that it started has it open
                self._selector.unregister(_output(child))
            assert child.process.stdout is not None
            child.process.stdout.close()

    def _await_end(self, children: list[_Child], seconds: float) -> list[_Child]:
        """Return the children that have not ended within a time."""
        deadline = time.monotonic() + seconds
        while alive := [child for child in children if child.process.poll() is None]:
            self.pump(0.02)
            if time.monotonic() > deadline:
                break
        return alive


def _reason(child: _Child) -> InputError:
    """Return why a child ended before it was ready: its report on a node, or its last line."""
    said = [line.removeprefix(WORD) for line in child.said if line.startswith(WORD)]
    if not said:
        last = child.said[-1] if child.said else 'it printed nothing'
        return InputError(child.name, f'ended while starting: {last}')
    node, _, problem = said[-1].partition(': ')
    return InputError(node, problem) if node == child.name else InputError(child.name, said[-1])


def _output(child: _Child) -> int:
    assert child.process.stdout is not None
    return child.process.stdout.fileno()


def _end(children: Sequence[_Child]) -> None:
    """Send SIGTERM, to the coil driver before all others."""
    for child in sorted(children, key=lambda child: child.name != 'coil_driver'):
        child.process.send_signal(signal.SIGTERM)
