"""Every amplifier at the emulated device, quickly: `bench/_mutants.py` runs this often."""

import math
import threading
import time

import numpy as np
import pytest

from bench._served import FULL_SCALE_A, MEASURED, until
from microbot_ros.drive import polled, sentinel
from microbot_ros.drive.amplifier import Command, Watchdog, Zero, amplifier_class
from microbot_ros.drive.clock import Clock
from microbot_ros.drive.errors import (
    AmplifierError,
    NoAnswerError,
    PortBusyError,
    WrongDeviceError,
)
from microbot_ros.errors import InputError

pytestmark = pytest.mark.rig

ZERO = (0.0,) * 4

DRIVING = (1.0, -1.0, 0.5, 0.2)
PROTOCOLS = MEASURED
WITHOUT_WATCHDOG = ('modbus', 'scpi')

every_protocol = pytest.mark.parametrize('protocol', PROTOCOLS)
with_watchdogs = pytest.mark.parametrize('protocol', sorted({*PROTOCOLS} - {*WITHOUT_WATCHDOG}))
without_watchdogs = pytest.mark.parametrize('protocol', WITHOUT_WATCHDOG)


def read(amplifier, wanted=lambda _: True):
    """The first reading that is wanted."""
    return until(lambda: next((one for one in amplifier.poll(0.05) if wanted(one)), None))


def at(currents):
    return lambda reading: reading.currents_A == pytest.approx(currents, abs=0.06)


def drive_bare(amplifier, device, currents=DRIVING):
    amplifier.connect()
    command = amplifier.write(currents)
    read(amplifier, at(currents))
    device.eventually(currents)
    return command


@every_protocol
def test_connecting_ends_what_flows(amplifier, device):
    drive_bare(amplifier, device)
    device.coils.watchdog_s = None
    amplifier._release()  # as a host that dies
    device.coils.zero('reset')
    device.coils.command(DRIVING)
    amplifier.fault = 'of before'
    amplifier.connect()
    assert device.flows(ZERO)
    assert amplifier.fault == ''


@every_protocol
def test_each_coil_gets_its_own_current(amplifier, device):
    amplifier.connect()
    for currents in ((2.0, 0, 0, 0), (0, -2.0, 0, 0), (0, 0, 1.0, 0), (0, 0, 0, -0.2), DRIVING,
                     (-1.0, 1.0, -2.0, 2.0), ZERO):
        command = amplifier.write(currents, 'tag')
        reading = read(amplifier, lambda reading, own=command: reading.acknowledges is own)
        device.eventually(currents)
        assert at(currents)(reading)
        assert (command.tag, command.t_monotonic_s <= reading.t_monotonic_s) == ('tag', True)


@every_protocol
@pytest.mark.parametrize('full_scale_A', [[1.0, 2.0, 1.0, 2.0]])
def test_full_scale_is_of_each_coil(protocol, full_scale_A):
    urls = 'a,b,c,d' if protocol == 'scpi' else 'a,b' if protocol == 'roboteq' else 'a'
    amplifier = amplifier_class(protocol)(urls, full_scale_A)
    assert amplifier.fault == ''
    for currents in ((1.1, 0, 0, 0), (0, 0, -1.1, 0), (0, 2.1, 0, 0), (math.nan, 0, 0, 0),
                     (0, 0, 0, math.inf), (0, 0, 0), [ZERO]):
        with pytest.raises(ValueError, match='4 values within'):
            amplifier.write(currents)
    with pytest.raises(NoAnswerError):  # within, and not connected
        amplifier.write([1.0, -2.0, -1.0, 2.0])
    with pytest.raises(NoAnswerError):
        amplifier.poll()
    with pytest.raises(NoAnswerError):
        amplifier.last_words()
    assert amplifier.close() is Zero.UNREACHABLE


@every_protocol
@pytest.mark.parametrize('full_scale_A', [0.0, -1.0, math.nan, math.inf, [1.0, 0.0, 1.0, 1.0]])
def test_a_full_scale_that_is_none_is_refused(protocol, full_scale_A):
    with pytest.raises(InputError, match='amperes above 0'):
        amplifier_class(protocol)('a,b,c,d', full_scale_A)


@every_protocol
def test_closing_zeroes_reads_back_and_gives_the_port_back(amplifier, device):
    drive_bare(amplifier, device)
    assert amplifier.close() is Zero.CONFIRMED
    assert device.flowed[-1] == ZERO
    until(lambda: not any(line.present for line in device.lines))
    amplifier.connect()
    other = type(amplifier)(device.url, FULL_SCALE_A)
    with pytest.raises(PortBusyError):
        other.connect()
    assert amplifier.close() is Zero.CONFIRMED


@every_protocol
def test_a_zero_that_nothing_confirms_is_none(amplifier, device, monkeypatch):
    monkeypatch.setattr(amplifier, 'read_back_s', 0.1)
    drive_bare(amplifier, device)
    device.coils._settle = lambda _: None  # the stages are fused: currents stay
    assert amplifier.close() is Zero.SENT
    with pytest.raises(NoAnswerError, match='measured currents of zero'):
        amplifier.connect()
    until(lambda: not any(line.present for line in device.lines))


