"""Emulated amplifiers, in a thread of this process or in a process of their own, and their log."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TextIO, cast
from unittest import mock

import numpy as np

from microbot_ros.common.patience import PATIENCE
from microbot_ros.drive.emulator.coils import Coils
from microbot_ros.drive.emulator.faults import Faults, parse
from microbot_ros.drive.emulator.line import Line
from microbot_ros.drive.emulator.process import DEVICES, make_device
from microbot_ros.drive.emulator.server import Server
from microbot_ros.drive.gate import Limits

FULL_SCALE_A = 2.0
MEASURED = sorted({*DEVICES} - {'sabertooth'})
"""The protocols whose devices read currents back."""
LIMITS = Limits(
    current_A=FULL_SCALE_A, step_A=2 * FULL_SCALE_A, slew_A_per_s=1e4, command_timeout_s=8.0,
    deviation_A=0.15, settling_s=0.1, feedback_timeout_s=8.0, rated_current_A=3.0, thermal_s=60.0,
    idle_s=60.0)
"""Limits of a driver in tests. Wide in time: a busy machine is no fault."""
_DEADLINE_S = 20.0
_PATIENT = {'write_s': 5.0, 'read_back_s': 2.0}
"""Patience [s] with an amplifier in the same process. Wide, like LIMITS."""


def until(condition: Callable[[], Any], step: Callable[[], object] = lambda: time.sleep(0.001),
          deadline_s: float = _DEADLINE_S) -> Any:
    """Return the first true value of the condition, with a `step` between two evaluations.

    Raises TimeoutError after `deadline_s` [s], which is generous: for tests that fail.
    """
    deadline = time.monotonic() + deadline_s
    while not (value := condition()):
        if time.monotonic() > deadline:
            raise TimeoutError('the awaited condition never came true')
        step()
    return value


def _near(some: Sequence[float], others: Sequence[float]) -> bool:
    return bool(np.allclose(some, others, rtol=0, atol=0.011 * FULL_SCALE_A))


class Emulated(ABC):
    """Emulated amplifier in a `folder`, as a context that switches it off at the end.

    `url` is where it is served, `log` the file with a line of JSON for each change of currents.
    """

    url: str

    def __init__(self, folder: Path, protocol: str) -> None:
        self.link, self.log = folder / protocol, folder / f'{protocol}.jsonl'

    def __enter__(self) -> Emulated:
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    @abstractmethod
    def entries(self) -> list[dict[str, Any]]:
        """Return the log so far: changes of the currents, with moment and cause."""

    @abstractmethod
    def fault(self, text: str) -> None:
        """Let a fault happen from now on."""

    @abstractmethod
    def end(self) -> None:
        """Switch off, as pulling the plug does; harmless the second time."""

    @property
    def currents(self) -> list[float]:
        """The currents that flow now [A]."""
        return list(self.entries()[-1]['currents_A'])

    @property
    def zero(self) -> bool:
        """Whether nothing flows."""
        return not any(self.currents)

    def flows(self, currents: Sequence[float]) -> bool:
        """Whether these currents [A] flow, to 1.1 % of full scale."""
        return _near(self.currents, currents)

    def eventually(self, currents: Sequence[float], cause: str | None = None) -> dict[str, Any]:
        """Wait until these currents [A] flow, for this cause; return the last entry."""
        def reached() -> dict[str, Any]:
            last = self.entries()[-1]
            return last if (_near(last['currents_A'], currents)
                            and cause in (None, last['cause'])) else {}
        found: dict[str, Any] = until(reached)
        return found


class Served(Emulated):
    """Emulated amplifier that a thread of this process serves: quick to start.

    It takes turns with the driver, so a busy machine may keep it from reading or answering for
    longer than a driver waits. Until the last one ends, drivers in this process wait for longer.
    `watchdog_s` is None for a board without a watchdog; `faults` are there from the beginning.
    """

    _patience = mock.patch.multiple(PATIENCE, **_PATIENT)
    _running = 0

    def __init__(self, folder: Path, protocol: str = 'serial_transfer', *,
                 watchdog_s: float | None = 0.1, channels: int = 4,
                 faults: Sequence[str] = ()) -> None:
        super().__init__(folder, protocol)
        self.flowed: list[tuple[float, ...]] = []
        self.causes: list[str] = []
        self.times: list[float] = []
        self._file = self.log.open('w', encoding='utf-8')
        self.coils = Coils(FULL_SCALE_A, watchdog_s, cast(TextIO, self), channels=channels)
        self.device = make_device(protocol, self.coils)
        self.lines = [Line(folder / f'{protocol}-{port}') for port in range(self.device.ports)]
        self.url = ','.join(str(line.link) for line in self.lines)
        self.faults = Faults([parse(text, time.monotonic()) for text in faults])
        self._ending = threading.Event()
        if not Served._running:
            self._patience.start()
        Served._running += 1
        server = Server(self.device, self.lines, self.faults, None)
        self._thread = threading.Thread(target=server.run, args=[self._ending.is_set], daemon=True)
        self._thread.start()

    def write(self, line: str) -> None:
        """Take a line, as the log of the coils."""
        entry = json.loads(line)
        self.flowed.append(tuple(entry['currents_A']))
        self.causes.append(entry['cause'])
        self.times.append(entry['t_monotonic_s'])
        self._file.write(line)

    def flush(self) -> None:
        """Let others read the log."""
        self._file.flush()

    def entries(self) -> list[dict[str, Any]]:
        """Return the log so far."""
        return [{'t_monotonic_s': t, 'currents_A': list(currents), 'cause': cause}
                for t, currents, cause in zip(self.times, self.flowed, self.causes, strict=False)]

    @property
    def currents(self) -> list[float]:
        """The currents that flow now [A]."""
        return list(self.flowed[-1])

    def fault(self, text: str) -> None:
        """Let a fault happen from now on."""
        self.faults.add(parse(text, time.monotonic()))

    def mend(self) -> None:
        """End all faults."""
        self.faults._faults.clear()

    def end(self) -> None:
        """Switch off, as pulling the plug does."""
        if self._thread.is_alive():
            self._ending.set()
            self._thread.join()
            self.coils.zero('power_off')
            for line in self.lines:
                line.unplug()
            self._file.close()
            Served._running -= 1
            if not Served._running:
                self._patience.stop()


class EmulatorProcess(Emulated):
    """Emulated amplifier in a process of its own, started with the `options` of the command."""

    def __init__(self, folder: Path, protocol: str = 'serial_transfer', *options: str) -> None:
        super().__init__(folder, protocol)
        self.process = subprocess.Popen(
            [sys.executable, '-m', 'microbot_ros.cli', 'emulate', protocol, '--link',
             str(self.link), '--log', str(self.log), '--full-scale-A', str(FULL_SCALE_A),
             '--fault', '-', *options],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        *_, places = self.process.stdout.readline().partition(' at ')
        self.url = ','.join(places.split())
        self._reading, self._unfinished = self.log.open(encoding='utf-8'), ''
        self._entries: list[dict[str, Any]] = []

    def entries(self) -> list[dict[str, Any]]:
        """Return the log so far."""
        if not self._reading.closed:
            *lines, self._unfinished = (self._unfinished + self._reading.read()).split('\n')
            self._entries += map(json.loads, lines)
        return self._entries

    @property
    def changes(self) -> list[tuple[float, bool]]:
        """When the currents changed [s, monotonic], and whether all were zero from then on."""
        return [(one['t_monotonic_s'], not any(one['currents_A'])) for one in self.entries()]

    def zero_after(self, moment_s: float, patience_s: float) -> float:
        """When the currents came to zero for good after a moment [s, monotonic].

        Raises TimeoutError if that takes longer than `patience_s` [s].
        """
        until(lambda: self.zero and self.entries()[-1]['t_monotonic_s'] >= moment_s,
              deadline_s=patience_s)
        return float(self.entries()[-1]['t_monotonic_s'])

    def fault(self, text: str) -> None:
        """Let a fault happen from now on."""
        assert self.process.stdin is not None
        self.process.stdin.write(text + '\n')
        self.process.stdin.flush()

    def end(self) -> None:
        """Switch off, as pulling the plug does, whatever became of the process."""
        if self.process.poll() is None:
            self.process.terminate()
        self.process.communicate(timeout=_DEADLINE_S)
        self.entries()
        self._reading.close()
