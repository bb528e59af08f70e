"""Gate and amplifier in operation: commands, readings, and a dead-man that needs no caller."""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from typing import Any

import numpy as np

from microbot_ros.common.errors import InputError
from microbot_ros.common.patience import PATIENCE
from microbot_ros.common.real_time import set_realtime_priority
from microbot_ros.drive.amplifier import (
    COILS,
    Amplifier,
    Command,
    Reading,
    Swing,
    Watchdog,
    Zero,
)
from microbot_ros.drive.errors import AmplifierError
from microbot_ros.drive.gate import Currents, Fault, Gate, Limits, Reason
from microbot_ros.drive.last_resort import LastResort
from microbot_ros.drive.rotation import Rotation, Turning
from microbot_ros.drive.self_check import SelfCheck

_TICK_S = 0.005
"""Longest delay [s] of the dead-man, in addition to the gate's own times. Choice: a tenth of the
shortest common watchdog would be 10 ms; half of that costs 200 wake-ups a second."""
_REFRESH_S = 0.04
"""Interval [s] at which the present output is sent again: it feeds a device's watchdog while
commands hold, and a zero that the line damaged is repeated. Choice: twice within a watchdog of 0.1
s."""
_LAPSE_S = 0.06
"""Pause [s] between two writes after which the watchdog of the device may have zeroed the coils.
Choice: a thread on time writes every 0.045 s at least, and known watchdogs wait 0.1 s."""
_RECONNECT_S = 0.1
"""Pause [s] between attempts to reconnect. Choice: a line that returns is at zero within 0.2 s."""
_TOLD_S = 0.01
"""Shortest interval [s] between published readings while currents rotate. Choice: 100 of the
thousand readings a second."""
_LOOK_S = 0.002
"""Interval [s] at which `await_zero` checks. Choice: a tenth of the interval of most readings."""
STOPPED = 'the rig was stopped after this request; request it again'
"""Why arming is refused that was requested before a stop, a trip or a signal."""
WITHOUT_WATCHDOG = ('if this computer loses its power while coils are driven, the last currents '
                    'flow until the amplifier is switched off by hand')
UNWATCHABLE = ('the sentinel cannot open a port of this kind: if this program is killed, the last '
               'currents flow on')
WITHOUT_FEEDBACK = ('an open, shorted or reversed coil goes unnoticed, and so do a current '
                    'without a command and a timeout that the amplifier did not accept')

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class _Order:
    wanted: tuple[Any, ...] | Turning
    given_s: float
    tag: Any