@pytest.mark.parametrize('coil', [0, 1, 2, 3])
@pytest.mark.parametrize('sign', [1, -1])
def test_one_coil_that_stays_on_is_not_zero(coil, sign):
    amplifier = amplifier_class('serial_transfer')('nowhere', FULL_SCALE_A)
    found = np.zeros(4)
    found[coil] = sign * (amplifier._tolerance_A[coil] + 1e-9)
    readings = iter([[(0.0, 0.0, found)]])
    amplifier._receive = lambda _: next(readings, None) or exhaust()

    def exhaust():
        raise AmplifierError('nothing more')
    with pytest.raises(AmplifierError, match='nothing more'):
        amplifier._await_zero()
    found[coil] = sign * (amplifier._tolerance_A[coil] - 1e-9)
    readings = iter([[(0.0, 0.0, found)]])
    amplifier._await_zero()


@every_protocol
def test_silence_is_named_and_the_port_given_back(amplifier, device):
    device.fault('silence')
    amplifier.reply_s = amplifier._boot_s = 0.03
    with pytest.raises(NoAnswerError, match='no answer'):
        amplifier.connect()
    until(lambda: not any(line.present for line in device.lines))
    assert device.flows(ZERO)
    device.mend()
    amplifier.reply_s, amplifier._boot_s = 0.3, 5.0
    amplifier.connect()


@every_protocol
def test_another_model_is_refused(amplifier, device):
    device.fault('wrong_reply')
    amplifier.reply_s, amplifier._boot_s = 0.1, 0.3
    with pytest.raises((WrongDeviceError, NoAnswerError)):
        amplifier.connect()
    assert device.flows(ZERO)


@every_protocol
def test_readings_acknowledge_the_oldest_command_they_agree_with(protocol):
    urls = 'a,b,c,d' if protocol == 'scpi' else 'a,b' if protocol == 'roboteq' else 'a'
    amplifier = amplifier_class(protocol)(urls, FULL_SCALE_A)
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


@every_protocol
def test_the_last_words_zero_all_coils(amplifier, device):
    drive_bare(amplifier, device)
    device.coils.watchdog_s, device.coils._deadline_s = None, math.inf
    sentinel.say(amplifier.last_words())
    device.eventually(ZERO)
    assert device.causes[-1] == 'command'


@every_protocol
def test_a_line_that_is_lost_is_an_error(amplifier, device):
    drive_bare(amplifier, device)
    device.fault('unplug')
    with pytest.raises(AmplifierError):  # noqa: PT012 — which of both sees it is chance
        while True:
            amplifier.write(DRIVING)
            amplifier.poll(0.05)
    assert amplifier.close() is Zero.UNREACHABLE
    with pytest.raises(NoAnswerError):
        amplifier.write(ZERO)


@every_protocol
def test_a_waiting_poll_can_be_woken(amplifier, device):
    amplifier.wake()  # whatever state it is in
    drive_bare(amplifier, device)
    device.fault('silence')
    amplifier.reply_s = 60.0
    until(lambda: not amplifier.poll(0.01))
    returned = threading.Event()

    def wake():
        while not returned.wait(0.05):
            amplifier.wake()

    waking = threading.Thread(target=wake)
    waking.start()
    begin = time.monotonic()
    amplifier.poll(5.0)
    waited_s = time.monotonic() - begin
    returned.set()
    waking.join()
    assert waited_s < 4.0


@every_protocol
def test_a_poll_returns_in_its_time(amplifier, device):
    drive_bare(amplifier, device)
    device.fault('silence')
    amplifier.reply_s = 60.0
    until(lambda: not amplifier.poll(0.01))
    begin = time.monotonic()
    assert amplifier.poll(0.05) == []
    assert 0.045 <= time.monotonic() - begin < 5.0


@pytest.mark.parametrize('protocol', ['serial_transfer'])
@pytest.mark.parametrize('sign', [1, -1])
def test_a_reading_far_beyond_full_scale_is_damage(amplifier, device, sign):
    """One packet in 256 that is damaged passes a CRC of 8 bits."""
    amplifier.connect()
    device.coils.command([sign * 4.1, 0, 0, 0])
    errors = amplifier.counters.crc_errors
    until(lambda: (amplifier.poll(0.01), amplifier.counters.crc_errors > errors)[1])
    device.coils.command([sign * 3.9, 0, 0, 0])
    read(amplifier, lambda reading: abs(reading.currents_A[0]) > 3.0)


# Devices that answer only when asked ------------------------------------------------------------

polled_protocols = pytest.mark.parametrize('protocol', sorted({*PROTOCOLS} - {'serial_transfer'}))


