"""Node `coil_driver`: the commanded field as coil currents, through the gate, to the amplifier."""

from __future__ import annotations

import math
import threading
import time
from collections import Counter
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import TwistStamped, Vector3Stamped
from sensor_msgs.msg import JointState, MagneticField, TimeReference
from std_msgs.msg import Bool, Empty
from std_srvs.srv import SetBool

from microbot_ros.common.errors import InputError
from microbot_ros.common.settings import setting
from microbot_ros.drive.amplifier import BY_HAND, Command, Reading, Zero, amplifier_class
from microbot_ros.drive.coil_driver import (
    STOPPED,
    WITHOUT_FEEDBACK,
    WITHOUT_WATCHDOG,
    CoilDriver,
)
from microbot_ros.drive.errors import AmplifierError
from microbot_ros.drive.gate import Fault, Reason
from microbot_ros.drive.heat import HeatRecord
from microbot_ros.loop.allocation import AllocationStage, GateParameters, limits
from microbot_ros.nodes.base import messages
from microbot_ros.nodes.base.lifecycle import ERROR, LATCHED, NEWEST, OK, WARN, RigNode

_WARM = 0.01
"""Heat of a coil, as a part of the heat it bears, from which it is stored for a restart. Choice: 1
% hardly changes a decision of the gate; less would write files for cold coils."""
_REMIND_SECONDS = 0.2
"""Interval [s] of the messages that the gate is armed, while it waits for a zero. Choice: five a
second reach a controller that was delayed."""
_AHEAD_SECONDS = 0.05
"""How far [s] a stamp may be ahead of the clock here. Choice: two clocks of one network differ by
some milliseconds; what is further ahead was stamped by a clock that is wrong."""
_COMMANDER_SECONDS = 2.0
"""Time [s] that arming waits for a commander to be discovered, as both nodes may just have been
started. Choice: half refuses on a busy machine, twice delays every refusal."""


LIMITS = {
    Reason.LIMIT: 'current_limit_A', Reason.SLEW: 'step_limit_A, slew_limit_A_per_s',
    Reason.STALE: 'command_timeout_ms', Reason.DEVIATION: 'deviation_A, settling_ms',
    Reason.SILENCE: 'feedback_timeout_ms', Reason.HEAT: 'rated_current_A, thermal_s'}
"""Parameters that set the limit, by the reason of a fault."""


def _told(fault: Fault) -> str:
    """Return a fault as text, with the parameters of the violated limit."""
    limits = f' ({LIMITS[fault.reason]})' if fault.reason in LIMITS else ''
    return f'{fault.reason.value}{limits}: {fault.detail}'


@dataclass(frozen=True)
class CoilDriverParameters(GateParameters):
    """Parameters of the node `coil_driver`. All are fixed at start-up: they are safety limits."""

    amplifier: str = setting(
        'serial_transfer', 'Protocol of the amplifier: an entry point of '
                           'microbot_ros.amplifiers.', read_only=True)
    port: str = setting(
        '', 'Serial port or pyserial URL; for one port per coil four, separated by commas.',
        read_only=True)
    full_scale_A: float = setting(
        2.0, 'Current of each channel at full output.', lower=0.01, upper=100.0, read_only=True)
    max_command_age_ms: float = setting(
        75.0, 'A command whose stamp, the exposure that it answers, is older is not driven.',
        lower=10.0, upper=2000.0, read_only=True)
    board_turns: bool = setting(
        False, 'The firmware of the board turns a rotating field by itself, as the reference '
        'firmware does; else the driver sends every sample.', read_only=True)
    self_check: bool = setting(
        True, 'On arming, check sign and gain of each coil with a short pulse, and test a '
              'watchdog that may be in the firmware; false for an amplifier that measures no '
              'currents.', read_only=True)
    accept_no_watchdog: bool = setting(
        False, f'Drive an amplifier without a watchdog: {WITHOUT_WATCHDOG}.', read_only=True)
    accept_no_feedback: bool = setting(
        False, 'Drive an amplifier that measures no currents, with self_check false: '
               f'{WITHOUT_FEEDBACK}.', read_only=True)


