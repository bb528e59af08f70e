"""What sessions of the driver leave behind in which the line is unplugged."""

from __future__ import annotations

import os
import tempfile
import threading
from pathlib import Path

from bench._emulator import FULL_SCALE_A, EmulatorProcess, until
from microbot_ros.drive.amplifiers.serial_transfer.driver import SerialTransferAmplifier
from microbot_ros.drive.coil_driver import CoilDriver
from microbot_ros.drive.gate import Limits

_LIMITS = Limits(current_A=FULL_SCALE_A, step_A=4.0, slew_A_per_s=1e4, command_timeout_s=0.08,
                 deviation_A=0.2, settling_s=0.1, feedback_timeout_s=0.2,
                 rated_current_A=1.9, thermal_s=60.0, idle_s=60.0)


def left_over(sessions: int = 30) -> int:
    """Threads and open descriptors that are there afterwards and were not before."""
    with (tempfile.TemporaryDirectory() as folder,
          EmulatorProcess(Path(folder)) as board):
        before = _open_things()
        for _ in range(sessions):
            until(Path(board.url).exists)
            driver = CoilDriver(SerialTransferAmplifier(board.url, FULL_SCALE_A), _LIMITS,
                                lambda _: None)
            driver.start()
            until(lambda: driver.arm() is None)  # noqa: B023 — called before the next is made
            driver.command([0.0] * 4)  # nothing else flows before
            driver.command([1.0, -1.0, 0.5, 0.0])
            until(lambda: not board.zero)
            board.fault('unplug+0.2')
            until(lambda: not driver.gate.armed)  # noqa: B023
            driver.stop()
        return _open_things() - before


def _open_things() -> int:
    return threading.active_count() + len(os.listdir('/proc/self/fd'))
