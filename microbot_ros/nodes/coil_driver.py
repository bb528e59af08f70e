"""Node `coil_driver`: the wanted field as four currents, through the gate, to the amplifier."""

from __future__ import annotations

import math
import threading
from collections import deque
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Vector3Stamped
from sensor_msgs.msg import JointState, MagneticField, TimeReference
from std_srvs.srv import SetBool

from microbot_ros.drive.amplifier import Command, Reading, amplifier_class
from microbot_ros.drive.coil_driver import CoilDriver
from microbot_ros.drive.errors import AmplifierError
from microbot_ros.drive.gate import Limits
from microbot_ros.errors import InputError
from microbot_ros.files import read_yaml
from microbot_ros.magnetics import Allocator, CoilSet, CoilSettings
from microbot_ros.nodes import messages
from microbot_ros.nodes.lifecycle import ERROR, OK, WARN, RigNode
from microbot_ros.settings import setting


@dataclass(frozen=True)
class CoilDriverParameters:
    """Parameters of the node `coil_driver`. All are fixed at start-up: they are safety limits."""

    amplifier: str = setting(
        'serial_transfer', 'Protocol, an entry point of microbot_ros.amplifiers.', read_only=True)
    port: str = setting(
        '', 'Serial port or pyserial URL; for one port per coil four, separated by commas.',
        read_only=True)
    coils_file: str = setting(
        '', 'YAML file with the coils; empty takes the default rig.', read_only=True)
    full_scale_A: float = setting(
        2.0, 'Current of each channel at full output.', lower=0.01, upper=100.0, read_only=True)
    current_limit_A: float = setting(
        2.0, 'Largest current the gate lets through.', lower=0.001, upper=100.0, read_only=True)
    step_limit_A: float = setting(
        4.0, 'Largest jump of a current at once.', lower=0.001, upper=200.0, read_only=True)
    slew_limit_A_per_s: float = setting(
        200.0, 'Fastest lasting change of a current.', lower=0.01, upper=1e5, read_only=True)
    stale_ms: float = setting(
        75.0, 'How long a command other than zero holds without the next.', lower=10.0,
        upper=2000.0, read_only=True)
    deviation_A: float = setting(
        0.2, 'How far a measured current may lie from what was commanded.', lower=0.001,
        upper=10.0, read_only=True)
    settling_ms: float = setting(
        100.0, 'How long a measured current may take to follow.', lower=1.0, upper=2000.0,
        read_only=True)
    silence_ms: float = setting(
        200.0, 'How long currents may flow without a measurement.', lower=10.0, upper=5000.0,
        read_only=True)
    continuous_A: float = setting(
        1.5, 'Current that a coil bears for ever.', lower=0.001, upper=100.0, read_only=True)
    thermal_s: float = setting(
        60.0, 'Thermal time constant of a coil.', lower=1.0, upper=3600.0, read_only=True)
    self_check: bool = setting(
        True, 'Check sign and gain of each coil with a short pulse on arming; false for an '
        'amplifier that reads no currents back.', read_only=True)


