"""One line or device of several that is lost or silent keeps no zero from the others."""

import numpy as np
import pytest

from bench._virtual import VirtualAmplifier
from microbot_ros.common.patience import PATIENCE
from microbot_ros.drive.amplifier import Zero
from microbot_ros.drive.errors import (
    AmplifierError,
    NoAnswerError,
    PortLostError,
    PortMissingError,
    WrongDeviceError,
)

DRIVING = (1.0, -1.0, 0.5, 0.7)
ZERO = (0.0,) * 4
SOON_S = 0.2
"""How soon no coil that can be reached may carry current."""

LINES = [('scpi', line, kind) for line in (1, 2, 3, 4) for kind in ('unplug', 'silence')] + [
    ('roboteq', line, kind) for line in (1, 2) for kind in ('unplug', 'silence')]
ADDRESSES = [('modbus', slave, 'mute') for slave in (1, 2, 3, 4)] + [
    ('roboclaw', address, 'mute') for address in (0x80, 0x81)]

each_line = pytest.mark.parametrize(('protocol', 'number', 'kind'), LINES)
each = pytest.mark.parametrize(('protocol', 'number', 'kind'), LINES + ADDRESSES)


class Rig(VirtualAmplifier):
    """An emulated amplifier of which a line or a device fails, by its number."""

    def __init__(self, protocol, number, kind):
        super().__init__(protocol)
        self.coils.feed = lambda: None  # no watchdog helps
        self.number, self.kind = number, kind

    def fail(self):
        if self.kind == 'mute':
            self.mute(self.number)
        else:
            self.fault(f'{self.kind}/{self.number}')

    @property
    def away(self):
        """The coils that cannot be reached."""
        if self.kind != 'unplug':
            return []
        per_line = self.coils.channels // len(self.lines)
        return [coil for coil in range(4) if coil // per_line == self.number - 1]

    @property
    def others(self):
        """The currents of all coils that can be reached."""
        return np.delete(self.coils.currents_A, self.away)

    def check_answer(self, amplifier, zero):
        if self.kind == 'unplug':
            assert (zero, amplifier.unreachable) == (
                Zero.UNREACHABLE, (self.urls[self.number - 1],))
        else:
            assert (zero, amplifier.unreachable) == (Zero.SENT, ())
        assert not self.enabled()

    def enabled(self):
        """Whether an output that can be reached is switched on."""
        if self.protocol == 'scpi':
            return bool(np.delete(self.device._enabled, self.away).any())
        if self.protocol == 'modbus':
            return any(registers[0] for registers in self.device._values.values())
        return False


@pytest.fixture
def rig(protocol, number, kind):
    return Rig(protocol, number, kind)


def drive(rig):
    amplifier = rig.amplifier()
    amplifier.connect()
    command = amplifier.write(DRIVING)
    while not any(reading.acknowledges is command for reading in amplifier.poll(0.01)):
        pass
    assert rig.flows(DRIVING)
    return amplifier


def poll_until_lost(amplifier):
    with pytest.raises(AmplifierError) as error:  # noqa: PT012 — which poll sees it is chance
        while True:
            amplifier.poll(0.005)
    return error.value


@each
def test_at_the_first_connection(rig):
    rig.energise(DRIVING)
    rig.fail()
    amplifier = rig.amplifier()
    began_s = rig.clock.now_s
    with pytest.raises(PortMissingError if rig.away else NoAnswerError):
        amplifier.connect()
    assert not rig.others.any()
    assert not rig.enabled()
    assert not any(line.host for line in rig.lines)
    assert amplifier.unreachable == ((rig.urls[rig.number - 1],) if rig.away else ())
    assert rig.away == [] or rig.times[-1] - began_s <= SOON_S


@each
def test_while_driving(rig):
    amplifier = drive(rig)
    rig.fail()
    failed_s = rig.clock.now_s
    error = poll_until_lost(amplifier)
    assert not rig.others.any()  # before anybody is told
    silent_s = amplifier.period_s + 2 * amplifier.reply_s
    assert rig.clock.now_s - failed_s <= (SOON_S if rig.away else silent_s + 0.005)
    if rig.away:
        assert isinstance(error, PortLostError)
        assert error.url == rig.urls[rig.number - 1]
        assert amplifier.unreachable == (error.url,)
    rig.check_answer(amplifier, amplifier.close())
    assert not any(line.host for line in rig.lines)


@each_line
def test_while_a_zero_is_written(rig):
    amplifier = drive(rig)
    rig.fail()
    if rig.away:
        with pytest.raises(PortLostError):
            amplifier.zero()
    else:
        amplifier.zero()
    assert not rig.others.any()
    rig.check_answer(amplifier, amplifier.close())


@each
@pytest.mark.parametrize('after_s', [0.0, 1e-6, 0.029, 0.0301, 0.04])
def test_while_closing(rig, after_s):
    amplifier = drive(rig)
    rig.clock.plan(after_s, rig.fail)
    began_s = rig.clock.now_s
    zero = amplifier.close()
    assert not rig.others.any()
    assert rig.clock.now_s - began_s <= (0.04 if rig.away else PATIENCE.read_back_s + 0.25)
    assert not any(line.host for line in rig.lines)
    if after_s < 0.03:  # before the read-back
        rig.check_answer(amplifier, zero)


@each
def test_while_reconnecting(rig):
    amplifier = drive(rig)
    rig.fail()
    poll_until_lost(amplifier)
    amplifier.close()
    for _ in range(2):
        # Whoever did that, the next attempt ends it, without all devices being identified.
        for coil in set(range(4)) - set(rig.away):
            rig.coils.command({coil: 0.9})
        sent = [len(line.sent) for line in rig.lines]
        began_s = rig.clock.now_s
        with pytest.raises(PortMissingError if rig.away else NoAnswerError):
            amplifier.connect()
        assert not rig.others.any()
        assert not rig.enabled()
        assert amplifier.unreachable == ((rig.urls[rig.number - 1],) if rig.away else ())
        for line, before, zero in zip(rig.lines, sent, amplifier._zeros(), strict=True):
            if len(line.sent) > before:
                at_s, first = line.sent[before]
                assert first == zero
                assert at_s - began_s <= amplifier.gap_s
    assert amplifier.close() is Zero.UNREACHABLE


@each_line
def test_a_line_that_comes_back_is_zeroed_first(rig):
    amplifier = drive(rig)
    rig.fail()
    poll_until_lost(amplifier)
    amplifier.close()
    with pytest.raises(AmplifierError):
        amplifier.connect()
    rig.mend()
    began_s = rig.clock.now_s
    amplifier.connect()
    assert rig.flows(ZERO)
    assert rig.times[-1] - began_s <= SOON_S
    assert amplifier.unreachable == ()
    assert amplifier.close() is Zero.CONFIRMED


@pytest.mark.parametrize('protocol', ['scpi', 'roboteq'])
def test_another_device_on_one_line_gets_no_more_bytes_and_the_others_a_zero(protocol):
    count = 4 if protocol == 'scpi' else 2
    for number in range(1, count + 1):
        rig = Rig(protocol, number, 'wrong_reply')
        rig.energise(DRIVING)
        rig.fail()
        asked = [len(line.sent) for line in rig.lines]
        amplifier = rig.amplifier()
        with pytest.raises(WrongDeviceError):
            amplifier.connect()
        wrong = rig.lines[number - 1].sent[asked[number - 1]:]
        assert all(b'CURR' not in data and b'!G' not in data for _, data in wrong)
        per_line = 4 // count
        others = [abs(current) for coil, current in enumerate(rig.coils.currents_A)
                  if coil // per_line != number - 1]
        assert not any(others)
        assert amplifier.unreachable == (rig.urls[number - 1],)


def test_a_first_connection_identifies_what_is_there_though_a_line_is_away():
    rig = VirtualAmplifier('scpi')
    rig.energise(DRIVING)
    rig.fault('unplug/1')
    rig.fault('wrong_reply/2')
    before = len(rig.lines[1].sent)
    with pytest.raises(AmplifierError):
        rig.amplifier().connect()
    assert all(b'CURR' not in data for _, data in rig.lines[1].sent[before:])
    assert rig.coils.currents_A[2:] == (0.0, 0.0)


def test_an_attempt_to_reconnect_is_short_while_a_line_is_away():
    rig = Rig('scpi', 1, 'unplug')
    amplifier = drive(rig)
    rig.fail()
    rig.fault('silence/2')
    poll_until_lost(amplifier)
    amplifier.close()
    began_s = rig.clock.now_s
    with pytest.raises(PortMissingError, match='scpi-1'):
        amplifier.connect()
    # A line that comes back just after an attempt has begun waits for the next one.
    assert rig.clock.now_s - began_s <= 0.05


def test_all_lines_with_other_devices_are_named():
    rig = VirtualAmplifier('scpi')
    for number in (2, 3):
        rig.fault(f'wrong_reply/{number}')
    amplifier = rig.amplifier()
    with pytest.raises(WrongDeviceError, match='scpi-2'):
        amplifier.connect()
    assert amplifier.unreachable == ('scpi-2', 'scpi-3')


@pytest.mark.parametrize('number', [1, 2, 3, 4])
def test_no_supply_is_enabled_before_all_have_answered(number):
    rig = Rig('scpi', number, 'silence')
    rig.fail()
    with pytest.raises(NoAnswerError):
        rig.amplifier().connect()
    assert all(b'OUTP ON' not in data for line in rig.lines for _, data in line.sent)


@pytest.mark.parametrize('number', [1, 2, 3, 4])
def test_a_supply_that_falls_silent_once_it_is_enabled_is_switched_off_with_all_others(number):
    rig = Rig('scpi', number, 'silence')
    receive = rig.device.receive

    def fail_when_enabled(port, data, now_s):
        if b'OUTP ON' in data and port == number - 1:
            rig.fail()
        return receive(port, data, now_s)

    rig.device.receive = fail_when_enabled
    with pytest.raises(NoAnswerError):
        rig.amplifier().connect()
    assert not rig.enabled()
    assert all(any(b'OUTP OFF' in data for _, data in line.sent) for line in rig.lines)


def test_all_lines_that_are_lost_are_named():
    def lost(do):
        rig = Rig('scpi', 0, '')
        amplifier = drive(rig)
        for number in (2, 4):
            rig.fault(f'unplug/{number}')
        with pytest.raises(PortLostError):
            do(amplifier)
        assert amplifier.unreachable == ('scpi-2', 'scpi-4')
        assert amplifier.close() is Zero.UNREACHABLE
        with pytest.raises(PortMissingError):
            amplifier.connect()
        assert amplifier.unreachable == ('scpi-2', 'scpi-4')

    lost(lambda amplifier: amplifier.zero())
    lost(lambda amplifier: amplifier.poll(1.0))
    rig = Rig('scpi', 0, '')
    amplifier = drive(rig)
    for number in (1, 3):
        rig.fault(f'unplug/{number}')
    assert amplifier.close() is Zero.UNREACHABLE
    assert amplifier.unreachable == ('scpi-1', 'scpi-3')


def test_many_silent_devices_do_not_hold_up_the_end():
    rig = VirtualAmplifier('modbus', channels=16)
    amplifier = rig.amplifier()
    amplifier.connect()
    for slave in range(1, 17):
        rig.mute(slave)
    began_s = rig.clock.now_s
    assert amplifier.close() is Zero.SENT
    # The outputs are switched off one after the other, each with two attempts.
    longest_s = PATIENCE.read_back_s + 0.1 + 16 * 2 * amplifier.reply_s
    assert rig.clock.now_s - began_s <= longest_s


@pytest.mark.parametrize('protocol', ['scpi', 'roboteq'])
def test_whatever_a_line_fails_with_all_ports_are_given_back(protocol):
    rig = VirtualAmplifier(protocol)
    amplifier = rig.amplifier()
    amplifier.connect()

    def fail(*_):
        raise RuntimeError('broken')

    rig.lines[0].take = fail
    with pytest.raises(RuntimeError, match='broken'):
        amplifier.close()
    assert not any(line.host for line in rig.lines)
    assert not amplifier._lines


@pytest.mark.parametrize('protocol', ['serial_transfer', 'sabertooth', 'roboclaw', 'modbus'])
def test_the_only_line(protocol):
    rig = Rig(protocol, 1, 'unplug')
    amplifier = rig.amplifier()
    amplifier.connect()
    assert amplifier.close() is (Zero.CONFIRMED if amplifier.reads_back else Zero.SENT)
    amplifier.connect()
    rig.fail()
    assert poll_until_lost_or_written(amplifier) == rig.url
    assert amplifier.close() is Zero.UNREACHABLE
    assert amplifier.unreachable == (rig.url,)
    with pytest.raises(NoAnswerError):
        amplifier.write(ZERO)
    rig.mend()
    rig.coils.command(DRIVING)
    before, began_s = len(rig.lines[0].sent), rig.clock.now_s
    amplifier.connect()
    at_s, first = rig.lines[0].sent[before]
    assert at_s - began_s == pytest.approx(getattr(amplifier, 'gap_s', 0.0), abs=1e-9)
    assert amplifier._zeros()[0] in first
    assert rig.flows(ZERO)


def poll_until_lost_or_written(amplifier):
    with pytest.raises(PortLostError) as error:  # noqa: PT012 — which of both sees it is chance
        while True:
            amplifier.zero()
            amplifier.poll(0.005)
    return error.value.url


def test_a_silent_board_is_zeroed_though_it_cannot_be_identified():
    rig = Rig('serial_transfer', 1, 'silence')
    rig.energise(DRIVING)
    rig.fail()
    with pytest.raises(NoAnswerError):
        rig.amplifier().connect()
    assert rig.flows(ZERO)


@pytest.mark.parametrize('protocol', ['serial_transfer'])
def test_another_board_is_sent_nothing(protocol):
    rig = Rig(protocol, 1, 'wrong_reply')
    rig.fail()
    with pytest.raises(WrongDeviceError, match='six measured currents'):
        rig.amplifier().connect()
    assert rig.lines[0].sent == []
    assert rig.lines[0].host is None
