"""Every amplifier at the emulated device, on virtual time with its lines in memory."""

import math
from importlib.metadata import entry_points

import numpy as np
import pytest

from bench._emulator import MEASURED
from bench._virtual import VirtualAmplifier, VirtualClock
from microbot_ros.common.errors import InputError
from microbot_ros.common.patience import PATIENCE
from microbot_ros.drive.amplifier import (
    AGAIN_S,
    Amplifier,
    Command,
    Swing,
    Watchdog,
    Zero,
    amplifier_class,
)
from microbot_ros.drive.errors import (
    AmplifierError,
    NoAnswerError,
    PortBusyError,
    UnreachableError,
    WrongDeviceError,
)

FULL_SCALE_A = 2.0
ZERO = (0.0,) * 4
DRIVING = (1.0, -1.0, 0.5, 0.2)
WITHOUT_WATCHDOG = ('modbus', 'scpi')
POLLED = sorted({*MEASURED} - {'serial_transfer'})

every_protocol = pytest.mark.parametrize('protocol', MEASURED)
polled_protocols = pytest.mark.parametrize('protocol', POLLED)


@pytest.fixture
def device(protocol):
    return VirtualAmplifier(protocol)


@pytest.fixture
def amplifier(device):
    return device.amplifier()


def read(amplifier, wanted=lambda _: True, within_s=2.0):
    """The first reading that is wanted."""
    until_s = amplifier.clock.now() + within_s
    while amplifier.clock.now() < until_s:
        for reading in amplifier.poll(0.05):
            if wanted(reading):
                return reading
    pytest.fail('the reading never came')


def at(currents):
    return lambda reading: reading.currents_A == pytest.approx(currents, abs=0.06)


def drive(amplifier, device, currents=DRIVING):
    amplifier.connect()
    command = amplifier.write(currents)
    read(amplifier, at(currents))
    assert device.flows(currents)
    return command


def keep(device):
    """From now on no watchdog of the device ends what flows."""
    device.coils.watchdog_s, device.coils._deadline_s = None, math.inf


def given_back(device):
    return not any(line.host for line in device.lines)


def urls(protocol):
    return VirtualAmplifier(protocol).url


def test_each_has_an_emulator():
    registered = {entry.name for entry in entry_points(group='microbot_ros.amplifiers')}
    assert {name for name in registered if amplifier_class(name).reads_back} == {*MEASURED}


def test_an_amplifier_that_nobody_registered_is_refused():
    with pytest.raises(InputError, match=r'expected one of .*modbus'):
        amplifier_class('steam')


# Connecting ---------------------------------------------------------------------------------

@every_protocol
def test_connecting_moves_no_current(amplifier, device):
    amplifier.connect()
    assert read(amplifier)
    assert {*device.flowed} == {ZERO}
    assert amplifier.unreachable == ()


@pytest.mark.parametrize(('protocol', 'baud', 'xon_xoff'), [
    ('scpi', 9_600, True), ('roboteq', 115_200, False), ('roboclaw', 115_200, False),
    ('modbus', 1_000_000, False), ('serial_transfer', 500_000, False),
    ('sabertooth', 9_600, False)])
def test_the_ports_are_opened_as_the_protocol_asks(amplifier, device, baud, xon_xoff):
    amplifier.connect()
    assert device.opened == [(url, baud, xon_xoff) for url in device.urls]


@every_protocol
def test_connecting_ends_what_flows(amplifier, device):
    device.energise(DRIVING)
    amplifier.fault = 'of before'
    amplifier.connect()
    assert device.flows(ZERO)
    assert amplifier.fault == ''


@every_protocol
def test_connecting_again_ends_what_flows(amplifier, device):
    drive(amplifier, device)
    keep(device)
    amplifier.connect()
    assert device.flows(ZERO)
    assert len(amplifier._lines) == len(device.lines)


