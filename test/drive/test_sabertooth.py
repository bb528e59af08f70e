"""Sabertooth: golden bytes, what goes out and when, and what is asked of whoever drives blind."""

import io
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench._emulator import FULL_SCALE_A, LIMITS, Served
from bench._virtual import VirtualAmplifier, VirtualDriver
from microbot_ros.cli.rig import doctor
from microbot_ros.common.errors import InputError
from microbot_ros.drive.amplifier import Watchdog, Zero
from microbot_ros.drive.amplifiers.sabertooth import codec
from microbot_ros.drive.amplifiers.sabertooth.driver import SabertoothAmplifier
from microbot_ros.drive.amplifiers.sabertooth.emulated import Controllers
from microbot_ros.drive.coil_driver import CoilDriver
from microbot_ros.drive.emulator.coils import Coils
from microbot_ros.drive.errors import NoAnswerError, PortLostError
from microbot_ros.drive.gate import Limits, Reason

ZERO = (0.0,) * 4
DRIVING = (1.0, -1.0, 0.5, 0.2)
ZEROS = bytes.fromhex('80000000 80040004 81000001 81040005')


# Packets ------------------------------------------------------------------------------------

def test_golden_bytes():
    assert codec.packet(0x80, 0, 64) == bytes.fromhex('80004040')  # half forward
    assert codec.packet(130, 0, 64) == bytes((130, 0, 64, 66))  # the example of the manual
    assert codec.drive(0x80, 0, 0.5) == bytes.fromhex('80004040')
    assert codec.drive(0x80, 0, -1.0) == bytes.fromhex('80017f00')
    assert codec.drive(0x80, 1, 1.0) == bytes.fromhex('80047f03')
    assert codec.drive(0x87, 1, -0.5) == bytes.fromhex('8705404c')
    assert codec.set_timeout(0x80, 0.1) == bytes.fromhex('800e010f')
    assert codec.set_timeout(0x81, 1.0) == bytes((129, 14, 10, (129 + 14 + 10) % 128))


@pytest.mark.parametrize('duty', [math.nan, math.inf, -math.inf, 1.001, -1.001])
def test_a_duty_outside_is_refused(duty):
    with pytest.raises(ValueError, match='duty'):
        codec.drive(0x80, 0, duty)


@pytest.mark.parametrize('seconds', [0.0, 0.04, 12.8, -0.1])
def test_a_timeout_that_is_none_is_refused(seconds):
    with pytest.raises(ValueError, match='timeout'):
        codec.set_timeout(0x80, seconds)


def controllers(channels=4):
    return Controllers(Coils(FULL_SCALE_A, None, io.StringIO(), channels=channels))


