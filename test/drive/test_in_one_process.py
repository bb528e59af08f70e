"""Every way to zero, at real terminals, quickly: the emulated device is a thread of this process.

`bench/_mutants.py` breaks the drivers in hundreds of ways and runs this module against each.
"""

import json
import math
import os
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

from microbot_ros.drive import coil_driver, last_resort, polled, sentinel
from microbot_ros.drive.amplifier import Watchdog, amplifier_class
from microbot_ros.drive.coil_driver import CoilDriver
from microbot_ros.drive.emulator.coils import Coils
from microbot_ros.drive.emulator.faults import Faults, parse
from microbot_ros.drive.emulator.line import Line
from microbot_ros.drive.emulator.process import DEVICES, make_device
from microbot_ros.drive.emulator.server import Server
from microbot_ros.drive.errors import (
    AmplifierError,
    NoAnswerError,
    PortBusyError,
    WrongDeviceError,
)
from microbot_ros.drive.gate import ZERO, Limits, Reason
from microbot_ros.errors import InputError

FULL_SCALE_A = 2.0
LIMITS = Limits(
    current_A=FULL_SCALE_A, step_A=2 * FULL_SCALE_A, slew_A_per_s=1e4, stale_s=8.0,
    deviation_A=0.15, settling_s=0.1, silence_s=8.0, continuous_A=3.0, thermal_s=60.0, idle_s=60.0)
DRIVING = (1.0, -1.0, 0.5, 0.2)
DEADLINE_S = 10.0
PROTOCOLS = sorted(DEVICES)
WITHOUT_WATCHDOG = ('modbus', 'scpi')

every_protocol = pytest.mark.parametrize('protocol', PROTOCOLS)
with_watchdogs = pytest.mark.parametrize('protocol', sorted({*PROTOCOLS} - {*WITHOUT_WATCHDOG}))
without_watchdogs = pytest.mark.parametrize('protocol', WITHOUT_WATCHDOG)


def until(condition):
    """The first true value of the condition."""
    deadline = time.monotonic() + DEADLINE_S
    while time.monotonic() < deadline:
        if value := condition():
            return value
        time.sleep(0.001)
    raise AssertionError('the awaited condition never came true')


class Device:
    """An emulated amplifier, the log of what flowed in it, and its faults."""

    def __init__(self, protocol, folder, watchdog_s):
        self.flowed, self.causes = [], []
        self.coils = Coils(FULL_SCALE_A, watchdog_s, self)
        self.device = make_device(protocol, self.coils)
        self.received = [b''] * self.device.ports
        receive = self.device.receive

        def overheard(port, data, now_s):
            self.received[port] += data
            return receive(port, data, now_s)

        self.device.receive = overheard
        self.lines = [Line(folder / f'{protocol}-{port}') for port in range(self.device.ports)]
        self.url = ','.join(str(line.link) for line in self.lines)
        self.faults = Faults([])
        self.ending = threading.Event()
        server = Server(self.device, self.lines, self.faults, None)
        self.thread = threading.Thread(target=server.run, args=[self.ending.is_set])
        self.thread.start()

    def write(self, line):
        """As the log of the coils."""
        entry = json.loads(line)
        self.flowed.append(tuple(entry['currents_A']))
        self.causes.append(entry['cause'])

    def flush(self):
        """Nothing waits."""

    def fault(self, text):
        self.faults.add(parse(text, time.monotonic()))

    def mend(self):
        self.faults._faults.clear()

    def flows(self, currents):
        return self.flowed[-1] == pytest.approx(currents, abs=0.011 * FULL_SCALE_A)

    def eventually(self, currents):
        until(lambda: self.flows(currents))

    def end(self):
        self.ending.set()
        self.thread.join()
        for line in self.lines:
            line.unplug()


@pytest.fixture
def protocol():
    return 'serial_transfer'


@pytest.fixture
def watchdog_s():
    return 0.1


@pytest.fixture
def device(protocol, tmp_path, watchdog_s):
    device = Device(protocol, tmp_path, watchdog_s)
    yield device
    device.end()


@pytest.fixture
def amplifier(protocol, device):
    amplifier = amplifier_class(protocol)(device.url, FULL_SCALE_A)
    # A loaded machine is slower than a device.
    amplifier.reply_s = 0.3
    amplifier._boot_s = 5.0
    yield amplifier
    amplifier._release()


