"""Sign and gain of each coil from one short pulse per coil; pure, like the gate.

The last pulse can be left to the device: a device with a watchdog ends it by itself.

The pulses are ordinary commands and pass the gate. The amplifier's measurements then show that
each channel drives its own coil, with the right sign and the commanded current. A coil with
swapped leads conducts normally; only its field shows the error.
"""

from __future__ import annotations

from collections.abc import Sequence

from microbot_ros.common.errors import InputError
from microbot_ros.drive.amplifier import COILS
from microbot_ros.drive.gate import Currents, Limits

_PULSE = 3
"""Pulse in units of the deviation of a reading. Choice: half a gain is then off by 1.5 of these,
an open coil by 3 and a reversed coil by 6; at half of it half a gain would pass."""
LONGEST_WATCHDOG_S = 0.5
"""Longest time [s] that a watchdog may take. Choice: a device that lets current flow for longer
without a host is treated as one without watchdog."""


class SelfCheck:
    """One pass over the coils.

    `wanted` is the present command, `done` is set with the last zero, `complaint` names the first
    faulty coil, and `gains` (N,) are measured over commanded currents. While `silent`, nothing may
    be sent and the device must go to zero by itself; `watchdog_s` is the time it took, from the
    pulse.

    A reading agrees within the gate's `deviation_A` and has its `settling_s` to get there; a
    reading that cannot occur while settling is judged at once.

    Parameters
    ----------
    limits : Limits
        Limits of the gate.
    names : sequence of str, shape (N,)
        Names of the coils.
    tries_watchdog : bool
        Whether to leave the last pulse to the watchdog of the device.

    Raises
    ------
    InputError
        If the limits leave no room for a pulse that would show half a gain.
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
        """Judge measured currents and proceed to the next step.

        Parameters
        ----------
        currents_A : sequence of float, shape (N,)
            Measured current of each coil [A].
        now_s : float
            Present time [s] of the monotonic clock.
        since_s : float or None
            Time [s] of the commands that the currents show, if the line is too slow for the
            present ones; None for now.
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
        """Restart the time of the present pulse.

        The device's watchdog may have interrupted it, as no command was written for too long.

        Parameters
        ----------
        now_s : float
            Present time [s] of the monotonic clock.
        """
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