@given(st.integers(0, 3), st.floats(-1, 1))
def test_a_device_takes_what_was_meant(channel, duty):
    device = controllers()
    assert device.receive(0, codec.drive(0x80 + channel // 2, channel % 2, duty), 0.0) == b''
    wanted = np.zeros(4)
    wanted[channel] = duty * FULL_SCALE_A
    np.testing.assert_allclose(device.coils.currents_A, wanted, atol=FULL_SCALE_A / 254)


@given(st.binary(max_size=12), st.integers(0, 31))
def test_a_packet_is_whole_and_right_or_none(before, bit):
    packet = codec.drive(0x80, 0, 0.5)
    damaged = bytearray(packet)
    damaged[bit // 8] ^= 1 << bit % 8
    device = controllers()
    device.receive(0, bytes(damaged), 0.0)
    assert not any(device.coils.currents_A)
    # Whatever was cut off before, an address begins anew.
    device = controllers()
    device.receive(0, bytes(b for b in before if b < 128) + codec.packet(0x81, 0, 5)[:2], 0.0)
    device.receive(0, packet, 0.0)
    assert device.coils.currents_A[0] == pytest.approx(FULL_SCALE_A / 2, abs=FULL_SCALE_A / 254)


# The driver ---------------------------------------------------------------------------------

class Line:
    """A port that keeps what is sent, and a clock that its bytes and the waits drive."""

    def __init__(self, monkeypatch):
        self.now_s, self.sent, self.discarded = 100.0, [], 0
        monkeypatch.setattr(SabertoothAmplifier, 'open_port', self.open)
        monkeypatch.setattr(SabertoothAmplifier, 'clock', self)

    def now(self):
        return self.now_s

    def open(self, url, baud):
        self.opened = (url, baud)
        return self

    descriptor = 7

    def send(self, data):
        self.sent.append((self.now_s, data))

    def discard_output(self):
        self.discarded += 1

    def close(self):
        self.opened = None

    def wait(self, event, seconds):
        self.now_s += max(seconds, 1e-6)
        return event.is_set()

    def wake(self):
        """Nothing waits in it."""

    def packets(self):
        """What was sent since it was asked last."""
        sent, self.sent = [data for _, data in self.sent], []
        return sent


@pytest.fixture
def line(monkeypatch):
    return Line(monkeypatch)


@pytest.fixture
def blind(line):
    """A driver of four channels that is connected, on that line and clock."""
    amplifier = SabertoothAmplifier('line', 2.0)
    amplifier.connect()
    amplifier.poll(1.0)
    line.sent.clear()
    return amplifier


def test_the_transcript_of_a_session(line):
    amplifier = SabertoothAmplifier('line', 2.0)
    amplifier.connect()
    assert line.opened == ('line', 9600)
    assert line.packets() == [b'\xaa' + ZEROS + bytes.fromhex('800e010f 810e0110')]
    line.now_s += 1.0
    amplifier.write([2.0, -1.0, 0.0, 0.5])
    amplifier.write(ZERO)
    line.now_s += 1.0
    amplifier.zero()
    assert line.packets() == [
        bytes.fromhex('800e010f 80007f7f 80054045 81000001 81042025'), ZEROS,
        # A zero that is said again comes with the timeout of the other controller.
        bytes.fromhex('810e0110') + ZEROS]
    assert amplifier.close() is Zero.SENT  # for nothing confirms it
    assert line.opened is None
    assert amplifier.counters.frames_sent == 5
    for use in (amplifier.zero, amplifier.poll, amplifier.last_words):
        with pytest.raises(NoAnswerError):
            use()
    assert amplifier.close() is Zero.UNREACHABLE


def test_only_the_newest_waits_for_a_slow_line(line, blind):
    began = line.now_s
    for duty in (0.1, 0.2, 0.3, 0.4):
        blind.write([2 * duty, 0.0, 0.0, 0.0])
    assert blind.poll(1.0) == []
    (first_s, first), (second_s, second) = line.sent
    assert codec.drive(0x80, 0, 0.1) in first
    assert codec.drive(0x80, 0, 0.4) in second
    # 20 bytes of ten bits at 9600 a second.
    assert (first_s, second_s) == (began, pytest.approx(began + 20 * 10 / 9600, abs=1e-4))
    assert blind.sample_s == pytest.approx(20 * 10 / 9600)
    assert line.now_s == pytest.approx(began + 1.0, abs=1e-3)


def test_the_next_goes_out_in_the_moment_in_which_the_line_is_free(line, blind):
    blind.write([0.1, 0.0, 0.0, 0.0])
    line.now_s = math.nextafter(blind._free_s, 0)
    blind.write([0.2, 0.0, 0.0, 0.0])
    assert len(line.sent) == 1
    line.now_s = blind._free_s
    blind.write([0.3, 0.0, 0.0, 0.0])
    assert len(line.sent) == 2


def test_zero_waits_for_nothing_and_nothing_comes_after_it(line, blind):
    blind.write([1.0, 0.0, 0.0, 0.0])
    blind.write([2.0, 0.0, 0.0, 0.0])
    line.packets()
    blind.write(ZERO)
    assert (line.discarded, line.packets()) == (1, [ZEROS])
    blind.poll(1.0)
    assert line.packets() == []


def test_a_poll_is_woken(line, blind):
    began = line.now_s
    blind.wake()
    assert blind.poll(1.0) == []
    assert line.now_s == began
    assert blind.poll(1.0) == []  # and the next one waits again
    assert line.now_s == pytest.approx(began + 1.0, abs=1e-3)


@pytest.mark.parametrize(('channels', 'timeout_s'), [(1, 0.1), (4, 0.1), (6, 0.1), (16, 0.2)])
def test_the_timeout_leaves_time_for_the_next_packet(line, channels, timeout_s):
    amplifier = SabertoothAmplifier('line', 2.0, channels)
    assert amplifier.timeout_s == pytest.approx(timeout_s)
    # The driver of the coils repeats itself after 40 ms, a tick of 5 ms late at most.
    assert amplifier.timeout_s > amplifier.sample_s + 0.04 + 0.005 + 0.02
    amplifier.connect()
    for address in range(0x80, 0x80 + -(-channels // 2)):
        assert codec.set_timeout(address, timeout_s) in line.sent[0][1]
    assert amplifier.last_words() == [(7, *amplifier._zeros())]


def test_more_channels_than_eight_controllers_have_are_refused():
    with pytest.raises(InputError, match='1 to 16 coils'):
        SabertoothAmplifier('line', 2.0, 17)


# With gate and driver of the coils ------------------------------------------------------------

@pytest.fixture
def device():
    return VirtualAmplifier('sabertooth')


@pytest.fixture
def make(device):
    """A function that makes a driver which drives the coils."""
    def start(**limits):
        rig = VirtualDriver(device, Limits(**{**vars(LIMITS), **limits}), self_check=False,
                            accept_no_feedback=True)
        rig.connect()
        rig.drive(DRIVING)
        return rig

    return start


def test_a_command_flows_and_ends_by_itself(make, device):
    rig = make(command_timeout_s=0.5)
    assert rig.until(lambda: rig.gate.fault).reason is Reason.STALE
    assert device.flows(ZERO)
    assert device.causes[-1] == 'command'
    assert rig.stop() is Zero.SENT  # nothing confirmed it


def test_it_is_armed_and_fed_for_as_long_as_a_command_holds(make, device):
    rig = make()
    assert device.coils.watchdog_s == pytest.approx(0.1)
    rig.turn(2.0)
    assert device.flows(DRIVING)
    assert 'watchdog' not in device.causes


def test_a_host_that_dies_leaves_it_to_the_timeout(make, device):
    rig = make()
    rig.driver.amplifier._release()
    died_s = device.clock.now_s
    device.clock.sleep(0.2)
    assert device.flows(ZERO)
    assert device.causes[-1] == 'watchdog'
    assert device.times[-1] - died_s <= 0.1 + 1e-5


def test_a_controller_that_lost_its_power_is_told_its_timeout_again(make, device):
    rig = make()
    device.device.reset()
    assert device.coils.watchdog_s is None
    rig.until(lambda: device.coils.watchdog_s == pytest.approx(0.1), 0.1)
    assert set(device.device._timeouts.values()) == {0, 1}
    rig.until(lambda: set(device.device._timeouts.values()) == {1}, 0.1)


def test_an_unplugged_line_is_noticed_and_comes_back_at_zero(make, device):
    rig = make()
    device.coils.feed = lambda: None  # no watchdog helps
    device.fault('unplug')
    assert rig.until(lambda: rig.gate.fault, 0.2).reason is Reason.LINE
    assert rig.driver.zero is Zero.UNREACHABLE
    device.mend()
    rig.until(lambda: device.flows(ZERO), 0.2)
    rig.until(lambda: rig.driver.connected)
    assert not rig.gate.armed


def test_a_connection_that_failed_at_its_first_message_sends_zeros_all_the_same(device):
    amplifier = device.amplifier()
    open_port = amplifier.open_port

    def open_port_that_fails_once(*arguments, **options):
        port = open_port(*arguments, **options)
        send = port.send

        def fail(_):
            port.send = send
            raise PortLostError(port.url, 'it takes no bytes')

        port.send = fail
        return port

    amplifier.open_port = open_port_that_fails_once
    with pytest.raises(PortLostError):
        amplifier.connect()
    assert any(ZEROS in data for _, data in device.lines[0].sent)


@pytest.mark.parametrize('after_s', [0.0, 0.01, 0.1])
def test_the_zero_of_closing_goes_out_at_once_whatever_waits_for_the_line(device, after_s):
    amplifier = device.amplifier()
    amplifier.connect()
    amplifier.poll(1.0)
    for currents in (DRIVING, ZERO):
        amplifier.write(currents)
    device.clock.sleep(after_s)
    before, began_s = len(device.lines[0].sent), device.clock.now_s
    assert amplifier.close() is Zero.SENT
    assert device.lines[0].sent[before:] == [(began_s, ZEROS)]


@pytest.mark.rig
def test_it_is_watched_by_a_process_as_nothing_says_that_its_timeout_is_armed(tmp_path):
    served = Served(tmp_path, 'sabertooth', watchdog_s=None)
    driver = CoilDriver(SabertoothAmplifier(served.url, FULL_SCALE_A), LIMITS, lambda _: None,
                        self_check=False, accept_no_feedback=True)
    driver.start()
    try:
        assert driver.amplifier.watchdog is Watchdog.UNCONFIRMED
        assert driver._last_resort is not None
        assert driver.warning.startswith('the amplifier measures no currents: an open')
    finally:
        driver.stop()
        served.end()


@pytest.mark.parametrize(('given', 'culprit'), [
    ({}, 'accept_no_feedback'), ({'accept_no_watchdog': True}, 'accept_no_feedback'),
    ({'self_check': False}, 'accept_no_feedback'),
    ({'accept_no_feedback': True}, 'self_check'),
    ({'accept_no_feedback': True, 'accept_no_watchdog': True}, 'self_check')])
def test_driving_blind_has_to_be_accepted(given, culprit):
    with pytest.raises(InputError, match='measures no currents') as refusal:
        CoilDriver(SabertoothAmplifier('line', FULL_SCALE_A), LIMITS, print, **given)
    assert refusal.value.source == culprit


@pytest.mark.parametrize(('parameters', 'level', 'said'), [
    ('', 'fail', 'it is driven only with coil_driver.accept_no_feedback: true'),
    (', accept_no_watchdog: true', 'fail', 'it is driven only with'),
    (', accept_no_feedback: true', 'warn', '; accepted'),
])
def test_the_doctor_says_what_it_means(monkeypatch, tmp_path, parameters, level, said):
    monkeypatch.setattr('microbot_ros.drive.amplifier.amplifier_class',
                        lambda _: SabertoothAmplifier)
    rig = tmp_path / 'rig.yaml'
    rig.write_text(f'coil_driver: {{ros__parameters: {{amplifier: sabertooth{parameters}}}}}\n')
    found = doctor._watchdog(rig)
    assert found.level == level
    assert found.detail.startswith('sabertooth measures no currents: an open')
    assert said in found.detail