@pytest.fixture
def drivers(amplifier):
    """A function that starts a driver, in other limits if told; it ends with the test."""
    started = []

    def start(on_reading=lambda _: None, on_sent=lambda _: None, *, self_check=False,
              accept_no_watchdog=True, **limits):
        driver = CoilDriver(amplifier, Limits(**{**vars(LIMITS), **limits}), on_reading,
                            on_sent=on_sent, self_check=self_check,
                            accept_no_watchdog=accept_no_watchdog)
        driver.start()
        started.append(driver)
        return driver

    yield start
    for driver in started:
        driver.stop()


@pytest.fixture
def driver(drivers):
    return drivers()


def arm(driver):
    until(lambda: driver.arm() is None)


def drive(driver, device, currents=DRIVING):
    arm(driver)
    assert driver.command(currents)
    device.eventually(currents)


def tripped(driver, device, reason):
    """The fault, once it is there and the coils are at zero."""
    fault = until(lambda: driver.gate.fault)
    assert fault.reason is reason
    device.eventually(ZERO)
    assert not driver.gate.armed
    assert not driver.command(DRIVING)
    return fault


# The amplifiers by themselves ---------------------------------------------------------------


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
    assert amplifier.close() is False


@every_protocol
@pytest.mark.parametrize('full_scale_A', [0.0, -1.0, math.nan, math.inf, [1.0, 0.0, 1.0, 1.0]])
def test_a_full_scale_that_is_none_is_refused(protocol, full_scale_A):
    with pytest.raises(InputError, match='amperes above 0'):
        amplifier_class(protocol)('a,b,c,d', full_scale_A)


@every_protocol
def test_closing_zeroes_reads_back_and_gives_the_port_back(amplifier, device):
    drive_bare(amplifier, device)
    assert amplifier.close() is True
    assert device.flowed[-1] == ZERO
    until(lambda: not any(line.present for line in device.lines))
    amplifier.connect()
    other = type(amplifier)(device.url, FULL_SCALE_A)
    with pytest.raises(PortBusyError):
        other.connect()
    assert amplifier.close() is True


@every_protocol
def test_a_zero_that_nothing_confirms_is_none(amplifier, device, monkeypatch):
    monkeypatch.setattr('microbot_ros.drive.amplifier.READ_BACK_S', 0.1)
    drive_bare(amplifier, device)
    device.coils._settle = lambda cause: None  # the stages are fused: currents stay
    assert amplifier.close() is False
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
    amplifier._receive = lambda timeout_s: next(readings, None) or exhaust()

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
    sent = [_command(amplifier, currents) for currents in
            ([1.0, 0, 0, 0], [0, 1.0, 0, 0], [1.0, 0, 0, 0], [0, 0, 1.0, 0])]
    amplifier._unacknowledged.extend(sent)
    tolerance_A = float(amplifier._tolerance_A[0])
    assert tolerance_A >= 0.02 * FULL_SCALE_A

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


def _command(amplifier, currents):
    kind = sys.modules[amplifier_class.__module__].Command
    return kind(0.0, np.array(currents, float))


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
    with pytest.raises(AmplifierError):
        while True:
            amplifier.write(DRIVING)
            amplifier.poll(0.05)
    assert amplifier.close() is False
    with pytest.raises(NoAnswerError):
        amplifier.write(ZERO)


@every_protocol
def test_a_waiting_poll_can_be_woken(amplifier, device):
    amplifier.wake()  # whatever state it is in
    drive_bare(amplifier, device)
    device.fault('silence')
    time.sleep(0.02)
    amplifier.poll()
    amplifier.reply_s = 60.0
    threading.Timer(0.05, amplifier.wake).start()
    begin = time.monotonic()
    while time.monotonic() - begin < 0.05:
        amplifier.poll(8.0)
    assert time.monotonic() - begin < 6.0


@every_protocol
def test_a_poll_returns_in_its_time(amplifier, device):
    drive_bare(amplifier, device)
    device.fault('silence')
    amplifier.reply_s = 60.0
    until(lambda: not amplifier.poll(0.01))
    begin = time.monotonic()
    assert amplifier.poll(0.05) == []
    assert 0.045 <= time.monotonic() - begin < 5.0


