"""How one node ends that `ros2 run`, a launcher or a person started: at zero, and with whom."""

from __future__ import annotations

import os
import pty
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
from geometry_msgs.msg import Vector3Stamped
from rig_file import write_rig

from microbot_ros.common.ending import PARENT
from microbot_ros.common.errors import InputError, RigError
from microbot_ros.nodes.base import messages
from microbot_ros.nodes.client.graph_client import GraphClient

pytestmark = [pytest.mark.rig, pytest.mark.timeout(120)]

ZERO_S = 0.1
_LAUNCHER = """
import os, subprocess, sys, time
if {tells}:
    os.environ['MICROBOT_PARENT'] = str(os.getpid())
node = subprocess.Popen(sys.argv[1:], start_new_session=True)
print(node.pid, flush=True)
time.sleep(3600)
"""


class Bench:
    """An emulated amplifier, whoever commands it, and what was started."""

    def __init__(self, folder: Path, emulator: Any) -> None:
        self.folder = folder
        self.emulator = emulator
        self.client = GraphClient('commander')
        self._started: list[psutil.Process] = []
        self._open = ExitStack()
        self._commands = self.client.node.create_publisher(Vector3Stamped, 'field/command', 1)
        # Long enough that no zero in time is one of a stale command.
        self.parameters = {
            'coil_driver': {'port': emulator.url, 'full_scale_A': 2.0,
                            'command_timeout_ms': 2000.0, 'max_command_age_ms': 2000.0},
            'recorder': {'folder': str(folder / 'recording')}}

    def command_line(self, *nodes: str) -> list[str]:
        """What runs nodes."""
        file = write_rig(self.folder / 'parameters.yaml', self.parameters)
        return [sys.executable, '-m', 'microbot_ros.nodes', *nodes, '--ros-args',
                '--params-file', str(file)]

    def start(self, *words: str, **options: Any) -> subprocess.Popen[str]:
        """A process that is ended with the test."""
        process = subprocess.Popen(words, text=True, env={**os.environ, PARENT: ''}, **{
            'stdout': subprocess.PIPE, **options})
        self._open.enter_context(process)
        self.watch(process.pid)
        return process

    def watch(self, process: int) -> psutil.Process:
        """A process that is ended with the test."""
        self._started.append(psutil.Process(process))
        return self._started[-1]

    def command(self, x_T: float = 2e-3) -> None:
        """Ask once for a field."""
        now = self.client.node.get_clock().now().to_msg()
        self._commands.publish(messages.field_vector(np.array([x_T, 0.0]), now))
        self.client.spin(0.01)

    def drive(self) -> None:
        """Arm and command until current flows."""
        deadline = time.monotonic() + 60
        while self.emulator.zero:
            assert time.monotonic() < deadline
            with suppress(InputError, RigError):
                self.client.arm()
            for _ in range(5):
                self.command(0.0)  # which the driver waits for after arming
            for _ in range(50):
                self.command()

    def zero_after(self, moment: float) -> float:
        """Go on commanding until no current flows; how long after a moment that was [s]."""
        while not self.emulator.zero:
            assert time.monotonic() < moment + 10
            self.command()
        last = self.emulator.entries()[-1]
        assert last['cause'] == 'command'  # of the driver: the device's watchdog had no part
        return float(last['t_monotonic_s'] - moment)

    def end(self) -> None:
        """Leave nothing behind."""
        self.client.__exit__()
        for process in self._started:
            with suppress(psutil.NoSuchProcess):
                process.kill()
        self._open.close()


@pytest.fixture
def bench(tmp_path: Path, emulator: Any) -> Iterator[Bench]:
    """A coil driver's surroundings."""
    made = Bench(tmp_path, emulator)
    yield made
    made.end()


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_driver_by_itself_is_at_zero_after_any_signal(
        bench: Bench, machine: Any, number: int) -> None:
    node = bench.start(*bench.command_line('coil_driver'))
    bench.drive()
    moment = time.monotonic()
    node.send_signal(number)
    assert bench.zero_after(moment) < ZERO_S + machine.kept_waiting_s(moment)
    assert node.wait(10) == 0