class CoilDriverNode(RigNode):
    """Node between `field/command`, `field/rotating` and the amplifier, which publishes `coils/…`.

    A message on `field/command` is a constant field, a message on `field/rotating` a rotating
    field; the newest of both is driven. It publishes `coils/command`, `coils/applied`,
    `coils/measured`, `field/applied` and `coil_driver/latency`.

    The node is a shell: the gate, the dead-man and the reconnection are in `drive` and need no
    executor. Arming is valid for one commander, the one node that publishes commands at that time:
    a second one, or another in its place, ends it. A request to arm waits in its own thread, so
    that a request to disarm zeroes at once; it is refused if a stop, a fault or a signal came
    after it was sent. `~/heartbeat` reports that an operator is present (`Gate.attend`).
    """

    Parameters: ClassVar[type] = CoilDriverParameters

    def setup(self) -> None:
        values: CoilDriverParameters = self.settings
        if not values.port:
            raise InputError(self.get_name(), 'expected the parameter port: the serial port '
                                              'of the amplifier')
        self.stage = AllocationStage(values)
        self._latency = math.nan
        self._refused = 0
        self._commander: set[bytes] = set()
        self._stands_s = -math.inf
        amplifier = amplifier_class(values.amplifier)(
            values.port, values.full_scale_A, len(self.stage.coils.names))
        if values.board_turns and not amplifier.can_swing:
            raise InputError('board_turns', f'{values.amplifier} cannot rotate the field '
                                            'itself; expected false')
        amplifier.swings = values.board_turns
        self._heat = HeatRecord(values.port, limits(values), amplifier.channels)
        self._heat.forget_old()
        self._driver = CoilDriver(
            amplifier, limits(values), self._on_reading, names=self.stage.coils.names,
            on_sent=self._on_sent,
            self_check=values.self_check, accept_no_watchdog=values.accept_no_watchdog,
            accept_no_feedback=values.accept_no_feedback, heat=self._heat.load())
        self._wanted = self.publisher(JointState, 'coils/command')
        self._applied = self.publisher(JointState, 'coils/applied')
        self._measured = self.publisher(JointState, 'coils/measured')
        self._field = self.publisher(MagneticField, 'field/applied')
        self._latencies = self.publisher(TimeReference, '~/latency')
        self._armed, self._told_armed = self.publisher(Bool, '~/armed', LATCHED), False
        self._armed.publish(Bool(data=False))
        self._told_armed_s = 0.0
        self._told_zero: Zero | None = None
        self.subscribe(Vector3Stamped, 'field/command', self._on_command, NEWEST,
                       on_matched=self._on_commanders)
        self.subscribe(TwistStamped, 'field/rotating', self._on_rotating, NEWEST,
                       on_matched=self._on_commanders)
        self.subscribe(Empty, '~/heartbeat', self._on_heartbeat)
        self.service_aside(SetBool, '~/arm', self._on_arm, at_once=self._on_arm_asked)
        self.every(1.0, self._save_heat)
        try:
            self._driver.start()
        except AmplifierError as error:
            raise InputError(self.get_name(), str(error)) from None

    def stop(self) -> None:
        self.make_safe()

    def teardown(self) -> None:
        if not hasattr(self, '_driver'):
            return
        zero = self._driver.stop()
        self._save_heat()
        if zero is not Zero.CONFIRMED and self._driver.amplifier.counters.frames_sent:
            self.get_logger().warning(f'coils at shutdown: {self._zero_sentence(zero)}')

    def make_safe(self) -> None:
        if hasattr(self, '_driver'):
            self._driver.disarm()

    def health(self) -> tuple[bytes, str, dict[str, object]]:
        self._tell_changes()
        counters, gate = self._driver.amplifier.counters, self._driver.gate
        values: dict[str, object] = {
            'armed': gate.armed, 'zero': self._driver.zero or 'no', 'frames_sent':
            counters.frames_sent,
            'frames_received': counters.frames_received, 'crc_errors': counters.crc_errors,
            'discarded_bytes': counters.discarded_bytes, 'latency_ms': self._latency * 1e3,
            'commands_refused': self._refused, 'hottest_coil_percent': 100 * max(gate.heat),
            'self_check': self._self_check(), 'watchdog': self._watchdog(),
            'real_time': self._driver.real_time}
        if gate.fault:
            values |= {'fault_reason': gate.fault.reason.value, 'fault_detail': gate.fault.detail}
        return (*self._condition_of_coils(), values)

    def _condition_of_coils(self) -> tuple[bytes, str]:
        gate, zero = self._driver.gate, self._zero_sentence(self._driver.zero)
        if gate.fault and gate.fault.reason is not Reason.IDLE:
            return ERROR, f'disarmed, {_told(gate.fault)}; {zero}'
        if not self._driver.connected:
            return ERROR, f'amplifier lost at {self.settings.port}, reconnecting; {zero}'
        if gate.fault:
            return WARN, f'disarmed: {gate.fault.detail}; {zero}'
        if not gate.armed:
            return ERROR if self._driver.zero_overdue else OK, f'disarmed; {zero}'
        if self._driver.arming:
            return WARN, 'arming: checking each coil with a pulse'
        if gate.holding:
            return WARN, ('armed; waiting for a zero command: centre the stick, or stop the '
                          'sender and send the goal again')
        return OK, 'driving' + (self._driver.warning and f'; {self._driver.warning}')

    def _zero_sentence(self, zero: Zero | None) -> str:
        """Return the state of the currents as text: `zero`, and what follows from it."""
        amplifier = self._driver.amplifier
        if zero is Zero.UNREACHABLE:
            return (f'{zero}: {", ".join(amplifier.unreachable) or self.settings.port}; these '
                    f'coils may carry current, {BY_HAND}')
        if zero is Zero.SENT and not amplifier.reads_back:
            return f'{zero}: the amplifier measures no currents'
        return zero or 'current is commanded'

    def _save_heat(self) -> None:
        """Store the heat for a restart, if a coil is or was warm.

        It runs in the executor's thread: a slow disk must not delay the driver's thread.
        """
        heat = self._driver.gate.heat
        try:
            if max(heat) > _WARM or self._heat.path.exists():
                self._heat.save(heat)
        except OSError as error:
            self.complain(f'{self._heat.path}: the coil temperatures cannot be saved for a '
                          f'restart ({error.strerror})')

    def _self_check(self) -> str:
        if not self.settings.self_check:
            return 'not checked: the amplifier measures no currents'
        if self._driver.gains is None:
            return 'not passed yet'
        return 'passed, gains ' + ', '.join(f'{gain:.2f}' for gain in self._driver.gains)

    def _watchdog(self) -> str:
        if self._driver.watchdog_s is None:
            return self._driver.warning or self._driver.amplifier.watchdog.value
        return f'in the firmware, zeroed after {self._driver.watchdog_s * 1e3:.0f} ms'

    def _on_command(self, message: Vector3Stamped) -> None:
        field, stamp = messages.vector(message), message.header.stamp
        self._take('field/command', field, np.zeros(3), stamp)

    def _on_rotating(self, message: TwistStamped) -> None:
        field, angular_velocity = messages.rotating_field(message)
        self._take('field/rotating', field, angular_velocity, message.header.stamp)

    def _take(self, topic: str, field: np.ndarray, angular_velocity: np.ndarray,
              stamp: Time) -> None:
        """Drive a command from a topic, unless its stamp is too old or in the future."""
        now_s, stamp_s = self.seconds(), messages.to_seconds(stamp)
        age = now_s - stamp_s
        # Two topics have no common order: a rotation may arrive after the constant field that
        # ended it. A constant field that is ahead of the clock is from before it was set back.
        superseded = stamp_s < self._stands_s <= now_s + _AHEAD_SECONDS
        if age < -_AHEAD_SECONDS:
            self._refuse(f'{topic} is {-age:.3f} s ahead of the clock here; command ignored')
        elif not age <= self.settings.max_command_age_ms * 1e-3:
            self._refuse(f'{topic} is {age:.3f} s old, more than max_command_age_ms; command '
                         'ignored')
        elif topic == 'field/command' or not superseded:
            try:
                wanted = self._drive(field, angular_velocity, stamp)
            except ValueError as error:
                self._refuse(f'{error}; command ignored')
                return
            self._wanted.publish(messages.currents(self.stage.coils.names, wanted, stamp))

    def _drive(self, field: np.ndarray, angular_velocity: np.ndarray, stamp: Time) -> np.ndarray:
        """Give a field to the driver and return the currents (N,) [A] at its start."""
        nothing = not field.any()
        if nothing or not angular_velocity.any():
            wanted = self.stage.step(field)
            self._driver.command(wanted, stamp, neutral=nothing)
            self._stands_s = messages.to_seconds(stamp)
            return wanted
        turning = self.stage.turn(field, angular_velocity)
        self._driver.turn(turning, stamp)
        return turning.at(turning.start)

    def _refuse(self, sentence: str) -> None:
        self._refused += 1
        self.complain(sentence)

    def _on_sent(self, command: Command) -> None:
        """Publish a command that was sent, zeros if the gate tripped; in the driver's thread."""
        self._applied.publish(
            messages.currents(self.stage.coils.names, command.currents_A, command.tag))

    def _on_reading(self, reading: Reading) -> None:
        """Publish measured currents and their latency; in the driver's thread."""
        self._tell_changes()
        now = self.get_clock().now().to_msg()
        self._measured.publish(messages.currents(self.stage.coils.names, reading.currents_A, now))
        field = self.stage.field(reading.currents_A)
        self._field.publish(messages.magnetic_field(field, now))
        acknowledged = reading.acknowledges
        if acknowledged is not None and acknowledged.tag is not None:
            exposed = acknowledged.tag
            self._latency = messages.to_seconds(now) - messages.to_seconds(exposed)
            message = TimeReference(time_ref=exposed, source=self.get_name())
            message.header.stamp = now
            self._latencies.publish(message)

    def _tell_changes(self) -> None:
        """Publish at once whether the gate is armed, and the state of a zero.

        The message is repeated while the driver waits for a zero after arming: the controller
        commands one when it receives the message, and a delayed node receives only the newest
        command.
        """
        armed, zero = self._driver.gate.armed, self._driver.zero
        again = (armed and self._driver.gate.holding
                 and time.monotonic() - self._told_armed_s >= _REMIND_SECONDS)
        if armed != self._told_armed or again:
            self._told_armed, self._told_armed_s = armed, time.monotonic()
            self._armed.publish(Bool(data=armed))
            self._report()
        if not armed and zero is not self._told_zero:
            self._told_zero = zero
            self._report()
        elif armed:
            self._told_zero = None

    def _on_heartbeat(self, _: Empty) -> None:
        self._driver.attend()

    def _commanders(self) -> tuple[list[str], set[bytes]]:
        """Return the full names of the nodes that publish commands, and their endpoints.

        A name is listed as often as it publishes the same topic, and as there are processes of
        that name: a node that was killed and its successor are two.
        """
        names, publishers = Counter[str](), set[tuple[str, bytes]]()
        for topic in ('field/command', 'field/rotating'):
            found = [(f'{one.node_namespace.rstrip("/")}/{one.node_name}', bytes(one.endpoint_gid))
                     for one in self.get_publishers_info_by_topic(topic)]
            names |= Counter(name for name, _ in found)
            publishers |= {*found}
        # The first 12 bytes name the participant (RTPS 2.5, GUID_t), of which a process has one.
        names |= Counter(name for name, _ in {(name, gid[:12]) for name, gid in publishers})
        return sorted(names.elements()), {gid for _, gid in publishers}

    def _on_commanders(self, _: Any) -> None:
        """Zero if the commander has changed since arming."""
        names, endpoints = self._commanders()
        if not self._driver.gate.armed or not names:
            return
        if len(names) > 1:
            detail = f'{len(names)} nodes publish commands: {" and ".join(names)}'
        elif self._commander <= endpoints:
            return
        else:
            detail = f'{names[0]} is new or was restarted; arm again'
        self._driver.request_zero((Reason.COMMANDER, detail))

    def _choose_commander(self, epoch: int) -> str:
        """Store the only commander; return why not if there is not exactly one.

        A stop or fault after `epoch` ends the search.
        """
        deadline = time.monotonic() + _COMMANDER_SECONDS
        while not (found := self._commanders())[0]:
            if self._driver.epoch != epoch:
                return STOPPED
            if time.monotonic() > deadline:
                return 'no node publishes field/command: start the controller first'
            time.sleep(0.02)
        names, self._commander = found
        if len(names) > 1:
            return (f'{len(names)} nodes publish commands, expected one: {" and ".join(names)} (a '
                    'killed process still counts for some seconds)')
        return ''

    def _on_arm_asked(self, request: Any, header: Any) -> threading.Event | int:
        """Send zero at once, or return the epoch of a request to arm; called in the executor."""
        if not request.data:
            return self._driver.request_zero()
        if header.source_timestamp * 1e-9 < self._driver.epoch_wall_s:
            return -1  # sent before the last stop or fault, and delayed
        return self._driver.epoch

    def _on_arm(self, request: Any, response: Any, asked: Any) -> Any:
        """Answer a request to arm or disarm; called in its own thread.

        `asked` is the result of `_on_arm_asked`.
        """
        if not request.data:
            zero = self._driver.await_zero(asked)
            response.success = zero is Zero.CONFIRMED or (
                zero is Zero.SENT and not self._driver.amplifier.reads_back)
            response.message = self._zero_sentence(zero)
        elif not self.active:
            response.success, response.message = False, 'the node is not active'
        else:
            refusal = self._arm(asked)
            response.success = not refusal
            response.message = refusal or '; '.join(filter(None, ['armed', self._driver.warning]))
        self._tell_changes()
        return response

    def _arm(self, epoch: int) -> str:
        refusal = self._choose_commander(epoch)
        if refusal:
            return refusal
        refusal = self._driver.arm(epoch) or ''
        if not refusal:
            self._on_commanders(None)  # commanders may have changed while arming
            refusal = '' if self._driver.gate.armed else self._condition_of_coils()[1]
        return refusal