# Drivers for devices that answer when asked -------------------------------------------------

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
    amplifier.reply_s = 0.1
    device.fault('silence+0.05')
    for _ in range(5):
        read(amplifier)
    device.fault('silence')
    with pytest.raises(NoAnswerError, match='no answer'):
        while True:
            amplifier.poll(0.05)


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
def test_the_number_of_ports_is_checked(protocol):
    for urls in ('a,b,c', 'a,b,c,d,e'):
        if True:
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


# The driver of the coils --------------------------------------------------------------------


def test_nothing_flows_before_arming(driver, device):
    assert not driver.command(DRIVING)
    assert (driver.connected, driver.gate.armed, driver.gate.fault) == (True, False, None)
    heard = driver.amplifier.counters.frames_received
    until(lambda: driver.amplifier.counters.frames_received > heard + 3)
    assert set(device.flowed) == {ZERO}
    drive(driver, device)  # and the command of before is forgotten
    assert not {*device.flowed} - {ZERO} - {device.flowed[-1]}


@every_protocol
def test_arming_tries_each_coil_and_then_lets_commands_flow(drivers, device, protocol):
    told, tags = [], []
    driver = drivers(lambda reading: told.append(reading), tags.append, self_check=True,
                     accept_no_watchdog=protocol in WITHOUT_WATCHDOG)
    assert driver.gains is None
    until(lambda: told)
    assert driver.arm() is None
    assert driver.gains == pytest.approx([1.0] * 4, abs=0.15)
    pulses = [[abs(current) > 0.1 for current in flowed] for flowed in device.flowed if any(flowed)]
    assert pulses == [[coil == pulsed for coil in range(4)] for pulsed in range(4)]
    assert driver.warning.startswith('no watchdog') == (protocol in WITHOUT_WATCHDOG)
    if protocol == 'serial_transfer':
        assert 0.09 < driver.watchdog_s < 0.5
        assert device.causes[-1] == 'watchdog'
    else:
        assert driver.watchdog_s is None
    assert driver.command(DRIVING, 'tag')
    device.eventually(DRIVING)
    assert until(lambda: tags)[0].tag == 'tag'
    until(lambda: any(one.acknowledges is tags[0] for one in told))
    assert tags[0].currents_A == pytest.approx(DRIVING)
    assert driver.arm() is None  # armed already: nothing is tried again
    assert device.flows(DRIVING)
    assert driver.stop() is True
    assert device.flowed[-1] == ZERO
    assert not driver.connected


@pytest.mark.parametrize('watchdog_s', [None])
def test_a_firmware_without_a_watchdog_is_found_out(drivers, device):
    driver = drivers(self_check=True, accept_no_watchdog=False)
    until(lambda: 'the amplifier has no watchdog' in (driver.arm() or ''))
    assert driver.gate.fault.reason is Reason.SELF_CHECK
    device.eventually(ZERO)
    assert (driver.gate.armed, driver.gains, driver.watchdog_s) == (False, None, None)


@pytest.mark.parametrize('fault', ['open=2', 'reversed=3', 'half_gain=4'])
def test_a_coil_that_is_wrong_refuses_arming(drivers, device, fault):
    driver = drivers(self_check=True)
    device.fault(fault)
    refusal = until(lambda: 'coil_' in (said := driver.arm() or '') and said)
    assert refusal.startswith('self-check: coil_')
    device.eventually(ZERO)
    assert not driver.gate.armed
    assert driver.gains is None
    assert not driver.command(DRIVING)
    device.mend()
    arm(driver)
    assert driver.gate.fault is None
    drive(driver, device)


def test_commands_during_the_check_go_nowhere(drivers, device):
    driver = drivers(self_check=True)
    commanding = threading.Event()

    def command():
        while not commanding.is_set():
            driver.command((0.0, 0.0, 0.0, 1.9))
            time.sleep(0.001)

    thread = threading.Thread(target=command)
    thread.start()
    try:
        arm(driver)
    finally:
        commanding.set()
        thread.join()
    pulse_A = 3 * LIMITS.deviation_A
    flowed = device.flowed.copy()
    last = max(index for index, one in enumerate(flowed) if abs(one[3] - pulse_A) < 0.05)
    assert all(abs(current) < 1.0 for one in flowed[:last + 1] for current in one)


