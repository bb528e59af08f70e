"""A virtual rig of real processes with a cockpit, for the tests of its pages and for looking."""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

# Also as a program of its own, for looking.
sys.path.insert(0, str(Path(__file__).parents[1] / 'harness'))

from rig_file import write_rig

from microbot_ros.cockpit.address import WORDS
from microbot_ros.nodes.client.graph import Graph

NODES = ('tracker', 'model', 'controller', 'coil_driver', 'recorder', 'virtual_rig', 'cockpit')


class VirtualRig:
    """The nodes of a rig in a process each, whose amplifier and microscope are emulated.

    Use as a context. `folder` takes all that it writes; `more` are parameters by node.
    """

    def __init__(self, folder: Path, **more: dict[str, Any]) -> None:
        self.folder = folder
        self.log = folder / 'amplifier.jsonl'
        self._parameters = folder / 'rig.yaml'
        self.address = ''
        self.graph = Graph(self._said)
        self._more = more

    def __enter__(self) -> VirtualRig:
        try:
            self._start()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.graph.__exit__()

    def _said(self, who: str, line: str) -> None:
        if WORDS in line:
            self.address = Path(line.partition(WORDS)[2]).read_text().strip()
        print(f'{who}: {line}', file=sys.stderr, flush=True)

    def _start(self) -> None:
        port, parameters = self.folder / 'amplifier', self._parameters
        nodes: dict[str, dict[str, Any]] = {
            'virtual_rig': {'amplifier_log': str(self.log), 'frame_rate_hz': 30.0},
            'tracker': {'pixel_size_um': 0.45},
            'model': {}, 'controller': {'controller': 'hold'},
            'coil_driver': {'port': str(port), 'full_scale_A': 2.0},
            'recorder': {'recording': False, 'folder': str(self.folder / 'recording'),
                         'frame_every': 0},
            'cockpit': {'port': 0, 'token': False,
                        'discoveries': str(self.folder / 'discoveries'),
                        'recordings': str(self.folder)}}
        write_rig(parameters, {
            name: values | self._more.get(name, {}) for name, values in nodes.items()})
        self.graph.start('amplifier', [
            sys.executable, '-m', 'microbot_ros.cli', 'emulate', 'serial_transfer', '--link',
            str(port), '--log', str(self.log), '--full-scale-A', '2'],
            says_when_ready='serving')
        self.graph.wait_ready(60.0)
        for name in NODES:
            self.graph.start_node(name, parameters)
        self.graph.wait_ready(300.0)  # where nothing is compiled yet
        self.until(lambda: self.address)

    def restart_cockpit(self) -> None:
        """Start a cockpit in place of one that has ended, at another address."""
        self.graph.stop(['cockpit'])
        self.address = ''
        self.graph.start_node('cockpit', self._parameters)
        self.graph.wait_ready(60.0)
        self.until(lambda: self.address)

    def until(self, true: Callable[[], Any], seconds: float = 20.0) -> None:
        """Wait until something is true; fail if it does not become so."""
        deadline = time.monotonic() + seconds
        while not true():
            assert time.monotonic() < deadline, 'did not happen in time'
            self.graph.pump(0.01)

    def entries(self) -> list[dict[str, Any]]:
        """What the amplifier's log holds so far: changes of its currents."""
        return [json.loads(line) for line in self.log.read_text().splitlines()]

    @property
    def zero(self) -> bool:
        """Whether nothing flows now."""
        return not any(self.entries()[-1]['currents_A'])

    def zero_since(self, moment_s: float) -> float:
        """How long after a `moment_s` [s, monotonic] nothing flowed any more, for good."""
        entries = self.entries()
        assert not any(entries[-1]['currents_A']), 'something flows'
        last = max((k for k, one in enumerate(entries) if any(one['currents_A'])), default=-1)
        return max(float(entries[last + 1]['t_monotonic_s']) - moment_s, 0.0)

    def signal(self, node: str, number: int) -> None:
        """Send the process of a `node` a signal."""
        os.kill(self.graph.process_id(node), number)


def main(arguments: Sequence[str]) -> None:
    """Run one in a folder until Ctrl-C, on a ROS domain of its own: `python virtual.py FOLDER`."""
    os.environ.setdefault('ROS_DOMAIN_ID', '97')
    folder = Path(arguments[0])
    folder.mkdir(parents=True, exist_ok=True)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with VirtualRig(  # also on a busy machine
            folder, cockpit={'port': int(arguments[1]) if arguments[1:] else 8642},
            coil_driver={'command_timeout_ms': 500.0, 'max_command_age_ms': 500.0},
            controller={'controller': 'hold', 'deadline_ms': 100.0}) as rig:
        while True:
            rig.graph.pump(1.0)


if __name__ == '__main__':
    with suppress(KeyboardInterrupt):
        main(sys.argv[1:])
