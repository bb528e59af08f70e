"""A thread that is late says that it is late: no coil is blamed for a busy machine."""

from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench._virtual import VirtualAmplifier, VirtualDriver
from microbot_ros.drive.emulator.process import DEVICES
from microbot_ros.drive.gate import Gate, Limits, Reason

LIMITS = Limits(
    current_A=2.0, step_A=4.0, slew_A_per_s=1e4, command_timeout_s=0.075, deviation_A=0.2,
    settling_s=0.1, feedback_timeout_s=0.2, rated_current_A=3.0, thermal_s=60.0, idle_s=10.0)
"""The defaults of the node, but for the heat."""
ZERO = (0.0,) * 4
CURRENTS = [(0.8, -0.8, 0.4, 0.4), (0.9, -0.7, 0.5, 0.3), (-0.8, 0.8, 0.4, -0.4)]
MEASURED = sorted({*DEVICES} - {'sabertooth'})
LATE = {Reason.STALE, Reason.SILENCE, Reason.LINE, Reason.SLEW}
pauses = st.tuples(st.sampled_from(['turn', 'poll', 'write', 'written']), st.integers(0, 40),
                   st.sampled_from([0.03, 0.06, 0.09, 0.11, 0.16, 0.25, 0.5, 1.0]))


class LateRig(VirtualDriver):
    """A driver whose thread pauses at the planned `pauses`: where, in which call, for how long
    [s]."""

    def __init__(self, protocol, planned, *, limits=LIMITS, **options):
        super().__init__(VirtualAmplifier(protocol), limits, accept_no_watchdog=True,
                         **options)
        self._planned = {(where, call): pause_s for where, call, pause_s in planned}
        self._calls = dict.fromkeys(('turn', 'poll', 'write', 'written'), 0)
        self._counts = False
        amplifier = self.driver.amplifier
        self._poll, self._write = amplifier.poll, amplifier.write
        amplifier.poll, amplifier.write = self._late_poll, self._late_write

    def begin_driving(self):
        """Connect, and let the first currents flow."""
        self.connect()
        self.turn(0.05)
        self.drive(CURRENTS[0])

    def begin(self):
        """Count the calls from now on."""
        self._counts = True

    def pause(self, where):
        """Let the time of a planned pause pass, in which the thread does nothing."""
        if self._counts:
            pause_s = self._planned.get((where, self._calls[where]), 0.0)
            self._calls[where] += 1
            self.clock.sleep(pause_s)

    def _late_poll(self, timeout_s):
        readings = self._poll(timeout_s)
        self.pause('poll')
        return readings

    def _late_write(self, *what):
        self.pause('write')
        sent = self._write(*what)
        self.pause('written')
        return sent