@pytest.mark.parametrize('watchdog_s', [0.4])
def test_a_held_command_feeds_the_watchdog_of_the_device(driver, device):
    drive(driver, device)
    sent = driver.amplifier.counters.frames_sent
    until(lambda: driver.amplifier.counters.frames_sent > sent + 20)
    assert device.flows(DRIVING)
    assert 'watchdog' not in device.causes


def test_a_command_that_goes_stale_ends_in_zero(drivers, device):
    driver = drivers(stale_s=0.3)
    drive(driver, device)
    assert tripped(driver, device, Reason.STALE).detail.startswith('none for')


def test_a_command_that_waited_too_long_goes_nowhere(drivers, device):
    holding, held = threading.Event(), threading.Event()

    def hold(_):
        if holding.is_set():
            held.set()
            until(lambda: not holding.is_set())

    driver = drivers(hold, stale_s=0.5)
    arm(driver)
    holding.set()
    held.wait()
    driver.command(DRIVING)
    time.sleep(0.6)
    holding.clear()
    assert tripped(driver, device, Reason.STALE).detail.startswith('given')
    assert {*device.flowed} == {ZERO}


def test_nobody_there_ends_the_permission(drivers, device):
    driver = drivers(idle_s=0.1)
    arm(driver)
    tripped(driver, device, Reason.IDLE)


@pytest.mark.parametrize(('bad', 'reason'), [
    ((math.nan, 0, 0, 0), Reason.MALFORMED), ((0, 0, 0), Reason.MALFORMED),
    ((0, 0, -2.1, 0), Reason.LIMIT)])
def test_a_bad_command_ends_in_zero_until_armed_again(driver, device, bad, reason):
    drive(driver, device)
    driver.command(bad)
    tripped(driver, device, reason)
    drive(driver, device)
    assert driver.gate.fault is None


def test_disarming_zeroes_at_once(driver, device):
    drive(driver, device)
    driver.disarm()
    device.eventually(ZERO)
    assert (driver.gate.fault, driver.gate.armed) == (None, False)
    assert not driver.command(DRIVING)
    driver.disarm((Reason.COMMANDER, 'nothing to tell of'))
    assert driver.gate.fault is None
    drive(driver, device)
    driver.disarm((Reason.COMMANDER, 'somebody else'))
    assert tripped(driver, device, Reason.COMMANDER).detail == 'somebody else'


def test_disarming_does_not_wait_for_the_next_byte(driver, device):
    drive(driver, device)
    begin = time.monotonic()
    for _ in range(20):
        driver.disarm()
    assert time.monotonic() - begin < 20 * coil_driver._DISARMING_S / 2


@pytest.mark.parametrize(('fault', 'reason'), [
    ('open=1', Reason.DEVIATION), ('silence', Reason.SILENCE), ('reset=9000', Reason.SILENCE)])
def test_a_fault_of_the_device_ends_in_zero(drivers, device, fault, reason):
    driver = drivers(silence_s=0.4)
    drive(driver, device)
    until(lambda: driver.command(DRIVING) and not driver.gate._replaced)
    device.fault(fault)
    tripped(driver, device, reason)


@pytest.mark.parametrize('protocol', ['roboteq'])
def test_what_the_device_says_of_itself_is_a_fault(drivers, device, monkeypatch):
    monkeypatch.setattr(polled, '_INSPECT_S', 0.02)
    driver = drivers(self_check=True, silence_s=30.0, settling_s=20.0)
    arm(driver)
    device.fault('over_temperature')
    fault = until(lambda: driver.gate.fault)
    assert fault.reason is Reason.DEVICE
    assert driver.arm() == fault.detail
    assert not driver.gate.armed


@every_protocol
def test_a_lost_line_comes_back_at_zero_and_disarmed(driver, device, monkeypatch):
    monkeypatch.setattr(coil_driver, '_BACKOFF_S', (0.02, 0.05))
    drive(driver, device)
    device.coils.watchdog_s, device.coils._deadline_s = None, math.inf
    device.fault('unplug+0.3')
    assert until(lambda: driver.gate.fault).reason is Reason.LINE
    until(lambda: not driver.connected)
    assert driver.arm() == 'the amplifier is not connected'
    assert not driver.command(DRIVING)
    driver.disarm()
    until(lambda: driver.connected)
    device.eventually(ZERO)
    assert driver.gate.fault.reason is Reason.LINE
    assert not driver.command(DRIVING)
    arm(driver)
    assert device.flows(ZERO)  # what was commanded in between is forgotten
    drive(driver, device)