class CoilDriverNode(RigNode):
    """`field/command` → the line; the line → `coils/…`, `field/applied`, `~/latency`.

    A shell: the gate, the dead-man and the reconnecting are in `drive`, and need no executor.
    """

    Parameters: ClassVar[type] = CoilDriverParameters

    def setup(self) -> None:
        values: CoilDriverParameters = self.settings
        if not values.port:
            raise InputError(self.get_name(), 'expected a parameter port: the serial port of '
                                              'the amplifier')
        file = values.coils_file
        self._coils = CoilSet(read_yaml(file, CoilSettings) if file else None)
        self._allocator = Allocator(self._coils)
        self._awaiting: deque[tuple[Command, Time]] = deque(maxlen=64)
        self._pairing = threading.Lock()
        self._latency = math.nan
        self._refused = 0
        amplifier = amplifier_class(values.amplifier)(values.port, values.full_scale_A)
        self._driver = CoilDriver(amplifier, _limits(values), self._on_reading,
                                  self_check=values.self_check)
        self._wanted = self.publisher(JointState, 'coils/command')
        self._applied = self.publisher(JointState, 'coils/applied')
        self._measured = self.publisher(JointState, 'coils/measured')
        self._field = self.publisher(MagneticField, 'field/applied')
        self._latencies = self.publisher(TimeReference, '~/latency')
        self.subscribe(Vector3Stamped, 'field/command', self._on_command)
        self.service(SetBool, '~/arm', self._on_arm)
        try:
            self._driver.start()
        except AmplifierError as error:
            raise InputError(self.get_name(), str(error)) from None

    def stop(self) -> None:
        self.make_safe()

    def teardown(self) -> None:
        if hasattr(self, '_driver') and not self._driver.stop():
            self.get_logger().warning('no reading confirmed that the coils are at zero')

    def make_safe(self) -> None:
        if hasattr(self, '_driver'):
            self._driver.disarm()

    def health(self) -> tuple[bytes, str, dict[str, object]]:
        counters, gate = self._driver.amplifier.counters, self._driver.gate
        values: dict[str, object] = {
            'armed': gate.armed, 'frames_sent': counters.frames_sent,
            'frames_received': counters.frames_received, 'crc_errors': counters.crc_errors,
            'discarded_bytes': counters.discarded_bytes, 'latency_ms': self._latency * 1e3,
            'commands_refused': self._refused, 'hottest_coil_percent': 100 * max(gate.heat),
            'self_check': self._self_check(), 'real_time': self._driver.real_time}
        if gate.fault:
            sentence = f'coils at zero, {gate.fault.reason.value}: {gate.fault.detail}'
            return ERROR, sentence, values
        if not self._driver.connected:
            return ERROR, f'amplifier lost at {self.settings.port}; reconnecting', values
        if not gate.armed:
            return WARN, 'coils at zero, disarmed', values
        return OK, 'driving', values

    def _self_check(self) -> str:
        if not self.settings.self_check:
            return 'not checked: the amplifier reads no currents back'
        if self._driver.gains is None:
            return 'not passed yet'
        return 'passed, gains ' + ', '.join(f'{gain:.2f}' for gain in self._driver.gains)

    def _on_command(self, message: Vector3Stamped) -> None:
        age = self.seconds() - messages.to_seconds(message.header.stamp)
        if not -0.05 <= age <= self.settings.stale_ms * 1e-3:
            self._refused += 1
            self.complain(f'field/command is {age:.3f} s old; not driven')
            return
        field = np.array([message.vector.x, message.vector.y])
        # What is not finite goes to the gate as it is, which latches it as a fault.
        wanted = (self._allocator.allocate(field).currents if np.isfinite(field).all()
                  else np.full(4, np.nan))
        stamp = message.header.stamp
        with self._pairing:  # the acknowledgement can be faster than the next line
            sent = self._driver.command(wanted)
            if sent is not None:
                self._awaiting.append((sent, stamp))
        self._wanted.publish(messages.currents(self._coils.names, wanted, stamp))
        if sent is not None:
            self._applied.publish(
                messages.currents(self._coils.names, sent.currents_A, stamp))

    def _on_reading(self, reading: Reading) -> None:
        """In the driver's thread: publish what was measured, and how long it took."""
        now = self.get_clock().now().to_msg()
        self._measured.publish(messages.currents(self._coils.names, reading.currents_A, now))
        field = self._allocator.matrix @ reading.currents_A + self._coils.background
        self._field.publish(messages.magnetic_field(field, now))
        exposed = self._exposure_of(reading.acknowledges)
        if exposed is not None:
            self._latency = messages.to_seconds(now) - messages.to_seconds(exposed)
            message = TimeReference(time_ref=exposed, source=self.get_name())
            message.header.stamp = now
            self._latencies.publish(message)

    def _exposure_of(self, acknowledged: Command | None) -> Time | None:
        """The stamp that came with a command; forgets those that it superseded."""
        with self._pairing:
            while acknowledged and self._awaiting and (
                    self._awaiting[0][0].t_monotonic_s <= acknowledged.t_monotonic_s):
                command, exposed = self._awaiting.popleft()
                if command is acknowledged:
                    return exposed
        return None

    def _on_arm(self, request: Any, response: Any) -> Any:
        if not request.data:
            self._driver.disarm()
            response.success, response.message = True, 'disarmed, coils at zero'
        elif not self.active:
            response.success, response.message = False, 'the node is not active'
        else:
            refusal = self._driver.arm()
            response.success = refusal is None
            response.message = refusal or 'armed'
        return response


def _limits(values: CoilDriverParameters) -> Limits:
    return Limits(
        current_A=values.current_limit_A, step_A=values.step_limit_A,
        slew_A_per_s=values.slew_limit_A_per_s, stale_s=values.stale_ms * 1e-3,
        deviation_A=values.deviation_A, settling_s=values.settling_ms * 1e-3,
        silence_s=values.silence_ms * 1e-3, continuous_A=values.continuous_A,
        thermal_s=values.thermal_s)