@pytest.mark.parametrize('kind', ['launch', 'ros2'])
def test_a_node_ends_with_its_launcher(
        bench: Bench, machine: Any, kind: str) -> None:
    script = bench.folder / kind
    script.write_text(_LAUNCHER.format(tells=kind == 'launch'))
    launcher = bench.start(sys.executable, str(script), *bench.command_line('coil_driver'))
    assert launcher.stdout is not None
    node = bench.watch(int(launcher.stdout.readline()))
    bench.drive()
    moment = time.monotonic()
    launcher.kill()
    assert bench.zero_after(moment) < ZERO_S + machine.kept_waiting_s(moment)
    node.wait(10)


def test_a_node_that_compiles_ends_at_once(bench: Bench) -> None:
    """The first compilation takes a minute or two, in which it would not be ready to end."""
    cache = bench.folder / 'compiled'
    bench.parameters = {'model': {}}
    with pytest.MonkeyPatch.context() as patched:
        patched.setenv('NUMBA_CACHE_DIR', str(cache))
        node = bench.start(*bench.command_line('model'))
    while not any(cache.rglob('*.nbi')):  # it has begun, and most is left to be done
        assert node.poll() is None
        time.sleep(0.02)
    node.send_signal(signal.SIGINT)
    output, _ = node.communicate(timeout=100)
    assert 'ready' not in output
    assert node.returncode == 0


def test_an_emulator_ends_with_its_launcher(bench: Bench) -> None:
    (bench.folder / 'own').mkdir()
    link = bench.folder / 'own' / 'amplifier'
    script = bench.folder / 'launch'
    script.write_text(_LAUNCHER.format(tells=True))
    launcher = bench.start(sys.executable, str(script), sys.executable, '-m', 'microbot_ros.cli',
                           'emulate', 'serial_transfer', '--link', str(link), '--log',
                           str(link.with_name('log')), '--leave-nothing')
    assert launcher.stdout is not None
    emulator = bench.watch(int(launcher.stdout.readline()))
    assert 'serving' in launcher.stdout.readline()
    launcher.kill()
    emulator.wait(10)
    assert not link.parent.exists()


def test_a_closed_terminal_ends_all(
        bench: Bench, machine: Any) -> None:
    """SIGHUP as it comes, and nowhere to print to any more."""
    bench.command_line()
    terminal, screen = pty.openpty()
    run = bench.start('setsid', '--ctty', sys.executable, '-m', 'microbot_ros.cli', 'run',
                      '--config', str(bench.folder / 'parameters.yaml'), stdin=screen,
                      stdout=screen, stderr=screen)
    os.close(screen)
    shown = b''
    while b'running: ' not in shown:
        shown += os.read(terminal, 4096)
    nodes = [bench.watch(child.pid) for child in psutil.Process(run.pid).children()]
    assert len(nodes) == 2
    bench.drive()
    moment = time.monotonic()
    os.close(terminal)
    assert bench.zero_after(moment) < ZERO_S + machine.kept_waiting_s(moment)
    assert run.wait(20) == 0
    assert not any(node.is_running() for node in nodes)


def test_a_node_outlives_the_shell_that_it_was_started_from(
        bench: Bench, machine: Any) -> None:
    words = ' '.join(bench.command_line('coil_driver'))
    shell = bench.start('sh', '-c', f'nohup {words} & echo $!', stderr=subprocess.DEVNULL)
    assert shell.stdout is not None
    node = bench.watch(int(shell.stdout.readline()))
    assert shell.wait(10) == 0
    bench.drive()
    node.send_signal(signal.SIGHUP)  # nohup
    assert bench.client.get('coil_driver', 'command_timeout_ms') == {'command_timeout_ms': 2000.0}
    assert not bench.emulator.zero
    moment = time.monotonic()
    node.send_signal(signal.SIGTERM)
    assert bench.zero_after(moment) < ZERO_S + machine.kept_waiting_s(moment)
    node.wait(10)
