"""An emulated amplifier served by a thread of this process: all real but the process of its own.

Quick to start, so that the drivers can be tried at it in hundreds of broken ways.
"""

from __future__ import annotations

import json
import os
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TextIO, cast

import numpy as np

from microbot_ros.drive.emulator.coils import Coils
from microbot_ros.drive.emulator.faults import Faults, parse
from microbot_ros.drive.emulator.line import Line
from microbot_ros.drive.emulator.process import DEVICES, make_device
from microbot_ros.drive.emulator.server import Server
from microbot_ros.drive.gate import Limits

FULL_SCALE_A = 2.0
LIMITS = Limits(
    current_A=FULL_SCALE_A, step_A=2 * FULL_SCALE_A, slew_A_per_s=1e4, command_timeout_s=8.0,
    deviation_A=0.15, settling_s=0.1, feedback_timeout_s=8.0, rated_current_A=3.0, thermal_s=60.0,
    idle_s=60.0)
"""Wide in time: a busy machine is no fault."""
MEASURED = sorted({*DEVICES} - {'sabertooth'})
"""The protocols whose devices read currents back."""
_DEADLINE_S = float(os.environ.get('MICROBOT_TEST_DEADLINE_S', '10'))


def until(condition: Callable[[], Any]) -> Any:
    """The first true value of the condition; AssertionError after a generous deadline."""
    deadline = time.monotonic() + _DEADLINE_S
    while time.monotonic() < deadline:
        if value := condition():
            return value
        time.sleep(0.001)
    raise AssertionError('the awaited condition never came true')


class Served:
    """An emulated amplifier, the log of what flowed in it, and its faults."""

    def __init__(self, protocol: str, folder: Path, watchdog_s: float | None,
                 channels: int = 4) -> None:
        self.flowed: list[tuple[float, ...]] = []
        self.causes: list[str] = []
        self.times: list[float] = []
        self.coils = Coils(FULL_SCALE_A, watchdog_s, cast(TextIO, self), channels=channels)
        self.device = make_device(protocol, self.coils)
        self.lines = [Line(folder / f'{protocol}-{port}') for port in range(self.device.ports)]
        self.url = ','.join(str(line.link) for line in self.lines)
        self.faults = Faults([])
        self.ending = threading.Event()
        server = Server(self.device, self.lines, self.faults, None)
        self.thread = threading.Thread(target=server.run, args=[self.ending.is_set])
        self.thread.start()

    def write(self, line: str) -> None:
        """As the log of the coils."""
        entry = json.loads(line)
        self.flowed.append(tuple(entry['currents_A']))
        self.causes.append(entry['cause'])
        self.times.append(entry['t_monotonic_s'])

    def flush(self) -> None:
        """Nothing waits."""

    def fault(self, text: str) -> None:
        """Let a fault happen from now on."""
        self.faults.add(parse(text, time.monotonic()))

    def mend(self) -> None:
        """End all faults."""
        self.faults._faults.clear()

    def flows(self, currents: Sequence[float]) -> bool:
        """Whether these currents flow."""
        return bool(np.allclose(self.flowed[-1], currents, rtol=0, atol=0.011 * FULL_SCALE_A))

    def eventually(self, currents: Sequence[float]) -> None:
        """Wait until these currents flow."""
        until(lambda: self.flows(currents))

    def end(self) -> None:
        """Give the terminals back."""
        self.ending.set()
        self.thread.join()
        for line in self.lines:
            line.unplug()