class CoilDriver:
    """Driver of one amplifier through one gate, both used by one thread only.

    The thread lives from `start` to `stop` and alone judges and writes. Other threads leave
    commands in a mailbox, in which the newest replaces a waiting one. The thread does everything
    that must happen without a request: stale commands, silence and deviation end in zero, whatever
    hangs elsewhere in the process; a lost line is latched as a fault and reopened with zero, still
    disarmed. If the system allows it, the thread runs with real-time priority.

    After arming only zero passes until a zero was commanded that was given after arming was
    requested: no command from before moves anything. Every stop and every fault begins a
    new `epoch`; arming that was requested in an older one is refused.

    A device without watchdog is watched by a sentinel process, which zeroes it when this process
    dies or hangs. So is a device that reads no currents back, as it cannot confirm that its
    watchdog is armed.

    Parameters
    ----------
    amplifier : Amplifier
        Driver of the device.
    limits : Limits
        Limits of the gate.
    on_reading : callable
        Called in the thread with each reading. It must not block; if it raises, the coils go to
        zero and the thread continues.
    names : sequence of str, shape (N,)
        Names of the coils.
    on_sent : callable
        Called in the thread with each command that was sent and had a tag, under the same rules.
    self_check : bool
        Whether arming first sends a pulse through each coil, and tries the watchdog of a device
        whose firmware may have one.
    accept_no_watchdog : bool
        Whether a device without watchdog is accepted.
    accept_no_feedback : bool
        Whether a device that reads no currents back is accepted; it has no self-check.
    heat : sequence of float, shape (N,), or None
        Heat of the coils at the start (`HeatRecord`); None for cold coils.

    Raises
    ------
    InputError
        If a required acceptance is missing, if the current limit exceeds the full scale, or if the
        limits leave no room for the pulse.
    """

    def __init__(self, amplifier: Amplifier, limits: Limits,
                 on_reading: Callable[[Reading], None], *, names: Sequence[str] = COILS,
                 on_sent: Callable[[Command], None] = lambda _: None, self_check: bool = True,
                 accept_no_watchdog: bool = False, accept_no_feedback: bool = False,
                 heat: Sequence[float] | None = None) -> None:
        full_scale_A = float(amplifier.full_scale_A.min())
        if not limits.current_A <= full_scale_A:
            raise InputError('current_limit_A', 'expected at most the full scale of the '
                             f'amplifier, {full_scale_A:g} A; received {limits.current_A:g} A')
        self.amplifier = amplifier
        self.gate = Gate(limits, amplifier.channels, feedback=amplifier.reads_back, heat=heat)
        self._clock = amplifier.clock
        self._names = names
        self.connected = False
        self.real_time = False
        """Whether the thread has priority over everything that is not real-time."""
        self.gains: list[float] | None = None
        """Measured over commanded current of each coil (N,) in the last self-check that passed."""
        self.watchdog_s: float | None = None
        """Time [s] that the device took to zero itself in the last arming that tried its
        watchdog."""
        self._unwatched = amplifier.watchdog is Watchdog.UNCONFIRMED or (
            accept_no_watchdog and amplifier.watchdog is not Watchdog.ARMED)
        self._checks = self_check
        self._tries_watchdog = amplifier.watchdog is Watchdog.FIRMWARE and not self._unwatched
        self._watched = self._unwatched and amplifier.watchable
        self._refuse_unwatched(accept_no_watchdog)
        if not amplifier.reads_back:
            self._refuse_blind(accept_no_feedback)
        self._check: SelfCheck | None = None
        if self_check:
            SelfCheck(limits, names)  # refuse unusable limits now, not on arming
        self._arming: Future[str | None] | None = None
        self._on_reading, self._on_sent = on_reading, on_sent
        self._mail = threading.Lock()
        self._order: _Order | None = None
        self._requests: SimpleQueue[Callable[[], None]] = SimpleQueue()
        self._rotation = Rotation(limits.slew_A_per_s)
        self._turned_s = self._told_s = 0.0
        self._swinging = False
        self._sent: Currents = self.gate.zero
        self._sent_s = self._polled_s = 0.0
        self._last_resort: LastResort | None = None
        self._ending = threading.Event()
        self._thread: threading.Thread | None = None
        self._epoch, self._epoch_wall_s = 0, -math.inf
        self._fault_told: Fault | None = None
        self._asked_s = math.inf
        self._zero_given_s = -math.inf
        self._zero_since_s: float | None = None
        self._zero_seen_s = -math.inf
        self._left = Zero.UNREACHABLE

    def _refuse_unwatched(self, accepted: bool) -> None:
        if self._unwatched and not self._watched and not accepted:
            raise InputError('accept_no_watchdog', f'{UNWATCHABLE}; set it to true to accept that')
        if self.amplifier.watchdog is Watchdog.ARMED or self._unwatched:
            return
        if not (self._tries_watchdog and self._checks):
            raise InputError('accept_no_watchdog', 'the amplifier has no reliable watchdog: '
                                                   f'{WITHOUT_WATCHDOG}; set it to true to '
                                                   'accept that')

    def _refuse_blind(self, accepted: bool) -> None:
        if not accepted:
            raise InputError('accept_no_feedback', 'the amplifier measures no currents: '
                                                   f'{WITHOUT_FEEDBACK}; set it to true to '
                                                   'accept that')
        if self._checks:
            raise InputError('self_check', 'expected false: the amplifier measures no currents')

    @property
    def warning(self) -> str:
        """Warning for the operator who arms; '' if there is none."""
        if not self.amplifier.reads_back:
            warnings = [f'the amplifier measures no currents: {WITHOUT_FEEDBACK}']
        elif self._unwatched:
            warnings = [f'the amplifier has no watchdog: {WITHOUT_WATCHDOG}']
        else:
            return ''
        return '; '.join(warnings if self._watched else [*warnings, UNWATCHABLE])

    # For other threads ----------------------------------------------------------------------

    def start(self) -> None:
        """Connect, with zero current, and start the thread.

        Raises
        ------
        AmplifierError
            If connecting fails.
        """
        self._connect()
        self._ending.clear()
        self._thread = threading.Thread(target=self._run, name='coil driver', daemon=True)
        self._thread.start()

    def stop(self) -> Zero:
        """Zero, read back and release the port.

        Returns
        -------
        Zero
            State of the zero.
        """
        self._ending.set()
        self.amplifier.wake()
        if self._thread is not None:
            self._thread.join()
            self._thread = None
        return self._left

    @property
    def arming(self) -> bool:
        """Whether the self-check is in progress: no command passes yet."""
        return self._arming is not None

    @property
    def epoch(self) -> int:
        """Number of stops and faults so far; see `request_arming`."""
        return self._epoch

    @property
    def epoch_wall_s(self) -> float:
        """Start of the present epoch by the wall clock [s since 1970]."""
        return self._epoch_wall_s

    @property
    def zero(self) -> Zero | None:
        """State of the commanded zero; None while another current is commanded.

        CONFIRMED as long as readings taken after the zero continue to show none.
        """
        if not self.connected:  # what was seen at the end is not seen any more
            return Zero.SENT if self._left is Zero.CONFIRMED else self._left
        since_s = self._zero_since_s
        if since_s is None:
            return None
        age_s = self._clock.now() - self._zero_seen_s
        seen = self._zero_seen_s >= since_s and age_s <= self.gate.limits.feedback_timeout_s
        return Zero.CONFIRMED if seen else Zero.SENT

    @property
    def zero_overdue(self) -> bool:
        """Whether a zero that a reading could confirm is late (`Patience.read_back_s`)."""
        since_s = self._zero_since_s
        return (self.zero is Zero.SENT and self.amplifier.reads_back and since_s is not None
                and self._clock.now() - since_s > PATIENCE.read_back_s)

    def await_zero(self, sent: threading.Event) -> Zero | None:
        """Wait until a zero is confirmed, or cannot be confirmed.

        Parameters
        ----------
        sent : threading.Event
            Event that `request_zero` returned; readings from before say nothing about this zero.

        Returns
        -------
        Zero or None
            The state `zero`; UNREACHABLE if the driver's thread has not sent it in time.
        """
        deadline_s = self._clock.now() + PATIENCE.read_back_s
        if not self._clock.wait(sent, PATIENCE.read_back_s):
            return Zero.UNREACHABLE
        final = Zero.CONFIRMED if self.amplifier.reads_back else Zero.SENT
        while self.connected and self.zero is not final and self._clock.now() < deadline_s:
            self._clock.sleep(_LOOK_S)
        return self.zero

    def request_arming(self, epoch: int) -> Future[str | None]:
        """Begin to arm.

        Parameters
        ----------
        epoch : int
            Epoch in which arming was requested; it is refused if a stop or a fault came since.

        Returns
        -------
        Future[str or None]
            Its result is None when armed, else why arming is not safe.
        """
        answer: Future[str | None] = Future()
        self._request(lambda: self._begin_arming(answer, epoch))
        return answer

    def arm(self, epoch: int | None = None) -> str | None:
        """Arm and wait for the result.

        It returns after the checks, about 20 ms per coil and 0.1 s for the watchdog; until then no
        command passes.

        Parameters
        ----------
        epoch : int or None
            As in `request_arming`; None for the present one.

        Returns
        -------
        str or None
            Why arming is not safe; None when armed.
        """
        if not self.connected:
            return 'the amplifier is not connected'
        answer = self.request_arming(self.epoch if epoch is None else epoch)
        try:
            return answer.result(PATIENCE.arming_s)
        except TimeoutError:
            self.disarm()
            return f'the coil driver did not answer within {PATIENCE.arming_s:g} s'

    def request_zero(self, fault: tuple[Reason, str] | None = None) -> threading.Event:
        """Zero and disarm, without waiting.

        Parameters
        ----------
        fault : tuple[Reason, str] or None
            Fault to latch; None for none.

        Returns
        -------
        threading.Event
            Event that is set when the zero was handed to the line, or could not be.
        """
        self._begin_epoch()
        done = threading.Event()

        def revoke() -> None:
            if fault is None or not self.gate.armed:
                self.gate.revoke()
            else:
                self.gate.trip(*fault)
            try:
                self._write()
            except AmplifierError as error:
                self._lose(error)  # before the answer, which is then of the loss
            finally:
                done.set()
        self._request(revoke)
        return done

    def disarm(self, fault: tuple[Reason, str] | None = None) -> None:
        """Zero and disarm as `request_zero` does; wait until the line accepts it, at most 0.2 s.

        Parameters
        ----------
        fault : tuple[Reason, str] or None
            Fault to latch; None for none.
        """
        done = self.request_zero(fault)
        if self._thread is not None:
            done.wait(PATIENCE.disarming_s)

    def attend(self) -> None:
        """Register the heartbeat of an operator (`Gate.attend`)."""
        self._request(lambda: self.gate.attend(self._clock.now()))

    def command(self, currents_A: Sequence[float] | np.ndarray, tag: Any = None, *,
                neutral: bool = False) -> bool:
        """Leave currents for the gate, in place of any that wait there.

        `on_sent` reports the currents that were sent. Zeros end the wait after arming, and so do
        neutral currents.

        Parameters
        ----------
        currents_A : sequence of float or ndarray, shape (N,)
            Current of each coil [A].
        tag : object
            Identification of the command, returned with it unchanged.
        neutral : bool
            Whether the currents only cancel the field of the room.

        Returns
        -------
        bool
            Whether they may flow, as far as is known now.
        """
        now = self._clock.now()
        if neutral or not np.any(currents_A):
            self._zero_given_s = now  # the next command may take its place in the mailbox
        return self._leave(_Order(tuple(currents_A), now, tag))

    def turn(self, turning: Turning, tag: Any = None) -> bool:
        """Leave rotating currents for the gate; every sample of them passes through it.

        They are sampled as often as the amplifier accepts a sample. Like any command they hold for
        the gate's `command_timeout_s`; the first sample carries the tag.

        Parameters
        ----------
        turning : Turning
            The rotation.
        tag : object
            Identification of the command, returned with it unchanged.

        Returns
        -------
        bool
            As `command`.
        """
        return self._leave(_Order(turning, self._clock.now(), tag))

    def _leave(self, order: _Order) -> bool:
        with self._mail:
            self._order = order
        self.amplifier.wake()
        return self.connected and self.gate.armed and self._arming is None

    def _begin_epoch(self) -> None:
        with self._mail:
            self._epoch += 1
            self._epoch_wall_s = time.time()

    def _request(self, do: Callable[[], None]) -> None:
        self._requests.put(do)
        self.amplifier.wake()

    # In the driver's thread -----------------------------------------------------------------

    def _run(self) -> None:
        self.real_time = set_realtime_priority()
        try:
            while not self._ending.is_set():
                self._turn()
        finally:
            self._finish()

    def _turn(self) -> None:
        """Run one cycle of the thread: judge, write and report, or try to reconnect."""
        try:
            self._serve() if self.connected else self._reconnect()
        except AmplifierError as error:
            self._lose(error)
        except Exception as error:
            self._survive(error)
        fault = self.gate.fault
        if fault is not None and fault is not self._fault_told:
            self._begin_epoch()
        self._fault_told = fault

    def _finish(self) -> None:
        self.gate.revoke()
        self._answer_arming('the coil driver stopped')
        if not self.connected:
            self._left = self.zero or Zero.SENT
        self._disconnect()

    def _serve(self) -> None:
        """Wait for readings, mail or one tick, then let the gate judge them."""
        readings = self.amplifier.poll(self._patience_s())
        self._do_requests()
        order = self._take_order()
        before_s, self._polled_s = self._polled_s, self._clock.now()
        now = self._polled_s
        self._look_for_lapse(now)
        if self.amplifier.fault:
            self.gate.trip(Reason.DEVICE, self.amplifier.fault)
        if self._swinging and self._rotation.turns:
            self._sample(now)  # the device is ahead of the last sample
        for reading in readings:
            # If this thread is late, waiting bytes may be as old as the last poll.
            self._judge(reading, now, min(reading.since_s, before_s))
        was_armed = self.gate.armed
        if self._check is not None:
            self._go_on_checking(self._check, now)
            order = None
        else:
            order = self._let_through(order)
            self._obey(order, now)
        tag = order.tag if order is not None and was_armed else None
        if self._write_due(now, tag):
            self._write(tag)
        if not self.gate.armed:
            self._answer_arming(self._refusal())
        if self._last_resort is not None and not self._last_resort.feed():
            self.gate.trip(Reason.INTERNAL, 'the sentinel process ended')
            self._write()
            self._last_resort.abandon()  # it goes on to count as lost until another was started
            self._start_last_resort()
        for reading in readings:
            self._tell(reading, now)

    def _let_through(self, order: _Order | None) -> _Order | None:
        """Return the order if it may be obeyed: none from before arming was requested."""
        if self.gate.holding and self._zero_given_s >= self._asked_s:
            self.gate.release()
        return None if self.gate.holding else order

    def _write_due(self, now: float, tag: Any) -> bool:
        changed = self.gate.tick(now) != self._sent
        alone = self._swinging and self._may_swing()
        return (changed and not alone) or tag is not None or self._refresh_due(now)

    def _may_swing(self) -> bool:
        """Return whether the device can rotate the currents by itself from here on."""
        return (self.amplifier.swings and self.gate.armed and self._rotation.turns
                and self._rotation.settled)

    def _patience_s(self) -> float:
        if not self._rotation.turns or self._swinging:
            return _TICK_S
        wait_s = self._sent_s + self.amplifier.sample_s - self._clock.now()
        return min(max(wait_s, 0.0), _TICK_S)

    def _obey(self, order: _Order | None, now: float) -> None:
        """Pass the last order to the gate if due: currents once, a rotation by samples."""
        if order is not None:
            wanted = order.wanted
            if isinstance(wanted, Turning):
                self._rotation.follow(wanted, now, np.array(self.gate.output))
                self._turned_s = order.given_s
            else:
                self._rotation.stop()
                self.gate.command(wanted, now, order.given_s)
        due = order is not None or self._swinging or (
            now - self._sent_s >= self.amplifier.sample_s)
        if self._rotation.turns and due:
            self._sample(now)

    def _sample(self, now: float) -> None:
        """Judge the currents of the rotation at `now`."""
        self.gate.command(self._rotation.currents(now).tolist(), now, self._turned_s)
        if not self.gate.armed:
            self._rotation.stop()

    def _tell(self, reading: Reading, now: float) -> None:
        answers = reading.acknowledges is not None and reading.acknowledges.tag is not None
        if answers or not self._rotation.turns or now - self._told_s >= _TOLD_S:
            self._told_s = now
            self._on_reading(reading)

    def _refresh_due(self, now: float) -> bool:
        silent = self._check is not None and self._check.silent
        return now - self._sent_s >= _REFRESH_S and not silent

    def _do_requests(self) -> None:
        with suppress(Empty):
            while True:
                self._requests.get_nowait()()

    def _take_order(self) -> _Order | None:
        with self._mail:
            order, self._order = self._order, None
        return order

    def _write(self, tag: Any = None) -> None:
        if not self.connected:
            return
        swing = self._judged_swing()
        self._swinging = swing is not None
        self._look_for_lapse(self._clock.now())
        self._sent, self._sent_s = self.gate.output, self._clock.now()
        flows = any(self._sent) or swing is not None
        if flows:  # from the first byte on
            self._zero_since_s = None
        sent = self.amplifier.write(self._sent, tag, swing)
        self.gate.sent(self._clock.now())
        if not flows and self._zero_since_s is None:
            self._zero_since_s = sent.t_monotonic_s
        if tag is not None:
            self._on_sent(sent)

    def _look_for_lapse(self, now: float) -> None:
        if now - self._sent_s > _LAPSE_S:
            self.gate.lapse(now)
            if self._check is not None:
                self._check.repeat(now)

    def _judged_swing(self) -> Swing | None:
        """Return how the device rotates the currents by itself, if the gate allows it."""
        if not self._may_swing():
            return None
        swing = self._rotation.swing()
        self.gate.swing(swing.largest.tolist(), swing.amplitude.tolist(), swing.rate)
        return swing if self.gate.armed else None

    def _judge(self, reading: Reading, now: float, since_s: float) -> None:
        currents: list[float] = reading.currents_A.tolist()
        self._look_for_zero(reading, since_s)
        if self._check is not None:
            # Before the gate, which would trip at the same current without naming the coil.
            self._check.measured(currents, now, since_s)
            if self._check.complaint:
                self.gate.trip(Reason.SELF_CHECK, self._check.complaint)
            elif self._check.wanted != self.gate.output:
                self.gate.command(self._check.wanted, now)
        self.gate.measured(currents, now, since_s)

    def _look_for_zero(self, reading: Reading, since_s: float) -> None:
        """Note whether a reading, taken at `since_s` or later, is of after the zero and shows it.

        A reading that does not show it revokes earlier ones.
        """
        if (self._zero_since_s is not None
                and since_s - self.amplifier.report_age_s >= self._zero_since_s):
            seen = self.amplifier.shows_zero(reading.currents_A)
            self._zero_seen_s = reading.t_monotonic_s if seen else -math.inf

    def _begin_arming(self, answer: Future[str | None], epoch: int) -> None:
        if epoch != self.epoch:
            answer.set_result(STOPPED)
            return
        if self._arming is not None or not self.connected or self.amplifier.fault:
            answer.set_result('a self-check is already running' if self._arming is not None else
                              self.amplifier.fault or 'the amplifier is not connected')
            return
        if self.gate.armed:
            answer.set_result(None)
            return
        self._rotation.stop()  # a stop immediately before was not sampled yet
        self._asked_s = self._clock.now()
        refusal = self.gate.arm(self._asked_s)
        self._arming = answer
        if refusal:
            self._answer_arming(refusal)
            return
        if not self._checks:
            self._answer_arming(None)
        else:
            self._check = SelfCheck(self.gate.limits, self._names,
                                    tries_watchdog=self._tries_watchdog)

    def _go_on_checking(self, check: SelfCheck, now: float) -> None:
        self.gate.command(check.wanted, now)
        if check.done:
            self.gains, self.watchdog_s = check.gains, check.watchdog_s
            self._answer_arming(None if self.gate.armed else self._refusal())

    def _answer_arming(self, refusal: str | None) -> None:
        if self._arming is not None:
            self._check = None
            if not refusal:
                self.gate.hold()
            self._arming.set_result(refusal)
            self._arming = None

    def _refusal(self) -> str:
        fault = self.gate.fault
        return f'{fault.reason.value}: {fault.detail}' if fault else 'disarmed meanwhile'

    # When things go wrong -------------------------------------------------------------------

    def _survive(self, error: Exception) -> None:
        """Handle any failure, of a subscriber or of this code: zero, and continue the thread."""
        _log.exception('in the coil driver')
        self.gate.trip(Reason.INTERNAL, repr(error))
        with suppress(Exception):
            self._write()
        self._answer_arming(self._refusal())
        self._clock.wait(self._ending, _TICK_S)  # limit the load of repeated failures

    def _lose(self, error: AmplifierError) -> None:
        self.gate.trip(Reason.LINE, str(error))
        self._answer_arming(self._refusal())
        self._disconnect()

    def _reconnect(self) -> None:
        self._do_requests()
        self._take_order()
        if self._clock.wait(self._ending, _RECONNECT_S):
            return
        try:
            self._connect()
        except AmplifierError:
            self._left = Zero.UNREACHABLE if self.amplifier.unreachable else Zero.SENT

    def _connect(self) -> None:
        self.amplifier.connect()
        self._sent, self._sent_s = self.gate.zero, self._clock.now()
        self._polled_s = self._sent_s
        self._zero_since_s = self._sent_s
        self._zero_seen_s = self._sent_s if self.amplifier.reads_back else -math.inf
        self._start_last_resort()
        self.connected = True

    def _disconnect(self) -> None:
        if not self.connected:
            return
        self._left = Zero.UNREACHABLE  # until closing has shown more
        self.connected = False
        self._left = self.amplifier.close()
        if self._last_resort is not None:
            if self._left is Zero.CONFIRMED:
                self._last_resort.dismiss()
            else:
                self._last_resort.abandon()
            self._last_resort = None

    def _start_last_resort(self) -> None:
        words = self.amplifier.last_words() if self._watched else []
        self._last_resort = LastResort(words) if words else None
