"""A field that turns: how true its axis and frequency are in what six emulated coils carry.

The driver's thread makes it, a sample a millisecond over a real pseudo-terminal, with a new order
every 1/60 s as from a camera. Judged by the board's own log of currents.
"""

from __future__ import annotations

import math
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bench._emulator import FULL_SCALE_A, LIMITS, Served, until
from bench.figure import Figure
from microbot_ros.cli.demo.robots import three_pairs
from microbot_ros.drive.amplifier import Command
from microbot_ros.drive.amplifiers.serial_transfer.driver import SerialTransferAmplifier
from microbot_ros.drive.coil_driver import CoilDriver
from microbot_ros.drive.rotation import Rotation, Turning
from microbot_ros.magnetics import Allocator, CoilSet

_FREQUENCIES_HZ = (0.1, 1.0, 5.0, 20.0, 40.0)
_FIELD_T = 3e-3
_ORDER_S = 1 / 60
_LIMITS = replace(LIMITS, slew_A_per_s=200.0)  # the default of the node


def figures() -> list[Figure]:
    """All of them, the worst over frequencies or changes."""
    coils = CoilSet(three_pairs())
    with tempfile.TemporaryDirectory() as folder:
        rig = _Rig(coils, Path(folder))
        try:
            axes, rates, samples = zip(*map(rig.steady, _FREQUENCIES_HZ), strict=True)
            jump = rig.changes()
        finally:
            rig.end()
    target = '0.1–40 Hz'
    return [
        Figure(19, f'turning field, {target}: direction of its axis, error', max(axes), '°',
               '≤ 0.5', 'what was ordered', max(axes) <= 0.5),
        Figure(19, f'turning field, {target}: frequency, error', 100 * max(rates), '%', '≤ 0.1',
               'what was ordered', max(rates) <= 1e-3),
        Figure(19, 'turning field: samples the board is given', min(samples), '/s',
               '≥ 1000', '', min(samples) >= 1000),
        Figure(19, 'turning field: largest step at 100 changes of axis, rate and strength', jump,
               '× of what slew and turning allow', '≤ 1', 'the gate', jump <= 1),
    ]


class _Noted(SerialTransferAmplifier):
    """Notes what it is given, and of which moment: a line may bring it in heaps."""

    rotation: Rotation

    def __init__(self, *given: Any, **options: Any) -> None:
        super().__init__(*given, **options)
        self.written: list[tuple[float, np.ndarray]] = []

    def write(self, currents_A: Any, *more: Any) -> Command:
        self.written.append((self.rotation._t, np.array(currents_A)))
        return super().write(currents_A, *more)


class _Rig:
    def __init__(self, coils: CoilSet, folder: Path) -> None:
        self.make = Allocator(coils).linear
        self.matrix = coils.actuation_matrix()
        self.board = Served(folder, channels=6)
        self.amplifier = _Noted(self.board.url, FULL_SCALE_A, 6, baud=2_000_000)
        self.driver = CoilDriver(
            self.amplifier, _LIMITS, lambda _: None, self_check=False, accept_no_watchdog=True)
        self.amplifier.rotation = self.driver._rotation
        self.driver.start()
        until(lambda: self.driver.arm() is None)
        self.driver.command(np.zeros(6))  # nothing else flows before
        self.rng = np.random.default_rng(0)

    def end(self) -> None:
        """Zero, and the line given back."""
        self.driver.stop()
        self.board.end()

    def order(self, axis: np.ndarray, frequency: float, field: float, seconds: float) -> None:
        """Turn for that long, ordered again as often as frames come."""
        start = np.cross(axis, [0.0, 0.0, 1.0])
        turning = Turning(np.zeros(6), field * self.make, axis, math.tau * frequency,
                          start / np.linalg.norm(start))
        begun = time.monotonic()
        while time.monotonic() < begun + seconds:
            self.driver.turn(turning)
            time.sleep(_ORDER_S)
        assert self.driver.gate.fault is None, self.driver.gate.fault

    def axis(self) -> np.ndarray:
        """Anywhere."""
        drawn = self.rng.normal(size=3)
        return np.asarray(drawn / np.linalg.norm(drawn))

    def flowed(self, since: int) -> tuple[np.ndarray, np.ndarray]:
        """Times [s] and fields (K, 3) [T] since so many entries of the log."""
        t = np.array(self.board.times[since:])  # noted last of each entry
        return t, np.array(self.board.flowed[since:since + len(t)]) @ self.matrix.T

    def steady(self, frequency: float) -> tuple[float, float, float]:
        """Error of the axis [°], of the frequency (relative), samples a second."""
        axis = self.axis()
        self.order(axis, frequency, _FIELD_T, 0.2)  # past the change
        since = len(self.board.flowed)
        self.order(axis, frequency, _FIELD_T, max(4.0, 1.5 / frequency))
        t, field = self.flowed(since)
        _, _, across = np.linalg.svd(field, full_matrices=False)
        error = math.degrees(math.acos(min(abs(float(across[2] @ axis)), 1.0)))
        first = field[0] / np.linalg.norm(field[0])
        second = np.cross(axis, first)
        phase = np.unwrap(np.arctan2(field @ second, field @ first))
        found = np.polyfit(t - t[0], phase, 1)[0] / math.tau
        return error, abs(found / frequency - 1), len(t) / (t[-1] - t[0])

    def changes(self) -> float:
        """The largest step of a current over what slew and turning allow in its time."""
        worst = 0.0
        for _ in range(100):
            frequency, field = self.rng.uniform(0.1, 40), self.rng.uniform(0, _FIELD_T)
            since = max(len(self.amplifier.written) - 1, 0)
            self.order(self.axis(), frequency, field, 0.05)
            t, currents = map(np.array, zip(*self.amplifier.written[since:], strict=True))
            turning = math.tau * frequency * field * np.linalg.norm(self.make, axis=1).max()
            allowed = (_LIMITS.slew_A_per_s + turning) * np.diff(t) + 1e-6
            worst = max(worst, float((np.abs(np.diff(currents, axis=0)).max(1) / allowed).max()))
        return worst
