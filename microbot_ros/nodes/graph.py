"""Starts a graph of nodes as processes, watches them, stops them in order. Needs no launch."""

from __future__ import annotations

import os
import selectors
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from microbot_ros.errors import InputError

READY = 'microbot: ready'
"""What a child prints on standard output when it does its work."""

PARENT = 'MICROBOT_PARENT'
"""Environment variable with the process id that a node must not outlive."""


@dataclass
class _Child:
    name: str
    process: subprocess.Popen[str]
    says_when_ready: str
    ready: bool = False
    said: list[str] = field(default_factory=list)


class Graph:
    """Child processes of one rig. Use as a context: leaving it stops what still runs.

    `tell` is called with each line that a child prints.
    """

    def __init__(self, tell: Callable[[str, str], None]) -> None:
        self._tell = tell
        self._environment = {**os.environ, PARENT: str(os.getpid())}
        self._children: dict[str, _Child] = {}
        self._selector = selectors.DefaultSelector()

    def __enter__(self) -> Graph:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop(list(reversed(self._children)))
        self._selector.close()

    @property
    def count(self) -> int:
        """How many children were started and not yet stopped."""
        return len(self._children)

    def start_nodes(self, names: Sequence[str], parameters: Path) -> None:
        """Start one process with these nodes and a ROS parameter file."""
        self.start('+'.join(names), [sys.executable, '-m', 'microbot_ros.nodes', *names,
                                     '--ros-args', '--params-file', str(parameters)])

    def start(self, name: str, command: Sequence[str], says_when_ready: str = READY) -> None:
        """Start any child; it is in a session of its own, so that Ctrl-C reaches only us."""
        process = subprocess.Popen(
            command, env=self._environment, text=True, bufsize=1, stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, start_new_session=True)
        child = _Child(name, process, says_when_ready)
        self._children[name] = child
        self._selector.register(process.stdout, selectors.EVENT_READ, child)  # type: ignore[arg-type]

    def wait_ready(self, seconds: float) -> None:
        """Return when every child does its work. InputError when one ends or is late."""
        deadline = time.monotonic() + seconds
        while waiting := [c for c in self._children.values() if not c.ready]:
            self.pump(0.1)
            for child in waiting:
                if not child.ready and child.process.poll() is not None:
                    self.pump(0.1)
                    last = child.said[-1] if child.said else 'it said nothing'
                    raise InputError(child.name, f'ended while starting: {last}')
                if time.monotonic() > deadline:
                    raise InputError(child.name, f'did not get ready within {seconds:g} s')

    def pump(self, seconds: float) -> None:
        """Pass on what children print, for at most that long or until one has printed."""
        for key, _ in self._selector.select(seconds):
            child: _Child = key.data
            line = key.fileobj.readline()  # type: ignore[union-attr]
            if not line:
                self._selector.unregister(key.fileobj)
            elif line.startswith(child.says_when_ready):
                child.ready = True
            else:
                child.said.append(line.rstrip())
                del child.said[:-20]
                self._tell(child.name, line.rstrip())

    def ended(self) -> dict[str, int]:
        """Children that have ended by themselves, with their exit status."""
        return {
            name: child.process.returncode for name, child in self._children.items()
            if child.process.poll() is not None
        }

    def process_id(self, name: str) -> int:
        """The process id of a child."""
        return self._children[name].process.pid

    def stop(self, names: Sequence[str], seconds: float = 5.0) -> None:
        """SIGTERM the named children, one after the other, and see each end; kill what hangs."""
        for name in names:
            child = self._children.pop(name)
            if child.process.poll() is None:
                child.process.send_signal(signal.SIGTERM)
            deadline = time.monotonic() + seconds
            while child.process.poll() is None:
                self.pump(0.02)
                if time.monotonic() > deadline:
                    self._tell(name, f'did not end within {seconds:g} s: killed')
                    child.process.kill()
                    child.process.wait()
            assert child.process.stdout is not None
            while child.process.stdout in self._selector.get_map():
                self.pump(0.1)
            child.process.stdout.close()