def drive_late(rig, seconds=0.6):
    """Command currents that change every 20 ms, as a controller on time does."""
    rig.begin_driving()
    rig.begin()
    end_s, count = rig.clock.now_s + seconds, 0
    while rig.clock.now_s < end_s and rig.gate.fault is None:
        rig.pause('turn')
        rig.driver.command(CURRENTS[count // 5 % 3])
        rig.turn(0.02)
        count += 1


@pytest.mark.parametrize('protocol', MEASURED)
@given(st.lists(pauses, min_size=1, max_size=4))
@settings(max_examples=60, deadline=None, derandomize=True)
def test_lateness_alone_is_no_fault_of_the_coils(protocol, planned):
    rig = LateRig(protocol, planned, self_check=False)
    drive_late(rig)
    fault = rig.gate.fault
    assert fault is None or fault.reason in LATE, fault


def test_a_watchdog_that_zeroes_while_the_thread_sleeps_is_no_deviation():
    rig = LateRig('serial_transfer', [('turn', 3, 0.15)], self_check=False)
    drive_late(rig)
    assert 'watchdog' in rig.device.causes
    assert rig.gate.fault.reason is Reason.STALE


def drive_until_it_trips(rig):
    """Command the same all the time; return when the gate tripped, on the rig's clock [s]."""
    while rig.gate.fault is None:
        rig.driver.command(CURRENTS[0])
        rig.turn(0.005)
    return rig.clock.now_s


@pytest.mark.parametrize('wire', ['open=1', 'reversed=3', 'half_gain=2'])
def test_a_coil_that_deviates_trips_at_the_next_report(wire):
    rig = LateRig('serial_transfer', [], self_check=False)
    rig.begin_driving()
    for _ in range(40):  # more than 0.3 s, for which what flowed before may show
        rig.driver.command(CURRENTS[0])
        rig.turn(0.01)
    rig.device.fault(wire)
    began_s = rig.clock.now_s
    tripped_s = drive_until_it_trips(rig)
    assert rig.gate.fault.reason is Reason.DEVIATION
    assert tripped_s - began_s <= 0.02 + 0.005


@pytest.mark.parametrize('wire', ['open=1', 'reversed=1', 'half_gain=2'])
def test_a_coil_that_fails_while_the_thread_sleeps_is_found_once_it_had_time_to_settle(wire):
    rig = LateRig('serial_transfer', [], self_check=False,
                  limits=replace(LIMITS, command_timeout_s=0.5))
    rig.begin_driving()
    rig.clock.sleep(0.35)
    rig.device.fault(wire)
    woke_s = rig.clock.now_s
    tripped_s = drive_until_it_trips(rig)
    assert rig.gate.fault.reason is Reason.DEVIATION
    assert tripped_s - woke_s <= LIMITS.settling_s + 0.02 + 0.005


@pytest.mark.parametrize('planned', [[(where, call, pause_s)] for where in (
    'turn', 'poll', 'write', 'written') for call in (1, 2, 3, 5, 9) for pause_s in (0.12, 0.3)])
def test_the_self_check_blames_no_coil_for_a_thread_that_sleeps(planned):
    rig = LateRig('serial_transfer', planned, self_check=True)
    rig.connect()
    rig.turn(0.05)
    rig.begin()
    answer = rig.ask()
    assert answer is None or answer.split(':')[0] in {reason.value for reason in LATE}, answer


def armed(**limits):
    gate = Gate(replace(LIMITS, **limits))
    gate.measured(ZERO, 0.0)
    assert gate.arm(0.0) is None
    return gate


def test_a_reading_of_coils_on_their_way_counts_from_when_it_was_taken():
    gate = armed()
    gate.command(CURRENTS[0], 1e-3)
    gate.sent(2e-3)
    halfway = [current / 2 for current in CURRENTS[0]]
    gate.measured(halfway, 0.2, since_s=4e-3)  # it waited in the port while the thread slept
    assert gate.armed
    gate.measured(halfway, 0.21)
    assert gate.fault.reason is Reason.DEVIATION


def test_an_output_that_was_written_late_was_followed_until_then():
    gate = armed()
    gate.command(CURRENTS[0], 0.01)
    gate.sent(0.01)
    gate.revoke()
    gate.sent(0.4)  # the thread slept between
    gate.measured(CURRENTS[0], 0.41)
    assert gate.fault is None
    gate.measured(CURRENTS[0], 0.6)
    gate.measured(CURRENTS[0], 0.71)
    assert gate.fault.reason is Reason.UNCOMMANDED


def test_a_first_output_that_was_written_late_left_the_coils_at_zero_until_then():
    gate = armed()
    gate.command(CURRENTS[0], 0.01)
    gate.sent(0.4)
    gate.measured(ZERO, 0.41)
    assert gate.fault is None
    gate.measured(ZERO, 0.71)
    assert gate.fault.reason is Reason.DEVIATION


def test_an_output_that_was_written_late_prolongs_none_that_was_replaced_before():
    gate = armed(command_timeout_s=1.0)
    gate.command(CURRENTS[0], 0.01)
    gate.sent(0.01)
    gate.measured(CURRENTS[0], 0.17)
    gate.command(CURRENTS[1], 0.18)
    gate.sent(0.2)
    gate.measured(ZERO, 0.25)  # too old to be a measurement of the present
    gate.tick(0.4)
    assert gate.fault.reason is Reason.SILENCE