@every_protocol
def test_two_drivers_on_one_port_is_an_error(amplifier, device):
    amplifier.connect()
    with pytest.raises(PortBusyError):
        device.amplifier().connect()
    assert amplifier.close() is Zero.CONFIRMED
    device.amplifier().connect()


@pytest.mark.parametrize('protocol', [*MEASURED, 'sabertooth'])
@pytest.mark.parametrize('sent', range(12))
def test_a_line_that_takes_nothing_while_connecting_is_named(amplifier, device, sent):
    """Whichever message it is that no longer goes out; the first one was an AttributeError."""
    line, taken = device.lines[0], []
    take = line.take

    def counted(data):
        taken.append(data)
        take(data)
        line.takes = len(taken) < sent

    line.take, line.takes = counted, sent > 0
    lost = None
    try:
        amplifier.connect()
    except UnreachableError as error:
        lost = error
    if lost is None:
        assert len(taken) <= sent  # it needed no more
        return
    assert device.urls[0] in lost.url
    assert len(taken) == sent
    assert not amplifier._lines


@every_protocol
def test_silence_is_named_and_the_port_given_back(amplifier, device):
    device.fault('silence')
    with pytest.raises(NoAnswerError, match='no answer'):
        amplifier.connect()
    assert given_back(device)
    assert device.flows(ZERO)
    device.mend()
    amplifier.connect()


@every_protocol
def test_another_model_is_refused(amplifier, device):
    device.fault('wrong_reply')
    with pytest.raises((WrongDeviceError, NoAnswerError)):
        amplifier.connect()
    assert device.flows(ZERO)


# Currents -----------------------------------------------------------------------------------

@every_protocol
def test_each_coil_gets_its_own_current(amplifier, device):
    amplifier.connect()
    for currents in ((2.0, 0, 0, 0), (0, -2.0, 0, 0), (0, 0, 1.0, 0), (0, 0, 0, -0.2), DRIVING,
                     (-1.0, 1.0, -2.0, 2.0), ZERO):
        command = amplifier.write(currents, 'tag')
        reading = read(amplifier, lambda reading, own=command: reading.acknowledges is own)
        assert device.flows(currents)
        assert at(currents)(reading)
        assert (command.tag, command.t_monotonic_s <= reading.t_monotonic_s) == ('tag', True)


@every_protocol
def test_reading_never_moves_current(amplifier, device):
    drive(amplifier, device)
    keep(device)
    before = device.flowed.copy()
    for _ in range(4):
        assert np.isfinite(read(amplifier).currents_A).all()
    assert device.flowed == before


@every_protocol
def test_a_current_outside_is_refused_before_any_byte(amplifier, device):
    amplifier.connect()
    sent = [len(line.sent) for line in device.lines]
    for value in (math.nan, math.inf, -math.inf, math.nextafter(2.0, 3), -5.0):
        for coil in range(4):
            currents = list(DRIVING)
            currents[coil] = value
            with pytest.raises(ValueError, match='within'):
                amplifier.write(currents)
    for shape in ([], [0.0] * 3, [0.0] * 5, [[0.0] * 4]):
        with pytest.raises(ValueError, match='4 values'):
            amplifier.write(shape)
    assert [len(line.sent) for line in device.lines] == sent


@pytest.mark.parametrize('protocol', [*MEASURED, 'sabertooth'])
def test_full_scale_is_of_each_coil(protocol):
    amplifier = amplifier_class(protocol)(urls(protocol), [1.0, 2.0, 1.0, 2.0])
    assert amplifier.fault == ''
    for currents in ((1.1, 0, 0, 0), (0, 0, -1.1, 0), (0, 2.1, 0, 0), (math.nan, 0, 0, 0),
                     (0, 0, 0, math.inf), (0, 0, 0), [ZERO]):
        with pytest.raises(ValueError, match='4 values within'):
            amplifier.write(currents)


