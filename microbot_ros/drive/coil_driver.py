"""Gate and amplifier at work: commands in, readings out, and a dead-man that needs no caller."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress

import numpy as np

from microbot_ros.drive.amplifier import Amplifier, Command, Reading
from microbot_ros.drive.errors import AmplifierError
from microbot_ros.drive.gate import ZERO, Currents, Gate, Limits, Reason
from microbot_ros.drive.real_time import hurry
from microbot_ros.drive.self_check import SelfCheck
from microbot_ros.errors import InputError

_TICK_S = 0.005
"""How late the dead-man can be, beside the gate's own times."""
_REFRESH_S = 0.04
"""The present output goes out again this often: a device's watchdog is fed while commands hold,
and a zero that the line damaged is not the last word."""
_CHECK_WAIT_S = 0.002
_BACKOFF_S = (0.1, 2.0)
"""First and longest pause between attempts to reconnect; each is twice the one before."""


class CoilDriver:
    """Drives one amplifier through one gate; a thread reads, watches and reconnects.

    The thread lives from `start` to `stop` and does all that must happen without being asked:
    stale commands, silence and deviation end in zero, whatever hangs elsewhere in the process;
    a lost line is latched as a fault and reopened with zero, still disarmed. `on_reading` is
    called in that thread for each reading and must not block. Where the system allows it, the
    thread runs in real time: a busy machine does not hold up the zero. With `self_check`, arming
    sends a pulse through each coil first. Raises InputError for a current limit that is more than
    the amplifier can give, and for limits that leave no room for the pulse.
    """

    def __init__(self, amplifier: Amplifier, limits: Limits,
                 on_reading: Callable[[Reading], None], *, self_check: bool = True) -> None:
        full_scale_A = float(amplifier.full_scale_A.min())
        if not limits.current_A <= full_scale_A:
            raise InputError('current_A', f'expected at most the full scale of the amplifier, '
                             f'{full_scale_A:g} A; received {limits.current_A:g} A')
        self.amplifier = amplifier
        self.gate = Gate(limits)
        self.connected = False
        self.real_time = False
        """Whether the thread that watches comes before all that is not real-time."""
        self.gains: list[float] | None = None
        """Measured over commanded current of each coil in the last self-check that passed."""
        self._checks = self_check
        self._check: SelfCheck | None = None
        if self_check:
            SelfCheck(limits)  # raises now for limits that it would raise for on arming
        self._on_reading = on_reading
        self._lock = threading.Lock()
        self._sent: Currents = ZERO
        self._sent_s = 0.0
        self._ending = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Connect, with zero current; raises AmplifierError where that fails."""
        self.amplifier.connect()
        self.connected = True
        self._ending.clear()
        self._thread = threading.Thread(target=self._run, name='coil driver', daemon=True)
        self._thread.start()

    def stop(self) -> bool:
        """Zero, read back, release the port; True where a reading confirmed the zero."""
        with self._lock:
            self.gate.revoke()
        self._ending.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None
        return self._disconnect()

    def arm(self) -> str | None:
        """Let currents flow from now on; or, where that is not safe, say why not.

        Returns after the self-check, some 20 ms a coil; until then commands go nowhere.
        """
        with self._lock:
            if not self.connected:
                return 'the amplifier is not connected'
            if self.amplifier.fault:
                return self.amplifier.fault
            if self.gate.armed:
                return 'the self-check is going on' if self._check else None
            refusal = self.gate.arm(time.monotonic())
            if refusal or not self._checks:
                return refusal
            self._check = SelfCheck(self.gate.limits)
        return self._await_check()

    def _await_check(self) -> str | None:
        """Why the self-check failed or was broken off; the gate sees to it that it ends."""
        while self._check is not None and self.gate.armed:
            time.sleep(_CHECK_WAIT_S)
        with self._lock:
            self._check = None
            if self.gate.fault:
                return f'{self.gate.fault.reason.value}: {self.gate.fault.detail}'
            return None if self.gate.armed else 'disarmed meanwhile'

    def disarm(self) -> None:
        """Zero at once."""
        with self._lock:
            self.gate.revoke()
            self._write_output()

    def command(self, currents_A: Sequence[float] | np.ndarray) -> Command | None:
        """Currents [A], shape (4,), through the gate to the line at once.

        The answer is what went out, zeros if the gate tripped; None where nothing did: disarmed,
        not connected or in the self-check.
        """
        with self._lock:
            if self._check is not None:
                return None
            was_armed = self.gate.armed
            self.gate.command(tuple(currents_A), time.monotonic())
            return self._write_output() if was_armed else None

    def _write_output(self) -> Command | None:
        if not self.connected:
            return None
        try:
            self._sent, self._sent_s = self.gate.output, time.monotonic()
            return self.amplifier.write(self._sent)
        except AmplifierError as error:
            self._lose(error)
            return None

    def _run(self) -> None:
        self.real_time = hurry()
        pause_s = _BACKOFF_S[0]
        try:
            while not self._ending.is_set():
                if self.connected:
                    self._serve()
                    pause_s = _BACKOFF_S[0]
                    continue
                self.amplifier.close()
                if not self._ending.wait(pause_s):
                    pause_s = min(2 * pause_s, _BACKOFF_S[1])
                    self._reconnect()
        except BaseException as error:
            with self._lock:
                self.gate.trip(Reason.INTERNAL, repr(error))
            self._disconnect()
            raise

    def _serve(self) -> None:
        """Wait for readings or one tick, then let the gate judge what there is."""
        try:
            readings = self.amplifier.poll(_TICK_S)
        except AmplifierError as error:
            with self._lock:
                self._lose(error)
            return
        with self._lock:
            now = time.monotonic()
            if self.amplifier.fault:
                self.gate.trip(Reason.DEVICE, self.amplifier.fault)
            for reading in readings:
                self._judge(reading, now)
            if self._check is not None:
                self._go_on_checking(self._check, now)
            if self.gate.tick(now) != self._sent or now - self._sent_s >= _REFRESH_S:
                self._write_output()
        for reading in readings:
            self._on_reading(reading)

    def _judge(self, reading: Reading, now: float) -> None:
        currents: list[float] = reading.currents_A.tolist()
        if self._check is not None:
            # Before the gate, which would trip at the same current and could not name the coil.
            self._check.measured(currents, now)
            if self._check.complaint:
                self.gate.trip(Reason.SELF_CHECK, self._check.complaint)
        self.gate.measured(currents, now)

    def _go_on_checking(self, check: SelfCheck, now: float) -> None:
        self.gate.command(check.wanted, now)
        if check.done:
            self.gains, self._check = check.gains, None

    def _lose(self, error: AmplifierError) -> None:
        self.connected = False
        self.gate.trip(Reason.LINE, str(error))

    def _reconnect(self) -> None:
        with suppress(AmplifierError):
            self.amplifier.connect()
            self.connected = True

    def _disconnect(self) -> bool:
        self.connected = False
        return self.amplifier.close()