def test_attempts_to_reconnect_become_rarer(driver, device, monkeypatch):
    pauses = []
    monkeypatch.setattr(coil_driver, '_BACKOFF_S', (0.01, 0.05))
    wait = driver._ending.wait
    driver._ending.wait = lambda pause_s: pauses.append(pause_s) or wait(pause_s)
    device.fault('unplug')
    until(lambda: len(pauses) > 4)
    assert pauses[:5] == [0.01, 0.02, 0.04, 0.05, 0.05]
    device.mend()
    until(lambda: driver.connected)
    before = len(pauses)
    device.fault('unplug')
    until(lambda: len(pauses) > before)
    assert pauses[before] == 0.01


def test_stopping_while_the_line_is_away(driver, device):
    device.fault('unplug')
    until(lambda: not driver.connected)
    assert driver.stop() is False
    assert not driver.stop()


def test_stopping_during_the_check_answers(drivers, device):
    driver = drivers(self_check=True, settling_s=5.0)
    driver._go_on_checking = lambda check, now: None  # it never ends
    answers = []
    arming = threading.Thread(target=lambda: answers.append(driver.arm()))
    until(lambda: driver.gate._measured_s > 0)
    arming.start()
    until(lambda: driver._arming is not None)
    assert driver.arm() == 'the self-check is going on'
    assert not driver.command(DRIVING)
    driver.stop()
    arming.join()
    assert answers == ['the driver stopped']


def test_disarming_during_the_check_ends_it(drivers, device):
    driver = drivers(self_check=True)
    driver._go_on_checking = lambda check, now: None
    answers = []
    arming = threading.Thread(target=lambda: answers.append(driver.arm()))
    until(lambda: driver.gate._measured_s > 0)
    arming.start()
    until(lambda: driver._arming is not None)
    driver.disarm()
    arming.join()
    assert answers == ['disarmed meanwhile']
    device.eventually(ZERO)
    del driver._go_on_checking
    drive(driver, device)


def test_a_check_without_an_answer_is_given_up(drivers, device, monkeypatch):
    monkeypatch.setattr(coil_driver, '_ARMING_S', 0.2)
    driver = drivers(self_check=True)
    driver._go_on_checking = lambda check, now: None
    until(lambda: driver.gate._measured_s > 0)
    assert driver.arm() == 'the driver did not answer within 0.2 s'
    until(lambda: not driver.gate.armed)


@pytest.mark.parametrize('where', ['on_reading', 'on_sent', 'write'])
def test_whatever_fails_ends_in_zero_and_the_thread_goes_on(drivers, device, where, monkeypatch):
    failing = threading.Event()

    def fail(_):
        if failing.is_set():
            raise RuntimeError('subscriber gone')

    driver = drivers(**{where: fail} if where != 'write' else {})
    drive(driver, device)
    write = driver.amplifier.write

    def refuse(currents, tag=None):
        if failing.is_set() and any(currents):
            raise RuntimeError('subscriber gone')
        return write(currents, tag)

    if where == 'write':
        monkeypatch.setattr(driver.amplifier, 'write', refuse)
    failing.set()
    driver.command((0.5, 0, 0, 0), 'tag')
    fault = tripped(driver, device, Reason.INTERNAL)
    assert 'subscriber gone' in fault.detail
    failing.clear()
    drive(driver, device)


def test_a_failing_device_does_not_take_all_of_the_processor(driver, monkeypatch):
    tries = []

    def poll(_):
        tries.append(time.monotonic())
        raise RuntimeError('driver broken')

    monkeypatch.setattr(driver.amplifier, 'poll', poll)
    until(lambda: len(tries) > 10)
    assert tries[10] - tries[0] > 9 * coil_driver._TICK_S
    monkeypatch.undo()


