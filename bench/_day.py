"""A day of commands in fast time, with a fault every minute, from gate to coils and back.

Gate, codec, faults and emulated board are the real ones; only the clock is not.
"""

from __future__ import annotations

import math
import os
import resource
from dataclasses import dataclass

import numpy as np

from microbot_ros.drive.amplifiers.serial_transfer import codec
from microbot_ros.drive.amplifiers.serial_transfer.emulated import Board
from microbot_ros.drive.emulator.coils import Coils
from microbot_ros.drive.emulator.faults import Fault, Faults
from microbot_ros.drive.gate import Currents, Gate, Limits

ZERO = (0.0,) * 4

FULL_SCALE_A = 2.0
_PERIOD_S = 0.09  # just often enough for a watchdog of 100 ms
_LIMITS = Limits(current_A=FULL_SCALE_A, step_A=2 * FULL_SCALE_A, slew_A_per_s=200.0,
                 command_timeout_s=0.2, deviation_A=0.1, settling_s=0.2, feedback_timeout_s=0.4,
                 rated_current_A=1.5, thermal_s=60.0, idle_s=1e9)
_FAULTS = ('drop', 'double', 'truncate', 'flip', 'silence', 'reset', 'open', 'over_temperature',
           'not a number', 'beyond the limit', 'no command')
_FAULT_S = 5.0


@dataclass
class Day:
    """What a day came to."""

    commands: int = 0
    faults: int = 0
    trips: int = 0
    wrong: int = 0
    """Times that a current flowed that was none of: zero, the last affirmed, the one before it."""
    resident_growth_kB: float = 0.0


class _Rig:
    def __init__(self) -> None:
        self.now = 0.0
        self.previous = ZERO
        self.coils = Coils(FULL_SCALE_A, 0.1, open(os.devnull, 'w'), lambda: self.now)  # noqa: SIM115
        self.board = Board(self.coils)
        self.faults: list[Fault] = []
        self.line = Faults(self.faults)
        self.decoder = codec.Decoder(codec.MEASUREMENT_BYTES)
        self.gate = Gate(_LIMITS)

    def exchange(self, out: Currents) -> None:
        """One packet there, whatever comes back to the gate, and time for the watchdog."""
        packet = codec.encode(codec.command([current / FULL_SCALE_A for current in out]))
        answer = b''
        if self.line.value('reset', self.now) is None:
            answer = self.board.receive(0, self._damage(packet), self.now)
            answer += self.board.speak(self.now)
        if self.line.value('silence', self.now) is None:
            for payload in self.decoder.feed(self._damage(answer), self.now):
                self.gate.measured(codec.currents(payload)[:4], self.now)

    def _damage(self, packet: bytes) -> bytes:
        """Bytes lost, doubled, cut; and one flipped bit, which every CRC must catch."""
        if self.line.value('flip', self.now) is None or not packet:
            return self.line.damage(packet, self.now)
        bit = int(self.now * 1e4) % (8 * len(packet))
        damaged = bytearray(packet)
        damaged[bit // 8] ^= 1 << bit % 8
        return bytes(damaged)


def run(hours: float) -> Day:
    """Simulate that many hours; one fault a minute, each five seconds long."""
    random = np.random.default_rng(7)
    rig, day = _Rig(), Day()
    steps = int(hours * 3600 / _PERIOD_S)
    minute, kind, half = -1, '', 0
    for step in range(steps):
        rig.now = step * _PERIOD_S
        rig.coils.watch(rig.now)
        if int(rig.now / 60) > minute:
            minute, kind = int(rig.now / 60), str(random.choice(_FAULTS))
            day.faults += 1
            _begin(rig, kind)
        faulty = rig.now % 60 < _FAULT_S
        _drive(rig, day, kind if faulty else '', random)
        if step == steps // 2:
            half = _resident_kB()
    day.resident_growth_kB = _resident_kB() - half
    return day


def _begin(rig: _Rig, kind: str) -> None:
    rig.faults.clear()
    if kind == 'reset':
        rig.board.reset()
    value = {'open': 2.0, 'truncate': 0.3}.get(kind, 0.02)
    rig.faults.append(Fault(kind, value, rig.now, rig.now + _FAULT_S))


def _drive(rig: _Rig, day: Day, fault: str, random: np.random.Generator) -> None:
    rig.coils.conduct(*rig.line.conducted(rig.now, rig.coils.channels))
    wanted = random.uniform(-1.2, 1.2, 4)
    if fault == 'not a number':
        wanted[random.integers(4)] = random.choice([math.nan, math.inf, -math.inf])
    elif fault == 'beyond the limit':
        wanted *= 10
    was_armed = rig.gate.armed
    if not was_armed:
        rig.gate.arm(rig.now)
    out = rig.gate.tick(rig.now)
    if fault != 'no command':
        out = rig.gate.command(wanted.tolist(), rig.now)
    day.commands += 1
    day.trips += was_armed and not rig.gate.armed
    rig.exchange(out)
    if not rig.gate.armed:
        rig.exchange(ZERO)  # as the driver does at once when a reading trips the gate
    allowed = [ZERO, *_with_dead(out), *_with_dead(rig.previous)]
    day.wrong += not any(_same(rig.coils.currents_A, currents) for currents in allowed)
    rig.previous = out


def _with_dead(out: Currents) -> list[tuple[float, ...]]:
    return [out, tuple(0.0 if coil == 1 else current for coil, current in enumerate(out))]


def _same(first: tuple[float, ...], second: tuple[float, ...]) -> bool:
    return all(abs(a - b) < 1e-6 for a, b in zip(first, second, strict=True))


def _resident_kB() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
