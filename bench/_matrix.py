"""Fault-injection matrix of the drive: how long current flows that can be ended, whatever fails.

A fault comes while the rig is being armed, is armed, is being zeroed or reconnects, and in that
moment nobody commands any more. After 200 ms no coil that can be reached may carry current, and
what the driver says of the zero must be true. Each figure is the longest time for which a coil
that can be reached goes on carrying current after the fault. Watchdogs of the devices are switched
off, so that the driver alone must end it; only where the driver itself ends are they, or the
sentinel, what does.

    python -m bench._matrix        prints the table
"""

from __future__ import annotations

import math
import random
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field

from bench._virtual import VirtualAmplifier, VirtualDriver
from bench.figure import sized
from microbot_ros.drive.amplifier import Zero, amplifier_class
from microbot_ros.drive.emulator.process import DEVICES
from microbot_ros.drive.errors import AmplifierError
from microbot_ros.loop.allocation import GateParameters, limits

PHASES = ('arming', 'armed', 'zeroing', 'reconnecting')
FAULTS = {'line lost': 'unplug', 'silent': 'silence', 'garbled': 'flip=0.01',
          'slow, 16 ms': 'delay=16', 'slow, 40 ms': 'delay=40'}
"""What is wrong with a line → the emulator's fault."""
HOST_FAULTS = ('suspended', 'restarted')
BOUND_S = 0.2
FULL_SCALE_A = 2.0
DRIVING = (1.0, -1.0, 0.5, 0.6)
_TRIES = sized(40, 6)
_SUSPENDED_S = 0.5
_NONE_A = 0.05 * FULL_SCALE_A
_LATER_S = 1.5
"""How long the currents and the answers are watched after a fault."""


@dataclass
class Cell:
    """What became of all tries of one fault in one phase."""

    spent_s: list[float] = field(default_factory=list)
    """How long a coil that can be reached carried current after the fault [s], of each try."""
    unreachable: int = 0
    """Tries in which the driver said of a line that it cannot be reached."""
    wrong: list[str] = field(default_factory=list)
    """What was said and was not true."""

    @property
    def ok(self) -> bool:
        """Whether the bound held in every try, and every answer was true."""
        in_time = bool(self.spent_s) and round(max(self.spent_s), 3) <= BOUND_S
        return in_time and not self.wrong

    def __str__(self) -> str:
        worst = f'{1e3 * max(self.spent_s):.0f}' if self.spent_s else '–'
        said = ' n.r.' if self.unreachable else ''
        return f'{worst}{said}{"" if self.ok else " FAILS"}'


class Rig(VirtualDriver):
    """A driver as the node makes it, without a watchdog to help it, and its emulated amplifier."""

    def __init__(self, protocol: str, seed: int) -> None:
        device = VirtualAmplifier(protocol, full_scale_A=FULL_SCALE_A)
        device.coils.feed = lambda: None  # type: ignore[method-assign]
        device.faults._random.seed(seed)
        self.random = random.Random(seed)
        self.start(device)
        self.turn(0.05)

    def start(self, device: VirtualAmplifier) -> None:
        """Make a new driver, and connect it; a device that measures nothing has no self-check."""
        measures = amplifier_class(device.protocol).reads_back
        super().__init__(device, limits(GateParameters()), self_check=measures,
                         accept_no_watchdog=True, accept_no_feedback=True)
        self.connect()

    def command_for(self, seconds: float) -> None:
        """Command for some seconds at 60 Hz."""
        end_s = self.clock.now_s + seconds
        while self.clock.now_s < end_s:
            self.driver.command(DRIVING)
            self.turn(min(1 / 60, end_s - self.clock.now_s))

    def coils_of(self, number: int) -> set[int]:
        """The coils on a line, counted from 1."""
        per_line = self.device.coils.channels // len(self.device.lines)
        return set(range((number - 1) * per_line, number * per_line))


def _into(rig: Rig, phase: str, number: int) -> None:
    """Bring a rig into a phase in which the line of a `number` is about to fail."""
    if phase == 'arming':
        answer = rig.driver.request_arming(rig.driver.epoch)
        if not answer.done():
            rig.turn(rig.random.uniform(0.0, 0.15))
        return
    rig.drive(DRIVING)
    rig.command_for(rig.random.uniform(0.05, 0.1))
    if phase == 'zeroing':
        rig.driver.request_zero()
        rig.turn(rig.random.choice([0.0, 1e-5, 1e-3, 0.02, 0.05]))
    if phase == 'reconnecting':
        # Another line is away, where there is one; its current flows on.
        other = number % len(rig.device.lines) + 1
        rig.device.fault(f'unplug/{other}')
        rig.turn(rig.random.uniform(0.3, 0.8))
        rig.device.mend()


