"""The dead-man of every amplifier over slow lines: from the last command, or the host's end, to
zero.

The emulated device answers late by so many milliseconds, as behind a USB adapter; the host is a
process of its own that commands at 60 Hz with the limits that the node has by default.
"""

from __future__ import annotations

import os
import random
import select
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from bench._emulator import FULL_SCALE_A, MEASURED, EmulatorProcess
from microbot_ros.common.real_time import SAFETY, set_realtime_priority_of_all
from microbot_ros.drive.amplifier import amplifier_class
from microbot_ros.drive.coil_driver import CoilDriver
from microbot_ros.drive.errors import AmplifierError
from microbot_ros.loop.allocation import GateParameters, limits

DELAYS_MS = (1, 4, 16)
_DEADLINE_S = 5.0
_TRIES_PER_CUT = 5
_HOSTS = 3
_WAYS = {'kill -9': signal.SIGKILL, 'stop': signal.SIGSTOP}


class Host:
    """A driver in a process of its own, which commands, or is silent, as it is told."""

    def __init__(self, protocol: str, url: str) -> None:
        self.process = subprocess.Popen(
            [sys.executable, '-m', 'bench._lines', protocol, url],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, process_group=0)

    def say(self, word: str) -> str:
        """Tell it, and what it answers."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(word + '\n')
        self.process.stdin.flush()
        return self.process.stdout.readline().strip()

    def end(self) -> None:
        """Leave nothing running."""
        self.process.kill()
        self.process.communicate()


@contextmanager
def driving(protocol: str, board: EmulatorProcess) -> Iterator[Host]:
    """A host that drives the coils; another where the one before left its line in disorder."""
    for _ in range(_HOSTS):
        host = Host(protocol, board.url)
        try:
            if host.say('drive') == 'driving':
                yield host
                return
        finally:
            host.end()
    raise RuntimeError(f'{protocol}: the coils were never driven')


def spent_s(tries: int, host_tries: int,
            protocols: Iterable[str] = MEASURED) -> dict[tuple[str, int, str], list[float]]:
    """(protocol, delay [ms], what ended) → seconds to zero, of each try."""
    random.seed(3)
    spent: dict[tuple[str, int, str], list[float]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for protocol in protocols:
            for delay in DELAYS_MS:
                with EmulatorProcess(Path(folder), protocol, '--fault', f'delay={delay}') as board:
                    spent[protocol, delay, 'commands'] = list(_silent(protocol, board, tries))
                    for way in _WAYS:
                        spent[protocol, delay, way] = [
                            _ended(protocol, board, way) for _ in range(host_tries)]
                print(f'{protocol}, {delay} ms: worst of silence '
                      f'{1e3 * max(spent[protocol, delay, "commands"]):.0f} ms', file=sys.stderr,
                      flush=True)
    return spent


def _silent(protocol: str, board: EmulatorProcess, tries: int) -> Iterator[float]:
    """A try that was cut before tells nothing of silence: it is named, another takes its place.

    Raises RuntimeError where that happens more than once in five tries.
    """
    cuts, allowed = 0, tries / _TRIES_PER_CUT
    with driving(protocol, board) as host:
        while tries:
            host.say('drive')
            time.sleep(random.uniform(0.05, 0.15))
            if (answer := host.say('silence')).startswith('cut'):
                print(f'{protocol}: {answer}', file=sys.stderr, flush=True)
                cuts += 1
                if cuts > allowed:
                    raise RuntimeError(f'{protocol}: {cuts} tries were cut, the last: {answer}')
                continue
            tries -= 1
            last = float(answer)
            yield board.zero_after(last, _DEADLINE_S) - last


def _ended(protocol: str, board: EmulatorProcess, way: str) -> float:
    """Once more where the coils were at zero before, cut by a line or a machine that stalled."""
    for _ in range(_HOSTS):
        with driving(protocol, board) as host:
            time.sleep(random.uniform(0.05, 0.15))
            ended = time.monotonic()
            os.kill(host.process.pid, _WAYS[way])
            if board.zero and board.changes[-1][0] < ended:
                continue
            return board.zero_after(ended, _DEADLINE_S) - ended
    raise RuntimeError(f'{protocol}: cut {_HOSTS} times before its end')


def _host(protocol: str, url: str) -> None:
    """What the host's process does: a line on standard input says what next.

    `drive` arms and commands, `silence` commands no more, `arm` only begins to arm, `zero` stops,
    `state` changes nothing. The answer is the state.
    """
    set_realtime_priority_of_all(SAFETY)
    amplifier = amplifier_class(protocol)(url, FULL_SCALE_A)
    driver = CoilDriver(amplifier, limits(GateParameters()), lambda _: None,
                        self_check=amplifier.reads_back, accept_no_watchdog=True,
                        accept_no_feedback=True)
    _start(driver)
    commanding, last = False, 0.0
    while True:
        if commanding:
            last = time.monotonic()
            driver.command([0.5, -0.5, 0.25, 0.0])
        if not select.select([sys.stdin], [], [], 1 / 60)[0]:
            continue
        word = sys.stdin.readline().strip()
        if word == 'state':
            print(driver.zero, flush=True)
            continue
        commanding = word == 'drive'
        if word == 'zero':
            driver.request_zero()
        elif word == 'arm':
            driver.request_arming(driver.epoch)
        elif commanding and not driver.gate.armed:
            while driver.arm() is not None:
                time.sleep(0.01)
            driver.command([0.0] * 4)  # nothing else flows before
        fault = driver.gate.fault
        print('driving' if commanding else f'cut: {fault}' if fault else last, flush=True)


def _start(driver: CoilDriver) -> None:
    """Connect once the lines are there, free and in order: the sentinel of a host that ended holds
    them for 0.2 s more.
    """
    deadline = time.monotonic() + _DEADLINE_S
    while True:
        try:
            driver.start()
        except AmplifierError:
            if time.monotonic() > deadline:
                raise
            time.sleep(0.02)
        else:
            return


if __name__ == '__main__':
    _host(*sys.argv[1:])