def test_an_error_on_the_way_to_zero_does_not_end_the_thread(driver, device, monkeypatch):
    drive(driver, device)

    def broken(*_):
        raise RuntimeError('broken')

    monkeypatch.setattr(driver.amplifier, 'write', broken)
    assert until(lambda: driver.gate.fault).reason is Reason.INTERNAL
    monkeypatch.undo()
    device.eventually(ZERO)
    drive(driver, device)


def test_a_driver_that_starts_again_drives_again(driver, device):
    drive(driver, device)
    assert driver.stop() is True
    assert not [one for one in threading.enumerate() if one.name == 'coil driver']
    until(lambda: not device.lines[0].present)
    assert not driver.gate.armed
    driver.start()
    drive(driver, device)


def test_without_a_device_it_does_not_start(amplifier, device):
    driver = CoilDriver(amplifier, LIMITS, print)
    driver.disarm()
    assert driver.stop() is False
    device.fault('silence')
    amplifier._boot_s = 0.05
    with pytest.raises(NoAnswerError):
        driver.start()
    assert not driver.connected
    assert driver.arm() == 'the amplifier is not connected'
    assert not driver.command(DRIVING)


@pytest.mark.parametrize('full_scale_A', [math.nextafter(FULL_SCALE_A, 0), [9.0, 9.0, 1.0, 9.0]])
def test_limits_that_allow_too_much_are_refused(full_scale_A):
    with pytest.raises(InputError, match='at most the full scale'):
        CoilDriver(amplifier_class('serial_transfer')('nowhere', full_scale_A), LIMITS, print)


@pytest.mark.parametrize(('protocol', 'self_check', 'accepted', 'right'), [
    ('modbus', True, False, False), ('modbus', True, True, True), ('modbus', False, True, True),
    ('serial_transfer', False, False, False), ('serial_transfer', True, False, True),
    ('serial_transfer', False, True, True), ('roboclaw', False, False, True),
    ('roboclaw', True, True, True)])
def test_what_has_no_watchdog_must_be_accepted(protocol, self_check, accepted, right):
    amplifier = amplifier_class(protocol)('a', FULL_SCALE_A)
    if right:
        driver = CoilDriver(amplifier, LIMITS, print, self_check=self_check,
                            accept_no_watchdog=accepted)
        assert bool(driver.warning) == (accepted and protocol != 'roboclaw')
        assert ('loses its power' in driver.warning) == bool(driver.warning)
    else:
        with pytest.raises(InputError, match='accept_no_watchdog'):
            CoilDriver(amplifier, LIMITS, print, self_check=self_check,
                       accept_no_watchdog=accepted)


def test_limits_without_room_for_a_pulse_are_refused_at_once():
    limits = Limits(**{**vars(LIMITS), 'deviation_A': 1.0})
    with pytest.raises(InputError, match='self-check'):
        CoilDriver(amplifier_class('roboclaw')('a', FULL_SCALE_A), limits, print)
    CoilDriver(amplifier_class('roboclaw')('a', FULL_SCALE_A), limits, print, self_check=False)


# What watches over devices without a watchdog -----------------------------------------------


@pytest.mark.parametrize('watchdog_s', [None])
@pytest.mark.parametrize('protocol', ['serial_transfer', 'scpi'])
def test_a_thread_that_hangs_ends_in_zero(drivers, device):
    hanging = threading.Event()
    driver = drivers(lambda _: until(lambda: not hanging.is_set()))
    drive(driver, device)
    hanging.set()
    device.eventually(ZERO)
    hanging.clear()
    assert driver.stop() is True


@pytest.mark.parametrize('watchdog_s', [None])
def test_a_process_that_is_fed_keeps_quiet(driver, device):
    drive(driver, device)
    sentinel_of = driver._last_resort._process
    time.sleep(0.3)
    assert {*device.flowed[-1:]} == {device.flowed[-1]}
    assert device.flows(DRIVING)
    assert driver.gate.fault is None
    driver.stop()
    assert sentinel_of.poll() == 0


@pytest.mark.parametrize('watchdog_s', [None])
def test_without_its_sentinel_nothing_is_driven(driver, device):
    drive(driver, device)
    first = driver._last_resort._process
    os.kill(first.pid, signal.SIGKILL)
    assert tripped(driver, device, Reason.INTERNAL).detail.startswith('the process that watches')
    drive(driver, device)  # with another one
    assert driver._last_resort._process is not first