@every_protocol
@pytest.mark.parametrize('full_scale_A', [0.0, -1.0, math.nan, math.inf, [1.0, 0.0, 1.0, 1.0]])
def test_a_full_scale_that_is_none_is_refused(protocol, full_scale_A):
    with pytest.raises(InputError, match='amperes above 0'):
        amplifier_class(protocol)('a,b,c,d', full_scale_A)


@every_protocol
def test_a_small_full_scale_is_driven_to_its_end(protocol):
    device = VirtualAmplifier(protocol, full_scale_A=0.5)
    amplifier = device.amplifier()
    amplifier.connect()
    amplifier.write([0.5, -0.5, 0.25, 0.0])
    for _ in range(5):
        amplifier.poll(0.05)
    assert device.coils.currents_A == pytest.approx([0.5, -0.5, 0.25, 0.0], abs=0.01)


def test_a_swing_is_within_full_scale_on_all_of_its_way():
    device = VirtualAmplifier('serial_transfer')
    amplifier = device.amplifier()
    amplifier.connect()
    cosine, sine = np.array([1.2, 0, 0, 0]), np.array([0, 0, 0, -1.2])
    with pytest.raises(ValueError, match='within'):
        amplifier.write(1.7 * cosine, swing=Swing(np.zeros(4), 1.7 * cosine, sine, 1.0))
    assert device.flows(ZERO)
    amplifier.write(cosine, swing=Swing(np.zeros(4), cosine, sine, 10.0))
    keep(device)
    assert device.flows(cosine)
    np.testing.assert_allclose(Swing(cosine, sine, cosine, 1.0).largest, [2.4, 0, 0, 1.2])


@polled_protocols
def test_only_a_board_turns_currents_by_itself(protocol):
    driver = amplifier_class(protocol)
    assert not driver.can_swing
    assert not driver.swings


@polled_protocols
@pytest.mark.parametrize('ports', ['a,b,c', 'a,b,c,d,e', ''])
def test_the_number_of_ports_is_checked(protocol, ports):
    if ports.count(',') != urls(protocol).count(','):
        with pytest.raises(InputError, match='serial ports'):
            amplifier_class(protocol)(ports, FULL_SCALE_A)


@pytest.mark.parametrize('protocol', ['serial_transfer'])
@pytest.mark.parametrize('sign', [1, -1])
def test_a_reading_far_beyond_full_scale_is_damage(amplifier, device, sign):
    """One packet in 256 that is damaged passes a CRC of 8 bits."""
    amplifier.connect()
    keep(device)
    device.coils.command([sign * 4.1, 0, 0, 0], feeds=False)
    errors = amplifier.counters.crc_errors
    assert amplifier.poll(0.1) == []
    assert amplifier.counters.crc_errors > errors
    device.coils.command([sign * 3.9, 0, 0, 0], feeds=False)
    read(amplifier, lambda reading: abs(reading.currents_A[0]) > 3.0)


@every_protocol
def test_readings_acknowledge_the_oldest_command_they_agree_with(protocol):
    amplifier = amplifier_class(protocol)(urls(protocol), FULL_SCALE_A)
    sent = [_command(currents) for currents in
            ([1.0, 0, 0, 0], [0, 1.0, 0, 0], [1.0, 0, 0, 0], [0, 0, 1.0, 0])]
    amplifier._unacknowledged.extend(sent)
    tolerance_A = float(amplifier._tolerance_A[0])
    assert tolerance_A == pytest.approx(0.02 * FULL_SCALE_A + amplifier.resolution_A / 2)
    assert tolerance_A < 0.05 * FULL_SCALE_A

    def acknowledged(*currents):
        return amplifier._reading(2.0, 1.0, np.array(currents)).acknowledges

    assert acknowledged(0, 0, 0, 0) is None
    assert acknowledged(1.0 + 1.01 * tolerance_A, 0, 0, 0) is None
    assert acknowledged(0, 1.0 - 0.99 * tolerance_A, 0, 0) is sent[1]
    assert acknowledged(1.0, 0, 0, 0) is sent[2]
    assert acknowledged(1.0, 0, 0, 0) is None
    reading = amplifier._reading(2.0, 1.0, np.array([0, 0, 1.0, 0.0]))
    assert (reading.acknowledges, reading.t_monotonic_s, reading.since_s) == (sent[3], 2.0, 1.0)
    assert not amplifier._unacknowledged


