"""How long the coils outlive the last good command, by the emulated amplifier's own log."""

from __future__ import annotations

import json
import mmap
import os
import random
import signal
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from microbot_ros.drive.coil_driver import CoilDriver
from microbot_ros.drive.gate import Limits
from microbot_ros.drive.serial_transfer.driver import SerialTransferAmplifier

FULL_SCALE_A = 2.0
_CURRENTS = [1.0, -1.0, 0.5, 0.0]
_LIMITS = Limits(current_A=FULL_SCALE_A, step_A=4.0, slew_A_per_s=1e4, stale_s=0.08,
                 deviation_A=0.2, settling_s=0.1, silence_s=0.2, continuous_A=1.9, thermal_s=60.0)
_DEADLINE_S = 10.0


class _Host:
    """A forked process that drives, and two numbers shared with it: the time of its last command
    and whether its controller is to hang.
    """

    def __init__(self, url: str) -> None:
        self._shared = mmap.mmap(-1, 16)
        self.id = os.fork()
        if self.id == 0:
            try:
                self._drive(url)
            finally:
                os._exit(1)

    def _drive(self, url: str) -> None:
        driver = CoilDriver(SerialTransferAmplifier(url, FULL_SCALE_A), _LIMITS, lambda _: None,
                            self_check=False)
        driver.start()
        while driver.arm():
            time.sleep(0.005)
        while True:
            hanging, = struct.unpack_from('d', self._shared, 8)
            if not hanging and (command := driver.command(_CURRENTS)):
                struct.pack_into('d', self._shared, 0, command.t_monotonic_s)
            time.sleep(0.01)

    def hang(self) -> None:
        struct.pack_into('d', self._shared, 8, 1.0)

    def last_command_s(self) -> float:
        return float(struct.unpack_from('d', self._shared, 0)[0])

    def end(self) -> None:
        os.kill(self.id, signal.SIGKILL)
        os.waitpid(self.id, 0)


class _Amplifier:
    def __init__(self, folder: Path) -> None:
        self.link, self._log = folder / 'coils', folder / 'log.jsonl'
        self._process = subprocess.Popen(
            [sys.executable, '-m', 'microbot_ros.cli', 'emulate', 'serial_transfer', '--link',
             self.link, '--log', self._log, '--full-scale-A', str(FULL_SCALE_A), '--fault', '-'],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._faults = self._process.stdin
        self._process.stdout.readline()

    def unplug(self) -> None:
        self._faults.write('unplug+0.3\n')
        self._faults.flush()

    def zeroed_s(self, zero: bool) -> float:
        """Waits until the coils are at zero (or are not); when that came about."""
        deadline = time.monotonic() + _DEADLINE_S
        while time.monotonic() < deadline:
            last = self._log.read_text().rpartition('\n')[0].rpartition('\n')[2]
            entry = json.loads(last)
            if any(entry['currents_A']) != zero:
                return float(entry['t_monotonic_s'])
            time.sleep(0.002)
        raise TimeoutError('the emulated amplifier never got there')

    def end(self) -> None:
        self._process.terminate()
        self._process.communicate()


@contextmanager
def _amplifier() -> Iterator[_Amplifier]:
    with tempfile.TemporaryDirectory() as folder:
        amplifier = _Amplifier(Path(folder))
        try:
            yield amplifier
        finally:
            amplifier.end()


_ENDS: dict[str, Callable[[_Host, _Amplifier], None]] = {
    'kill -9 of the host': lambda host, _: os.kill(host.id, signal.SIGKILL),
    'a stopped host': lambda host, _: os.kill(host.id, signal.SIGSTOP),
    'an unplugged line': lambda _, amplifier: amplifier.unplug(),
    'a hung controller': lambda host, _: host.hang(),
}


def worst_s(tries: int) -> dict[str, float]:
    """For each way to end, the longest time from the last good command to zero [s]."""
    chance = random.Random(2)
    worst = dict.fromkeys(_ENDS, 0.0)
    with _amplifier() as amplifier:
        for name, end in _ENDS.items():
            for _ in range(tries):
                host = _Host(str(amplifier.link))
                try:
                    amplifier.zeroed_s(False)
                    time.sleep(chance.uniform(0.02, 0.08))
                    end(host, amplifier)
                    zeroed = amplifier.zeroed_s(True)
                    worst[name] = max(worst[name], zeroed - host.last_command_s())
                finally:
                    host.end()
                _await(amplifier.link)
    return worst


def _await(link: Path) -> None:
    """After an unplug the line comes back under a new name; until then there is no link."""
    deadline = time.monotonic() + _DEADLINE_S
    while not link.exists() and time.monotonic() < deadline:
        time.sleep(0.01)


def left_over(sessions: int = 30) -> int:
    """Threads and open descriptors left by sessions in which the line is unplugged."""
    with _amplifier() as amplifier:
        before = _open_things()
        for _ in range(sessions):
            driver = CoilDriver(SerialTransferAmplifier(str(amplifier.link), FULL_SCALE_A),
                                _LIMITS, lambda _: None, self_check=False)
            driver.start()
            while driver.arm():
                time.sleep(0.005)
            driver.command(_CURRENTS)
            amplifier.unplug()
            while driver.gate.armed:
                time.sleep(0.005)
            driver.stop()
            _await(amplifier.link)
            amplifier.zeroed_s(True)
        return _open_things() - before


def _open_things() -> int:
    return threading.active_count() + len(os.listdir('/proc/self/fd'))