@pytest.mark.parametrize(('protocol', 'accepted', 'watched'), [
    ('serial_transfer', True, True), ('serial_transfer', False, False), ('roboclaw', True, False)])
def test_only_what_has_no_watchdog_is_watched(drivers, accepted, watched):
    driver = drivers(self_check=True, accept_no_watchdog=accepted)
    assert (driver._last_resort is not None) == watched


@pytest.fixture
def lines():
    """Two pipes in the place of lines: what can be read, and what is written to."""
    pipes = [os.pipe() for _ in range(2)]
    for reading, _ in pipes:
        os.set_blocking(reading, False)
    yield [reading for reading, _ in pipes], [writing for _, writing in pipes]
    for pipe in pipes:
        for end in pipe:
            os.close(end)


def said(reading):
    try:
        return os.read(reading, 65536)
    except BlockingIOError:
        return b''


WORDS = (b'zero\xff', b'nought')


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGHUP])
def test_the_sentinel_says_the_last_words_when_it_is_not_fed(lines, number):
    heard, writing = lines
    last = last_resort.LastResort(list(zip(writing, WORDS, strict=True)))
    process = last._process
    try:
        assert last.feed()
        until(lambda: said(heard[0]))  # nobody feeds it
        until(lambda: said(heard[1]))
        for _ in range(3):
            assert said(heard[0]) in (b'', *(n * WORDS[0] for n in range(1, 20)))
            until(lambda: said(heard[0]))  # and again
        process.send_signal(number)
        until(lambda: said(heard[0]))
        assert process.poll() is None
    finally:
        begin = time.monotonic()
        last.dismiss()
    assert process.returncode == 0
    assert time.monotonic() - begin < 8.0
    assert not last.feed() or not last._say(b'.')


def test_the_sentinel_is_quiet_while_it_is_fed(lines, monkeypatch):
    monkeypatch.setattr(last_resort, '_SILENCE_S', 1.5)
    heard, writing = lines
    last = last_resort.LastResort(list(zip(writing, WORDS, strict=True)))
    end = time.monotonic() + 2.5
    while time.monotonic() < end:
        assert last.feed()
        time.sleep(0.02)
    assert said(heard[0]) == said(heard[1]) == b''
    last.dismiss()
    assert said(heard[0]) == b''


def test_the_sentinel_is_fed_now_and_then_and_not_each_time(lines, monkeypatch):
    last = last_resort.LastResort([])
    fed = []
    monkeypatch.setattr(last, '_say', lambda word: fed.append(word) or False)
    assert last.feed() is False
    assert last.feed() is True
    until(lambda: not last.feed())
    assert fed == [b'.', b'.']
    monkeypatch.undo()
    last.dismiss()


def test_a_sentinel_that_hangs_holds_nobody_up(monkeypatch):
    monkeypatch.setattr(last_resort, '_LEAVE_S', 0.05)
    last = last_resort.LastResort([])
    os.kill(last._process.pid, signal.SIGSTOP)
    until(lambda: not last._say(b'.' * 4096))  # full
    last.dismiss()
    assert last._process.returncode == -signal.SIGKILL


def test_the_sentinel_outlives_its_host_until_all_is_at_zero(lines):
    heard, writing = lines
    arguments = [f'{line}={word.hex()}' for line, word in zip(writing, WORDS, strict=True)]
    process = subprocess.Popen(
        [sys.executable, '-I', '-S', sentinel.__file__, '60', *arguments], stdin=subprocess.PIPE,
        pass_fds=writing)
    process.stdin.write(b'....')
    process.stdin.flush()
    time.sleep(0.05)
    assert said(heard[0]) == b''
    begin = time.monotonic()
    process.stdin.close()  # as when the host dies
    assert process.wait(DEADLINE_S) == 0
    assert time.monotonic() - begin >= sentinel.REPEATS * sentinel.AGAIN_S
    assert said(heard[0]) == sentinel.REPEATS * WORDS[0]
    assert said(heard[1]) == sentinel.REPEATS * WORDS[1]


def test_a_line_that_is_gone_does_not_keep_the_others_from_being_zeroed(lines):
    heard, writing = lines
    gone = os.dup(writing[0])
    os.close(gone)
    sentinel.say([(gone, b'x'), (writing[1], b'y')])
    assert said(heard[1]) == b'y'
