"""The only gate between all controllers and the port.

It is pure: it has no port, clock or thread, and times are arguments in seconds of one monotonic
clock. Whenever it cannot affirm the currents, it sets every coil to zero, revokes the permission
to drive and latches the reason. A value passes a limit only if `low <= value <= high` is True,
which is never the case for NaN.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from enum import StrEnum

Currents = tuple[float, ...]

UNATTENDED_S = 3.0
"""Longest pause between two heartbeats of an operator [s]. Choice: three times the period at which
a browser runs a page in the background (1 s); at half of it a hidden tab would disarm the rig."""


@dataclass(frozen=True)
class Limits:
    """Limits that the gate enforces, the same for each coil. All must be finite and above 0."""

    current_A: float
    """Largest magnitude of a current [A]."""
    step_A: float
    """Largest change of a current at once [A]. Every change consumes this allowance and time
    restores it, so that over any time t all changes together stay within `step_A` + t
    `slew_A_per_s`."""
    slew_A_per_s: float
    """Fastest sustained change [A/s]: a sine of amplitude I and frequency f needs 4 I f."""
    command_timeout_s: float
    """Time [s] that a command other than zero holds without the next one."""
    deviation_A: float
    """Largest distance [A] of a measured current from the currents that were commanded while it
    settled."""
    settling_s: float
    """Time [s] that a measured current may take to follow the command."""
    feedback_timeout_s: float
    """Time [s] that currents may flow without a measurement."""
    rated_current_A: float
    """Current [A] that a coil bears indefinitely: I²t settles at its square."""
    thermal_s: float
    """Thermal time constant of a coil [s]."""
    idle_s: float
    """Time [s] that the permission to drive lasts without any command, zero included."""

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not 0.0 < value < math.inf:
                raise ValueError(f'{field.name} must be finite and above 0; received {value}')


class Reason(StrEnum):
    """Reason why the gate revoked its permission."""

    MALFORMED = 'currents are not finite numbers, one per coil'
    LIMIT = 'current limit'
    SLEW = 'slew limit'
    STALE = 'stale command'
    IDLE = 'no commands'
    COMMANDER = 'second commander'
    DEVIATION = 'measured current deviates'
    SILENCE = 'no measurement'
    HEAT = 'coil heat'
    DEVICE = 'fault of the amplifier'
    SELF_CHECK = 'self-check'
    UNATTENDED = 'operator heartbeat lost'
    UNCOMMANDED = 'current measured at zero command'
    CLOCK = 'clock fault'
    LINE = 'connection lost'
    INTERNAL = 'internal error'


@dataclass(frozen=True)
class Fault:
    """A latched fault.

    Attributes
    ----------
    reason : Reason
        Its kind.
    detail : str
        One sentence for a person.
    """

    reason: Reason
    detail: str


class Gate:
    """Gate that passes currents within limits, or returns zero and latches the reason.

    It is disarmed at the start. Every `now_s` is a time [s] of one monotonic clock.

    Parameters
    ----------
    limits : Limits
        Limits of the gate.
    channels : int
        Number of coils N.
    feedback : bool
        Whether currents are measured. Without measurements neither silence nor deviation is a
        fault, and the heat is computed from the commands.
    heat : sequence of float, shape (N,), or None
        Heat of each coil at the start, as a part of the heat it bears; None for cold coils.
    """

    def __init__(self, limits: Limits, channels: int = 4, *, feedback: bool = True,
                 heat: Sequence[float] | None = None) -> None:
        self.limits = limits
        self._feedback = feedback
        self.zero: Currents = (0.0,) * channels
        self.armed = False
        self.fault: Fault | None = None
        self.output: Currents = self.zero
        """Currents (N,) [A] that may flow now."""
        self.heat: Currents = self.zero if heat is None else tuple(heat)
        """I²t of each coil (N,) as a part of the heat it bears; above 1 is a fault."""
        self.holding = False
        """Whether it is armed and passes nothing but zero (`hold`)."""
        self._now_s = self._commanded_s = self._heard_s = self._measured_s = -math.inf
        self._read_s = self._silent_s = self._resumed_s = -math.inf
        self._armed_s = self._attended_s = -math.inf
        self._measured: Currents = self.zero
        self._allowance: Currents = (limits.step_A,) * channels  # remaining change of each
        self._replaced: deque[tuple[float, Currents]] = deque()  # time [s] and output
        self._unsent = 0  # number of these since the last write
        self._behind_s = 0.0  # age of a reading that is too old [s]
        self._lapsed_s = -math.inf

    def arm(self, now_s: float) -> str | None:
        """Clear the fault and pass currents from now on, if that is safe.

        It is safe if no current flows in a recent measurement (with `feedback`) and no coil is
        beyond its heat. An armed gate stays as it is.

        Parameters
        ----------
        now_s : float
            Present time [s] of the monotonic clock.

        Returns
        -------
        str or None
            Why arming is not safe; None if the gate is armed.
        """
        self.tick(now_s)
        if self.armed:
            return None
        if not self._advance(now_s):
            return f'the monotonic clock ran backwards, from {self._now_s} to {now_s}'
        if not self._heard_from_coils(now_s):
            return f'no measured currents for {self.limits.feedback_timeout_s:g} s'
        if not all(abs(current) <= self.limits.deviation_A for current in self._measured):
            return f'{_amperes(self._measured)} measured while zero is commanded'
        if not all(heat <= 1.0 for heat in self.heat):
            return f'a coil is at {max(self.heat):.0%} of its thermal limit'
        self.armed, self.fault, self._heard_s, self._armed_s = True, None, now_s, now_s
        return None

    def hold(self) -> None:
        """Pass nothing but zero until `release`, though armed.

        Commands that are pending were given before arming.
        """
        self.holding = self.armed

    def release(self) -> None:
        """End `hold`."""
        self.holding = False

    def attend(self, now_s: float) -> None:
        """Register the heartbeat of an operator.

        If the last heartbeat before arming was at most `UNATTENDED_S` old, or if one arrived
        since, the permission to drive ends when heartbeats stay away for that long.

        Parameters
        ----------
        now_s : float
            Present time [s] of the monotonic clock.
        """
        self._attended_s = now_s

    def revoke(self) -> None:
        """Disarm: zero from now on. A fault stays latched."""
        self.armed = self.holding = False
        self._put(self.zero)

    def trip(self, reason: Reason, detail: str) -> Currents:
        """Disarm and latch a fault, unless one is latched already.

        Parameters
        ----------
        reason : Reason
            Kind of the fault.
        detail : str
            One sentence for a person.

        Returns
        -------
        Currents, shape (N,)
            Zero.
        """
        self.fault = self.fault or Fault(reason, detail)
        self.revoke()
        return self.zero

    def command(self, currents_A: Sequence[float], now_s: float,
                given_s: float | None = None) -> Currents:
        """Judge wanted currents and return the currents that may flow now.

        Parameters
        ----------
        currents_A : sequence of float, shape (N,)
            Current of each coil [A].
        now_s : float
            Present time [s] of the monotonic clock.
        given_s : float or None
            Time [s] at which the command was given, if it waited until now; None for now.

        Returns
        -------
        Currents, shape (N,)
            The wanted currents [A] if they pass, else zero.
        """
        self.tick(now_s)
        if not self.armed:
            return self.zero
        wanted = self._numbers(currents_A)
        if wanted is None:
            return self.trip(Reason.MALFORMED, f'expected {len(self.zero)} numbers; received '
                             f'{currents_A!r}')
        limit = self.limits.current_A
        if not all(-limit <= value <= limit for value in wanted):
            return self.trip(Reason.LIMIT, f'{_amperes(wanted)} is not within ±{limit:g} A')
        if self.holding and any(wanted):
            return self._put(self.zero)
        left = self._allowance_after(wanted)
        if any(wanted) and not all(allowance >= 0.0 for allowance in left):
            return self.trip(Reason.SLEW, f'from {_amperes(self.output)} to {_amperes(wanted)}')
        self._commanded_s = now_s if given_s is None else min(given_s, now_s)
        self._heard_s = now_s
        if any(wanted) and not now_s - self._commanded_s <= self.limits.command_timeout_s:
            return self.trip(Reason.STALE, f'given {now_s - self._commanded_s:.3f} s ago')
        return self._put(wanted)

    def swing(self, largest_A: Sequence[float], amplitude_A: Sequence[float],
              rate: float) -> Currents:
        """Judge currents that a device rotates by itself.

        A sine changes by 2 I in half a turn, which takes π/|rate|: `step_A` must allow the change
        at once, and `slew_A_per_s` as a sustained change.

        Parameters
        ----------
        largest_A : sequence of float, shape (N,)
            Largest magnitude that each current reaches [A].
        amplitude_A : sequence of float, shape (N,)
            Amplitude of the sine of each current [A].
        rate : float
            Angular velocity [rad/s].

        Returns
        -------
        Currents, shape (N,)
            The currents [A] that may flow now.
        """
        if not self.armed:
            return self.zero
        limit, step, slew = self.limits.current_A, self.limits.step_A, self.limits.slew_A_per_s
        largest, amplitude = self._numbers(largest_A), self._numbers(amplitude_A)
        if largest is None or amplitude is None or not math.isfinite(rate):
            return self.trip(Reason.MALFORMED, 'rotation must be finite; received '
                                               f'{largest_A!r} A, {amplitude_A!r} A at '
                                               f'{rate!r} rad/s')
        if not all(-limit <= value <= limit for value in largest):
            return self.trip(Reason.LIMIT, f'rotation up to {_amperes(largest)} is not within '
                                           f'±{limit:g} A')
        if not all(2.0 * abs(value) <= step and 2.0 * abs(value * rate) / math.pi <= slew
                   for value in amplitude):
            return self.trip(Reason.SLEW, f'±{_amperes(amplitude)} rotating at '
                                          f'{abs(rate) / math.tau:.3g} Hz exceeds the step or '
                                          'slew limit')
        return self.output

    def sent(self, now_s: float) -> None:
        """Register that the present output was handed to the line by `now_s`.

        Until then the coils may have followed the output that it replaced, however late the write
        was.

        Parameters
        ----------
        now_s : float
            Present time [s] of the monotonic clock.
        """
        for index in range(max(len(self._replaced) - self._unsent, 0), len(self._replaced)):
            self._replaced[index] = now_s, self._replaced[index][1]
        self._unsent = 0

    def lapse(self, now_s: float) -> None:
        """Register that the device may have zeroed itself before `now_s`.

        This is so if no command was written for longer than its watchdog may wait.

        Parameters
        ----------
        now_s : float
            Present time [s] of the monotonic clock.
        """
        self._lapsed_s = now_s

    def measured(self, currents_A: Sequence[float], now_s: float,
                 since_s: float | None = None) -> Currents:
        """Judge measured currents and return the currents that may flow now.

        They are compared with every output that the coils may have followed when they were
        measured: the present one and those replaced after `since_s`, less the settling time.
        Currents that agree with none of these, but all together with the outputs of one moment up
        to `feedback_timeout_s` before, are late: they are neither a fault of the coils nor a
        measurement of the present. The same holds for the outputs since the last reading before a
        silence of more than `feedback_timeout_s`, until a disarmed device has had time to settle
        after it: a device that stood still has yet to read the zero that waits for it. It also
        holds for currents between these outputs and zero until the coils have had time to settle
        after a `lapse`. All other currents trip. Once the
        coils have had time to settle at zero, they replace a latched fault: a current without a
        command outranks the reason why nothing is commanded.

        Parameters
        ----------
        currents_A : sequence of float, shape (N,)
            Measured current of each coil [A].
        now_s : float
            Present time [s] of the monotonic clock.
        since_s : float or None
            Time [s] from which outputs are compared: now (None), or earlier if a slow line was
            still transmitting older outputs.

        Returns
        -------
        Currents, shape (N,)
            The currents [A] that may flow now.
        """
        if not self._advance(now_s):
            return self.zero
        measured = self._numbers(currents_A)
        if measured is None:
            return self.trip(Reason.MALFORMED, 'measured currents must be finite; received '
                                               f'{currents_A!r}')
        self._measured = measured
        since_s = now_s if since_s is None else min(since_s, now_s)
        settling_s = self.limits.settling_s
        settled_s = since_s - settling_s
        oldest_s = settled_s - self.limits.feedback_timeout_s
        if not self.armed and now_s - self._read_s > self.limits.feedback_timeout_s:
            self._silent_s, self._resumed_s = self._read_s, now_s
        if now_s - self._resumed_s <= settling_s:
            oldest_s = min(oldest_s, self._silent_s - settling_s)
        self._read_s = now_s
        while self._replaced and not self._replaced[0][0] > oldest_s:
            self._replaced.popleft()
        recent = [self.output, *self._outputs(settled_s, now_s)]
        if self._agrees(measured, recent):
            self._measured_s, self._behind_s = now_s, 0.0
        elif (seen_s := self._last_seen(measured, settled_s)) is not None:
            self._behind_s = now_s - seen_s
        elif self._lapsed_s > settled_s and self._agrees(measured, [self.zero, *recent]):
            self._behind_s = now_s - settled_s
        else:
            self._measured_s = now_s
            return self._deviates(measured, at_rest=not any(map(any, recent)))
        return self.output

    def _deviates(self, measured: Currents, at_rest: bool) -> Currents:
        if at_rest and not self.armed:
            self.fault = Fault(Reason.UNCOMMANDED, f'{_amperes(measured)} measured while zero is '
                               'commanded')
            return self.zero
        return self.trip(Reason.DEVIATION, f'{_amperes(measured)} measured, '
                                           f'{_amperes(self.output)} commanded')

    def _last_seen(self, measured: Currents, before_s: float) -> float | None:
        """Return the last moment until `before_s` with whose outputs these currents agree."""
        moments = [moment_s for moment_s, _ in self._replaced if moment_s <= before_s]
        return next((moment_s for moment_s in reversed(moments) if self._agrees(
            measured, self._outputs(moment_s - self.limits.settling_s, moment_s))), None)

    def _outputs(self, after_s: float, until_s: float) -> list[Currents]:
        """Return the outputs that were replaced in that time."""
        return [output for replaced_s, output in self._replaced if after_s < replaced_s <= until_s]

    def _agrees(self, measured: Currents, outputs: list[Currents]) -> bool:
        """Return whether each current lies among these outputs, to within the deviation."""
        margin = self.limits.deviation_A
        return all(min(recent) - margin <= current <= max(recent) + margin
                   for current, recent in zip(measured, zip(*outputs, strict=True), strict=True))

    def tick(self, now_s: float) -> Currents:
        """Judge the passing of time and return the currents that may flow now.

        Parameters
        ----------
        now_s : float
            Present time [s] of the monotonic clock.

        Returns
        -------
        Currents, shape (N,)
            The currents [A].
        """
        if not self._advance(now_s) or not self.armed:
            return self.zero
        if not self._heard_from_coils(now_s):
            return self.trip(Reason.SILENCE, self._silence(now_s - self._measured_s))
        if any(self.output) and not now_s - self._commanded_s <= self.limits.command_timeout_s:
            return self.trip(Reason.STALE, f'none for {now_s - self._commanded_s:.3f} s')
        if not now_s - self._heard_s <= self.limits.idle_s:
            wanted = 'command of zero' if self.holding else 'command'
            return self.trip(Reason.IDLE, f'no {wanted} for {now_s - self._heard_s:.0f} s')
        if (self._attended_s >= self._armed_s - UNATTENDED_S
                and not now_s - self._attended_s <= UNATTENDED_S):
            return self.trip(Reason.UNATTENDED, 'no operator heartbeat for '
                                                f'{now_s - self._attended_s:.1f} s')
        if not all(heat <= 1.0 for heat in self.heat):
            return self.trip(Reason.HEAT, f'a coil is at {max(self.heat):.0%} of its thermal '
                                          'limit')
        return self.output

    def _heard_from_coils(self, now_s: float) -> bool:
        return (not self._feedback
                or now_s - self._measured_s <= self.limits.feedback_timeout_s)

    def _silence(self, for_s: float) -> str:
        if not self._behind_s:
            return f'none for {for_s:.3f} s'
        return (f'the readings of the last {for_s:.3f} s are of commands older than '
                f'{self._behind_s:.3f} s: serial line or computer is late, or a coil does not '
                'follow')

    def _advance(self, now_s: float) -> bool:
        """Bring heat and slew to `now_s`; trip if the clock runs backwards or is not finite."""
        if not (math.isfinite(now_s) and self._now_s <= now_s):
            self.trip(Reason.CLOCK, f'from {self._now_s} to {now_s}')
            return False
        elapsed = now_s - self._now_s if math.isfinite(self._now_s) else 0.0
        keep = math.exp(-elapsed / self.limits.thermal_s)
        flowing = zip(self.heat, self.output, self._measured, strict=True)
        self.heat = tuple(self._load(output, measured) * (1.0 - keep) + heat * keep
                          for heat, output, measured in flowing)
        self._allowance = tuple(min(allowance + elapsed * self.limits.slew_A_per_s,
                                    self.limits.step_A) for allowance in self._allowance)
        self._now_s = now_s
        return True

    def _load(self, output_A: float, measured_A: float) -> float:
        """Return the value that I²t settles at, for the larger of the two currents."""
        # Bounded, as the square of an absurd reading would be infinite and never cool.
        share = min(max(abs(output_A), abs(measured_A)) / self.limits.rated_current_A, 1e3)
        return share * share

    def _allowance_after(self, currents: Currents) -> Currents:
        changes = zip(self._allowance, self.output, currents, strict=True)
        return tuple(allowance - abs(new - old) for allowance, old, new in changes)

    def _put(self, currents: Currents) -> Currents:
        self._allowance = tuple(max(left, 0.0) for left in self._allowance_after(currents))
        if self._feedback and currents != self.output:  # readings are judged by them, and end them
            self._replaced.append((self._now_s, self.output))
            self._unsent += 1
        self.output = currents
        return currents

    def _numbers(self, values: Sequence[float]) -> Currents | None:
        """Return a finite number for each coil, or None for anything else."""
        try:
            numbers = tuple(float(value) for value in values if math.isfinite(value))
            return numbers if len(numbers) == len(values) == len(self.zero) else None
        except (TypeError, OverflowError):  # text, None, an integer beyond any float
            return None


def _amperes(currents: Iterable[float]) -> str:
    return '(' + ', '.join(f'{current:.3g}' for current in currents) + ') A'