def _command(currents):
    return Command(0.0, np.array(currents, float))


# Ending -------------------------------------------------------------------------------------

@every_protocol
def test_closing_zeroes_and_reads_back(amplifier, device):
    drive(amplifier, device)
    began_s = device.clock.now_s
    assert amplifier.close() is Zero.CONFIRMED
    assert device.flowed[-1] == ZERO
    assert device.times[-1] - began_s <= (amplifier.gap_s if device.protocol in POLLED else 0.02)
    assert given_back(device)
    assert amplifier.unreachable == ()
    for use in (amplifier.poll, amplifier.zero, amplifier.last_words):
        with pytest.raises(NoAnswerError, match='a connection'):
            use()
    assert amplifier.close() is Zero.UNREACHABLE
    assert amplifier.unreachable == amplifier.urls
    amplifier.connect()


@every_protocol
def test_a_zero_that_nothing_confirms_is_none(amplifier, device):
    drive(amplifier, device)
    keep(device)
    device.coils._settle = lambda _: None  # the stages are fused: currents stay
    began_s = device.clock.now_s
    assert amplifier.close() is Zero.SENT
    assert PATIENCE.read_back_s <= device.clock.now_s - began_s <= PATIENCE.read_back_s + 0.1
    with pytest.raises(NoAnswerError, match='measured currents of zero'):
        amplifier.connect()
    assert given_back(device)


@pytest.mark.parametrize('coil', [0, 1, 2, 3])
@pytest.mark.parametrize('sign', [1, -1])
@every_protocol
def test_one_coil_that_stays_on_is_not_zero(amplifier, device, coil, sign):
    """By a hundredth of an ampere beyond the tolerance, or short of it."""
    amplifier.connect()
    keep(device)
    device.coils._settle = lambda _: None
    device.coils.currents_A = tuple(
        sign * (float(amplifier._tolerance_A[k]) + 0.06) if k == coil else 0.0 for k in range(4))
    assert not amplifier.shows_zero(np.array(device.coils.currents_A))
    assert amplifier.close() is Zero.SENT
    device.coils.currents_A = tuple(
        sign * 0.9 * 0.02 * FULL_SCALE_A if k == coil else 0.0 for k in range(4))
    amplifier.connect()
    assert amplifier.close() is Zero.CONFIRMED


