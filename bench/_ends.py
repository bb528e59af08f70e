"""What ends the current when the driver's process ends: killed, its whole group killed, stopped.

The part of the fault matrix that is true of real processes alone: the emulated device is one, the
driver another, and the sentinel, or the device's own watchdog, must bring every coil to zero.
"""

from __future__ import annotations

import math
import os
import random
import signal
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from bench._emulator import EmulatorProcess
from bench._lines import Host
from bench._matrix import PHASES, Cell, longest_s, table
from microbot_ros.drive.amplifier import Zero, amplifier_class
from microbot_ros.drive.emulator.process import DEVICES

_WATCHED_S = 0.6
"""How long the currents are watched after the end."""
_ARMING_S = 0.3
"""How long the first pulse may take to come; then arming is asked again."""


def _kill(host: Host) -> None:
    host.process.kill()


def _kill_group(host: Host) -> None:
    os.killpg(host.process.pid, signal.SIGKILL)


def _stop(host: Host) -> None:
    host.process.send_signal(signal.SIGSTOP)


WAYS: dict[str, Callable[[Host], None]] = {
    'driver killed': _kill, 'its group killed': _kill_group, 'driver stopped': _stop}


def cells(tries: int) -> Iterator[tuple[str, str, str, Cell]]:
    """Protocol, way to end, phase, and what became of so many tries."""
    random.seed(4)
    with tempfile.TemporaryDirectory() as folder:
        for protocol in DEVICES:
            with EmulatorProcess(Path(folder), protocol) as board:
                for way in WAYS:
                    for phase in PHASES:
                        cell = Cell()
                        for _ in range(tries):
                            _try(protocol, board, way, phase, cell)
                        yield protocol, way, phase, cell


def _try(protocol: str, board: EmulatorProcess, way: str, phase: str, cell: Cell) -> None:
    host = Host(protocol, board.url)
    try:
        _bring_into(protocol, host, board, phase)
        per_line = 4 // len(board.url.split(','))
        away = set(range(per_line)) if phase == 'reconnecting' else set()
        cell.unreachable += host.say('state') == Zero.UNREACHABLE.value
        ended_s = time.monotonic()
        WAYS[way](host)
        time.sleep(_WATCHED_S)
        flowed = [(one['t_monotonic_s'], tuple(one['currents_A'])) for one in board.entries()]
        before = [currents for moment_s, currents in flowed if moment_s <= ended_s][-1]
        after = [change for change in flowed if change[0] > ended_s]
        cell.spent_s.append(
            longest_s([(ended_s, before), *after], ended_s + _WATCHED_S, away))
    finally:
        host.end()


def _bring_into(protocol: str, host: Host, board: EmulatorProcess, phase: str) -> None:
    if phase == 'arming':
        if amplifier_class(protocol).reads_back:
            _await_pulse(host, board)
        else:
            host.say('arm')
        time.sleep(random.choice([0.0, random.uniform(0.0, 0.1)]))
        return
    while host.say('drive') != 'driving':
        time.sleep(0.01)
    time.sleep(random.uniform(0.1, 0.2))
    if phase == 'zeroing':
        host.say('zero')
    elif phase == 'reconnecting':
        board.fault('unplug/1+1.5')
        time.sleep(random.uniform(0.2, 0.4))


def _await_pulse(host: Host, board: EmulatorProcess) -> None:
    """Arm, and return once a coil carries the current of the self-check."""
    before = len(board.changes)
    asked_s = -math.inf
    while all(zero for _, zero in board.changes[before:]):
        if time.monotonic() - asked_s > _ARMING_S:
            host.say('arm')  # refused until something was measured
            asked_s = time.monotonic()
        time.sleep(0.0005)


if __name__ == '__main__':
    for line in table(cells(2)):
        print(line, flush=True)