def line_fault(protocol: str, fault: str, phase: str) -> Cell:
    """A fault of each line in turn, in a phase: when reconnecting, as another line comes back."""
    cell = Cell()
    lines = len(VirtualAmplifier(protocol).lines)
    for number in range(1, lines + 1):
        for seed in range(_TRIES):
            rig = Rig(protocol, seed)
            _into(rig, phase, number)
            rig.device.fault(f'{FAULTS[fault]}/{number}')
            away = rig.coils_of(number) if fault == 'line lost' else set()
            _watch(rig, cell, away)
    return cell


def device_fault(protocol: str, phase: str) -> Cell:
    """One device of several on a line falls silent."""
    cell = Cell()
    addresses = {'modbus': range(1, 5), 'roboclaw': range(0x80, 0x82)}[protocol]
    for address in addresses:
        for seed in range(_TRIES):
            rig = Rig(protocol, seed)
            _into(rig, phase, 1)
            rig.device.mute(address)
            _watch(rig, cell, set())
    return cell


def host_fault(protocol: str, fault: str, phase: str) -> Cell:
    """The machine is suspended, or the driver is killed and started again."""
    cell = Cell()
    for seed in range(_TRIES):
        rig = Rig(protocol, seed)
        _into(rig, phase, 1)
        if fault == 'suspended':
            rig.clock.sleep(_SUSPENDED_S)
        else:
            rig.driver.amplifier._release()
            try:
                rig.start(rig.device)
            except AmplifierError as error:
                cell.wrong.append(str(error))
        _watch(rig, cell, set())
    return cell


def _watch(rig: Rig, cell: Cell, away: set[int]) -> None:
    """Let it go on without commands, and write down when the reachable coils came to zero."""
    device = rig.device
    changes = [(rig.clock.now_s, device.coils.currents_A)]
    before = len(device.flowed)
    flowing_s = [rig.clock.now_s]

    end_s = rig.clock.now_s + _LATER_S

    def at_the_end() -> bool:
        if not any(_reached(device.coils.currents_A, set())):
            flowing_s[0] = rig.clock.now_s
        elif rig.driver.zero is Zero.CONFIRMED and rig.clock.now_s - flowing_s[0] > BOUND_S:
            cell.wrong.append(f'confirmed, and {device.coils.currents_A} A')
        return rig.clock.now_s >= end_s

    rig.until(at_the_end)
    changes += zip(device.times[before:], device.flowed[before:], strict=True)
    cell.spent_s.append(longest_s(changes, rig.clock.now_s, away))
    zero = rig.driver.zero
    cell.unreachable += zero is Zero.UNREACHABLE
    if away and zero is not Zero.UNREACHABLE:
        cell.wrong.append(f'{zero} while a line is lost')


def longest_s(changes: Sequence[tuple[float, tuple[float, ...]]], until_s: float,
              away: set[int]) -> float:
    """The longest time for which a coil carried current [s], but for coils that are away.

    `changes` are moments [s] and the currents [A] from then on; the last lasts `until_s`.
    """
    longest, since_s = 0.0, math.inf
    for moment_s, flowed in changes:
        longest = max(longest, moment_s - since_s)
        if not any(_reached(flowed, away)):
            since_s = math.inf
        elif math.isinf(since_s):
            since_s = moment_s
    return max(longest, until_s - since_s)


def _reached(currents_A: tuple[float, ...], away: set[int]) -> list[float]:
    """The currents that are none: more than any amplifier's reading may be off by."""
    return [current for coil, current in enumerate(currents_A)
            if coil not in away and not abs(current) <= _NONE_A]


def cells() -> Iterator[tuple[str, str, str, Cell]]:
    """Protocol, fault, phase and what became of it, of everything on virtual time."""
    for protocol in DEVICES:
        for fault in FAULTS:
            for phase in PHASES:
                yield protocol, fault, phase, line_fault(protocol, fault, phase)
        if protocol in ('modbus', 'roboclaw'):
            for phase in PHASES:
                yield protocol, 'one device silent', phase, device_fault(protocol, phase)
        for fault in HOST_FAULTS:
            for phase in PHASES:
                yield protocol, fault, phase, host_fault(protocol, fault, phase)


def table(found: Iterable[tuple[str, str, str, Cell]]) -> Iterator[str]:
    """The table, a line at a time: worst milliseconds from the fault to zero."""
    yield '| protocol | fault | ' + ' | '.join(PHASES) + ' |'
    yield '|---|---|' + '---|' * len(PHASES)
    row: list[str] = []
    for protocol, fault, _, cell in found:
        for sentence in sorted(set(cell.wrong)):
            print(protocol, fault, sentence, file=sys.stderr)
        row.append(str(cell))
        if len(row) == len(PHASES):
            yield f'| `{protocol}` | {fault} | ' + ' | '.join(row) + ' |'
            row = []


if __name__ == '__main__':
    for line in table(cells()):
        print(line, flush=True)