@every_protocol
@pytest.mark.parametrize('wrong', [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_is_no_zero(amplifier, wrong):
    for coil in range(4):
        currents = np.zeros(4)
        currents[coil] = wrong
        assert not amplifier.shows_zero(currents)
    assert amplifier.shows_zero(np.zeros(4))


@every_protocol
def test_an_answer_that_comes_too_late_hides_no_zero(amplifier, device):
    drive(amplifier, device)
    device.fault('delay=25+0.05')
    amplifier.poll(0.02)  # something is asked, whose answer comes when others are waited for
    assert amplifier.close() is Zero.CONFIRMED
    assert device.flows(ZERO)


@every_protocol
def test_a_host_that_dies_leaves_it_to_the_watchdog(amplifier, device):
    drive(amplifier, device)
    last_s = max(at_s for line in device.lines for at_s, _ in line.sent)
    amplifier._release()
    device.clock.sleep(0.3)
    if amplifier.watchdog is Watchdog.NONE:
        assert amplifier_class(device.protocol).watchdog is Watchdog.NONE
        assert device.flows(DRIVING)
    else:
        assert device.flows(ZERO)
        assert device.causes[-1] == 'watchdog'
        assert device.times[-1] - last_s <= 0.1 + 2e-6


def test_the_watchdogs_that_there_are():
    assert {protocol for protocol in MEASURED
            if amplifier_class(protocol).watchdog is Watchdog.NONE} == {*WITHOUT_WATCHDOG}


@polled_protocols
def test_the_words_that_zero_the_lines_zero_all_coils(amplifier, device):
    drive(amplifier, device)
    keep(device)
    for line, words in zip(device.lines, amplifier._zeros(), strict=True):
        line.take(words)
    device.clock.sleep(0.02)
    assert device.flows(ZERO)
    assert device.causes[-1] == 'command'


@pytest.mark.parametrize(('url', 'watchable'), [
    ('/dev/ttyACM0', True), ('/dev/serial/by-id/usb-a', True), ('socket://host:1', True),
    ('hwgrep://usb', True), ('rfc2217://host:1', False), ('loop://', False),
    ('cp2110://a', False)])
def test_a_sentinel_can_hold_the_lines_only_if_each_has_a_descriptor(url, watchable):
    assert amplifier_class('modbus')(url, FULL_SCALE_A).watchable is watchable
    for number in range(4):
        ports = ['/dev/ttyUSB0'] * 4
        ports[number] = url
        assert amplifier_class('scpi')(','.join(ports), FULL_SCALE_A).watchable is watchable


@pytest.mark.parametrize('protocol', ['modbus', 'scpi'])
def test_closing_switches_the_outputs_off(amplifier, device):
    drive(amplifier, device)
    amplifier.close()
    enabled = getattr(device.device, '_enabled', None)
    assert not any(enabled or [values[0] for values in device.device._values.values()])


# Waiting ------------------------------------------------------------------------------------

@every_protocol
def test_a_waiting_poll_can_be_woken(amplifier, device):
    amplifier.wake()  # whatever state it is in
    drive(amplifier, device)
    device.fault('silence')
    amplifier.reply_s = 60.0
    amplifier.poll(0.1)
    began_s = device.clock.now_s
    device.clock.plan(0.01, amplifier.wake)
    assert amplifier.poll(5.0) == []
    assert device.clock.now_s == pytest.approx(began_s + 0.01)


@every_protocol
@pytest.mark.parametrize('timeout_s', [0.0, 0.003, 0.05])
def test_a_poll_returns_in_its_time(amplifier, device, timeout_s):
    drive(amplifier, device)
    device.fault('silence')
    amplifier.reply_s = 60.0
    amplifier.poll(0.1)
    began_s = device.clock.now_s
    assert amplifier.poll(timeout_s) == []
    assert device.clock.now_s == pytest.approx(began_s + timeout_s)


# Devices that answer only when asked --------------------------------------------------------

@polled_protocols
def test_a_zero_goes_ahead_of_an_answer_that_stays_away(amplifier, device):
    drive(amplifier, device)
    keep(device)
    device.fault('silence')
    amplifier.reply_s = 60.0
    amplifier.poll(0.1)  # it waits for an answer now
    began_s = device.clock.now_s
    amplifier.zero()
    assert device.flows(ZERO)
    assert device.times[-1] - began_s == pytest.approx(amplifier.gap_s)
    device.mend()
    amplifier.reply_s = 0.3
    assert at(ZERO)(read(amplifier, at(ZERO)))
    drive_on = amplifier.write(DRIVING)
    read(amplifier, lambda reading: reading.acknowledges is drive_on)
    assert device.flows(DRIVING)


@polled_protocols
def test_a_zero_is_said_again_and_made_sure_of(amplifier, device):
    drive(amplifier, device)
    keep(device)
    receive, deaf = device.device.receive, []

    def hear(port, data, now_s):
        if len(deaf) < device.device.ports:  # the first on each line is lost on the way
            deaf.append(data)
            return b''
        return receive(port, data, now_s)

    device.device.receive = hear
    amplifier.zero()
    assert device.flows(DRIVING)
    read(amplifier, at(ZERO))
    assert device.flows(ZERO)


@every_protocol
@pytest.mark.parametrize('lost', [1, 2])
def test_a_zero_that_is_lost_while_closing_is_sent_again(amplifier, device, lost):
    drive(amplifier, device)
    keep(device)
    receive, deaf = device.device.receive, [0] * device.device.ports

    def hear(port, data, now_s):
        deaf[port] += 1
        return b'' if deaf[port] <= lost else receive(port, data, now_s)

    device.device.receive = hear
    assert amplifier.close() is Zero.CONFIRMED
    assert device.flows(ZERO)


@pytest.mark.parametrize('protocol', ['serial_transfer'])
def test_a_zero_that_no_reading_shows_is_sent_again_and_one_that_is_shown_is_not(
        amplifier, device):
    drive(amplifier, device)
    keep(device)
    line = device.lines[0]
    receive = device.device.receive
    device.device.receive = lambda *_: b''
    began_s = device.clock.now_s
    amplifier.zero()
    device.clock.plan(0.045, lambda: setattr(device.device, 'receive', receive))
    before = len(line.sent)
    while not device.flows(ZERO):
        amplifier.poll(0.001)
    said_s = [at_s - began_s for at_s, data in line.sent[before:]]
    assert said_s == pytest.approx([0.01, 0.02, 0.03, 0.04, 0.05], abs=0.005)
    assert device.flowed[-1] == ZERO
    before = len(line.sent)
    amplifier.poll(0.3)
    amplifier.zero()
    amplifier.poll(0.3)
    assert len(line.sent) == before + 1


@polled_protocols
def test_a_zero_that_is_written_takes_the_place_of_a_command_that_waits(amplifier, device):
    drive(amplifier, device, ZERO)
    amplifier.poll(0.3)
    before = len(device.flowed)
    amplifier.write(DRIVING)
    amplifier.zero()
    amplifier.poll(0.3)
    assert device.flowed[before:] == []


@polled_protocols
def test_a_command_that_waited_when_the_device_fell_silent_is_forgotten(amplifier, device):
    drive(amplifier, device, ZERO)
    device.fault('silence')
    amplifier.poll(amplifier.period_s + 0.001)  # it waits for an answer now
    amplifier.write(DRIVING)
    with pytest.raises(NoAnswerError):
        read(amplifier, lambda _: False)
    device.mend()
    before = len(device.flowed)
    for _ in range(20):
        amplifier.poll(0.05)
    assert device.flowed[before:] == []
    assert device.flows(ZERO)


@polled_protocols
def test_the_newest_command_takes_the_place_of_one_that_waits(amplifier, device):
    drive(amplifier, device)
    before = len(device.flowed)
    for share in range(1, 21):
        amplifier.write([share / 20, 0.0, 0.0, 0.0])
    read(amplifier, at([1.0, 0, 0, 0]))
    assert all(flowed[0] == pytest.approx(1.0, abs=0.02) for flowed in device.flowed[before:])


@polled_protocols
def test_readings_tell_since_when_the_device_had_what_it_had(amplifier, device):
    first = drive(amplifier, device)
    assert read(amplifier).since_s == first.t_monotonic_s
    second = amplifier.write([0.5, 0, 0, 0])
    reading = read(amplifier, at([0.5, 0, 0, 0]))
    assert reading.since_s == second.t_monotonic_s <= reading.t_monotonic_s


@polled_protocols
def test_what_gets_lost_is_asked_for_once_more(amplifier, device):
    drive(amplifier, device)
    device.fault(f'silence+{amplifier.reply_s / 2}')
    for _ in range(5):
        read(amplifier)
    device.fault('silence')
    with pytest.raises(NoAnswerError, match='no answer'):
        read(amplifier, lambda _: False)


@polled_protocols
@pytest.mark.parametrize('fault', ['drop=0.02', 'flip=0.02', 'double=0.02', 'truncate=0.05'])
def test_a_line_that_damages_bytes_ends_in_a_confirmed_zero_or_an_error(protocol, fault):
    for seed in range(20):
        device = VirtualAmplifier(protocol)
        device.faults._random.seed(seed)
        amplifier = device.amplifier()
        drive(amplifier, device)
        keep(device)
        device.fault(fault)
        try:
            for _ in range(20):
                amplifier.write(DRIVING)
                amplifier.poll(0.02)
        except AmplifierError:
            pass
        zero = amplifier.close()
        assert zero is not Zero.CONFIRMED or device.flows(ZERO)


@polled_protocols
def test_a_device_that_is_too_hot_says_so_until_it_cools(amplifier, device):
    amplifier.connect()
    assert amplifier.fault == ''
    device.fault('over_temperature')
    read(amplifier, lambda _: amplifier.fault)
    assert any(word in amplifier.fault for word in ('hot', 'heat', 'temperature'))
    amplifier.close()
    amplifier.connect()
    assert amplifier.fault
    device.mend()
    read(amplifier, lambda _: not amplifier.fault)


@polled_protocols
def test_an_answer_comes_in_the_patience_of_the_gate(protocol):
    driver = amplifier_class(protocol)
    assert driver.period_s + driver.reply_s <= 0.2  # `feedback_timeout_ms`, unless it is set


# Which reading shows a zero ------------------------------------------------------------------

AGE_S = 0.025


class Told(Amplifier):
    """An amplifier whose readings the test states: how long after the zero each was `since_s`."""

    report_age_s = AGE_S

    def __init__(self):
        super().__init__('told', FULL_SCALE_A)
        self.clock = VirtualClock()
        self.sent, self.arriving = [], []

    def _open(self):
        raise NotImplementedError

    def _send(self, command):
        self.sent.append(command)

    def _receive(self, timeout_s):
        if not self.arriving:
            self.clock.sleep(timeout_s)
            return []
        since_s, currents = self.arriving.pop(0)
        self.clock.sleep(0.001)
        return [(self.clock.now(), since_s, np.array(currents))]

    def _zeros(self):
        return []


@pytest.mark.parametrize(('after_s', 'currents', 'again'), [
    (AGE_S, ZERO, False), (2 * AGE_S, ZERO, False),
    (0.999 * AGE_S, ZERO, True), (0.0, ZERO, True), (-1.0, ZERO, True),
    (2 * AGE_S, DRIVING, True), (2 * AGE_S, (math.nan, 0.0, 0.0, 0.0), True),
])
def test_a_zero_is_sent_again_until_a_reading_of_after_it_shows_it(after_s, currents, again):
    amplifier = Told()
    amplifier.zero()  # one of before shows nothing of the next
    amplifier.arriving = [(amplifier.clock.now() + AGE_S, ZERO)]
    amplifier.poll()
    amplifier.write(DRIVING)
    amplifier.clock.now_s = 1024.0  # so that the sums below are exact
    zero = amplifier.zero()
    amplifier.arriving = [(zero.t_monotonic_s + after_s, currents)]
    amplifier.clock.sleep(2 * AGAIN_S)
    sent = len(amplifier.sent)
    amplifier.poll()
    assert (len(amplifier.sent) > sent) == again


def test_what_waited_on_the_line_before_the_zero_confirms_none():
    amplifier = Told()
    now_s = amplifier.clock.now()
    # It arrives late, and nothing tells that it is old, but that the line was never empty.
    amplifier.arriving = [(now_s + 1.0 + k, ZERO) for k in range(10_000)]
    with pytest.raises(NoAnswerError, match='zero'):
        amplifier._await(amplifier.zero())
    amplifier.arriving = []
    zero = amplifier.zero()
    amplifier.clock.plan(2 * AGE_S, lambda: amplifier.arriving.extend(
        [(amplifier.clock.now_s, ZERO)]))
    amplifier._await(zero)
    assert amplifier.clock.now() - zero.t_monotonic_s < 2 * AGE_S + 2 * AGAIN_S
