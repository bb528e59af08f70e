"""Sign and gain of each coil, from a short pulse in one after the other; pure, as the gate is.

The last pulse can be left to the device: one with a watchdog ends it by itself.

The pulses are commands like any other and pass the gate. What they tell is what the amplifier
measures: that each channel drives its own coil, the right way round and as much as it is told.
A coil whose two leads are swapped conducts as it should, and only its field shows it.
"""

from __future__ import annotations

from collections.abc import Sequence

from microbot_ros.common.errors import InputError
from microbot_ros.drive.amplifier import COILS
from microbot_ros.drive.gate import Currents, Limits

_PULSE = 3
"""The pulse is so many times what a reading may deviate by; half a gain is then off by 1.5 of
these, an open coil by 3 and a reversed one by 6."""
LONGEST_WATCHDOG_S = 0.5
"""A device that lets current flow for longer without a host has no watchdog worth the name."""


class SelfCheck:
    """One pass over the coils, called `names` (N,). `wanted` is the command of the moment, `done`
    comes with the last zero, `complaint` names the first coil that is not right; `gains` (N) are
    measured over commanded currents.

    With `tries_watchdog` the last pulse is not taken back: while `silent`, nothing may be sent
    and the device is to go to zero by itself; `watchdog_s` is how long it took, from the pulse.

    A reading agrees within the gate's `deviation_A` and has its `settling_s` to get there; one
    that no settling leads through is judged at once. Raises InputError for limits that leave no
    room for a pulse in which half a gain would show.
    """

    def __init__(self, limits: Limits, names: Sequence[str] = COILS, *,
                 tries_watchdog: bool = False) -> None:
        largest = min(limits.current_A, limits.step_A)
        if not largest > 2 * limits.deviation_A:
            raise InputError('deviation_A', 'expected less than half of the largest step, '
                                            f'{largest:g} A, so that the self-check detects '
                                            f'half a gain; received {limits.deviation_A:g} A')
        self.pulse_A = min(_PULSE * limits.deviation_A, largest)
        self._names = names
        self._zero: Currents = (0.0,) * len(names)
        self.wanted = self._zero
        self.gains: list[float] = []
        self.done = self.silent = False
        self.watchdog_s: float | None = None
        self.complaint = ''
        self._tries_watchdog = tries_watchdog
        self._limits = limits
        self._pulsed_s: float

    def measured(self, currents_A: Sequence[float], now_s: float,
                 since_s: float | None = None) -> None:
        """Take measured `currents_A` (N,) [A] and go on as they allow; `now_s` [s] is now.

        `since_s`: they show what was wanted then, where the line is too slow for what is now.
        """
        since_s = now_s if since_s is None else since_s
        coil, margin = len(self.gains), self._limits.deviation_A
        if self.silent:
            self._await_watchdog(currents_A, now_s, since_s)
        elif all(abs(current - wanted) <= margin
               for current, wanted in zip(currents_A, self.wanted, strict=True)):
            self._agreed(coil, currents_A, now_s)
        elif any(self.wanted):
            settling = all(min(wanted, 0.0) - margin <= current <= max(wanted, 0.0) + margin
                           for current, wanted in zip(currents_A, self.wanted, strict=True))
            if not settling or since_s - self._pulsed_s >= self._limits.settling_s:
                self.complaint = self._diagnosis(coil, currents_A)

    def repeat(self, now_s: float) -> None:
        """Give the pulse its whole time again from `now_s`: it may have been interrupted by the
        device's watchdog, as no command was written for too long."""
        if any(self.wanted) and not self.silent:
            self._pulsed_s = now_s

    def _agreed(self, coil: int, currents_A: Sequence[float], now_s: float) -> None:
        if any(self.wanted):
            self.gains.append(currents_A[coil] / self.pulse_A)
            self.silent = self._tries_watchdog and len(self.gains) == len(self._names)
            if not self.silent:
                self.wanted = self._zero
        elif coil == len(self._names):
            self.done = True
        else:
            pulse = list(self._zero)
            pulse[coil] = self.pulse_A
            self.wanted = tuple(pulse)
            self._pulsed_s = now_s

    def _await_watchdog(self, currents_A: Sequence[float], now_s: float, since_s: float) -> None:
        lasted_s = now_s - self._pulsed_s
        if all(abs(current) <= self._limits.deviation_A for current in currents_A):
            self.watchdog_s, self.wanted = lasted_s, self._zero
            self.silent, self.done = False, True
        elif not since_s - self._pulsed_s < LONGEST_WATCHDOG_S:
            self.complaint = ('the amplifier has no watchdog: current still flowed '
                              f'{lasted_s:.2g} s after the last command; to accept that, set '
                              'accept_no_watchdog: true')

    def _diagnosis(self, coil: int, currents_A: Sequence[float]) -> str:
        margin, found = self._limits.deviation_A, currents_A[coil]
        others = [self._names[other] for other, current in enumerate(currents_A)
                  if other != coil and not abs(current) <= margin]
        if others:
            problem = f'drives {" and ".join(others)}: channels are swapped or shorted together'
        elif abs(found) <= margin:
            problem = 'is open: no current flows'
        elif found < 0:
            problem = 'is reversed'
        else:
            problem = f'has the wrong gain, {found / self.pulse_A:.2g}'
        return (f'{self._names[coil]} {problem} ({found:.2g} A measured, {self.pulse_A:.2g} A '
                'sent)')