@polled_protocols
def test_a_zero_goes_ahead_of_an_answer_that_stays_away(amplifier, device):
    drive_bare(amplifier, device)
    device.coils.watchdog_s, device.coils._deadline_s = None, math.inf
    device.fault('silence')
    amplifier.reply_s = 60.0
    until(lambda: not amplifier.poll(0.01))  # it waits for an answer now
    amplifier.zero()
    device.eventually(ZERO)
    device.mend()
    amplifier.reply_s = 0.3
    assert at(ZERO)(read(amplifier, at(ZERO)))
    drive_on = amplifier.write(DRIVING)
    read(amplifier, lambda reading: reading.acknowledges is drive_on)
    device.eventually(DRIVING)


@pytest.mark.parametrize('protocol', ['modbus'])
def test_a_zero_comes_after_the_silence_that_ends_what_was_said(amplifier, device, monkeypatch):
    drive_bare(amplifier, device)
    done = []
    port = amplifier._lines[0]
    monkeypatch.setattr(Clock, 'sleep', lambda _, seconds: done.append(seconds))
    monkeypatch.setattr(port, 'send', done.append)
    amplifier.zero()
    assert done[:2] == [amplifier.gap_s, *amplifier._zeros()]
    assert amplifier.gap_s >= 0.00175  # above 19,200 Bd (Modbus over serial line, 2.5.1.1)


@polled_protocols
def test_a_zero_is_said_again_and_made_sure_of(amplifier, device):
    drive_bare(amplifier, device)
    device.coils.watchdog_s, device.coils._deadline_s = None, math.inf
    receive, deaf = device.device.receive, []

    def hear(port, data, now_s):
        if len(deaf) < device.device.ports:  # the first on each line is lost on the way
            deaf.append(data)
            return b''
        return receive(port, data, now_s)

    until(lambda: not amplifier.poll(0.0))
    device.device.receive = hear
    amplifier.zero()
    amplifier.reply_s = 0.05
    until(lambda: (amplifier.poll(0.01), device.flows(ZERO))[1])


@polled_protocols
def test_the_newest_command_takes_the_place_of_one_that_waits(amplifier, device):
    drive_bare(amplifier, device)
    before = len(device.flowed)
    for share in range(1, 21):
        amplifier.write([share / 20, 0.0, 0.0, 0.0])
    read(amplifier, at([1.0, 0, 0, 0]))
    assert all(flowed[0] == pytest.approx(1.0, abs=0.02) for flowed in device.flowed[before:])


@polled_protocols
def test_readings_tell_since_when_the_device_had_what_it_had(amplifier, device):
    first = drive_bare(amplifier, device)
    assert read(amplifier).since_s == first.t_monotonic_s
    second = amplifier.write([0.5, 0, 0, 0])
    reading = read(amplifier, at([0.5, 0, 0, 0]))
    assert reading.since_s == second.t_monotonic_s <= reading.t_monotonic_s


@polled_protocols
def test_what_gets_lost_is_asked_for_once_more(amplifier, device):
    drive_bare(amplifier, device)
    amplifier.reply_s = 0.4
    device.fault('silence+0.05')
    for _ in range(5):
        read(amplifier)
    amplifier.reply_s = 0.05
    device.fault('silence')
    with pytest.raises(NoAnswerError, match='no answer'):
        read(amplifier, lambda _: False)


@polled_protocols
def test_a_device_that_is_too_hot_says_so_until_it_cools(amplifier, device, monkeypatch):
    monkeypatch.setattr(polled, '_INSPECT_S', 0.02)
    amplifier.connect()
    assert amplifier.fault == ''
    device.fault('over_temperature')
    until(lambda: (amplifier.poll(0.01), amplifier.fault)[1])
    assert any(word in amplifier.fault for word in ('hot', 'heat', 'temperature'))
    amplifier.close()
    amplifier.connect()
    assert amplifier.fault
    device.mend()
    until(lambda: (amplifier.poll(0.01), not amplifier.fault)[1])


@polled_protocols
def test_an_answer_comes_in_the_patience_of_the_gate(protocol):
    driver = amplifier_class(protocol)
    assert driver.period_s + driver.reply_s <= 0.2  # `feedback_timeout_ms`, unless it is set


@polled_protocols
def test_the_number_of_ports_is_checked(protocol):
    for urls in ('a,b,c', 'a,b,c,d,e'):
        with pytest.raises(InputError, match='serial ports'):
            amplifier_class(protocol)(urls, FULL_SCALE_A)


@pytest.mark.parametrize('protocol', ['modbus', 'scpi'])
def test_closing_switches_the_outputs_off(amplifier, device):
    drive_bare(amplifier, device)
    amplifier.close()
    until(lambda: off(device))


def off(device):
    enabled = getattr(device.device, '_enabled', None)
    return not any(enabled or [values[0] for values in device.device._values.values()])


@with_watchdogs
def test_a_host_that_dies_leaves_it_to_the_watchdog(amplifier, device):
    drive_bare(amplifier, device)
    amplifier._release()
    device.eventually(ZERO)
    assert device.causes[-1] == 'watchdog'
    assert amplifier.watchdog is not Watchdog.NONE
