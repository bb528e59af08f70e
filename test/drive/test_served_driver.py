"""Every way to zero of the driver of the coils, quickly: `bench/_mutants.py` runs this often."""

import math
import os
import signal
import threading
import time
from concurrent.futures import Future

import pytest

from bench._served import FULL_SCALE_A, LIMITS, MEASURED, until
from microbot_ros.drive import coil_driver, polled
from microbot_ros.drive.amplifier import Zero, amplifier_class
from microbot_ros.drive.coil_driver import CoilDriver
from microbot_ros.drive.errors import (
    NoAnswerError,
)
from microbot_ros.drive.gate import Limits, Reason
from microbot_ros.errors import InputError

pytestmark = pytest.mark.rig

ZERO = (0.0,) * 4

DRIVING = (1.0, -1.0, 0.5, 0.2)
PROTOCOLS = MEASURED
WITHOUT_WATCHDOG = ('modbus', 'scpi')

every_protocol = pytest.mark.parametrize('protocol', PROTOCOLS)


def arm(driver):
    until(lambda: driver.arm() is None)
    driver.command(ZERO)


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
    pulses = [[abs(current) > 0.1 for current in flowed]
              for flowed in device.flowed if any(flowed)]
    assert pulses == [[coil == pulsed for coil in range(4)] for pulsed in range(4)]
    assert driver.warning.startswith('no watchdog') == (protocol in WITHOUT_WATCHDOG)
    if protocol == 'serial_transfer':
        assert 0.09 < driver.watchdog_s < 0.5
        assert device.causes[-1] == 'watchdog'
    else:
        assert driver.watchdog_s is None
    driver.command(ZERO)
    assert driver.command(DRIVING, 'tag')
    device.eventually(DRIVING)
    assert until(lambda: tags)[0].tag == 'tag'
    until(lambda: any(one.acknowledges is tags[0] for one in told))
    assert tags[0].currents_A == pytest.approx(DRIVING)
    assert driver.arm() is None  # armed already: nothing is tried again
    assert device.flows(DRIVING)
    assert driver.stop() is Zero.CONFIRMED
    assert device.flowed[-1] == ZERO
    assert not driver.connected


@pytest.mark.parametrize('watchdog_s', [0.4])
def test_the_zero_of_the_watchdog_is_no_fault_of_the_coils(drivers):
    """Though the pulse lasted for longer than a reading may be late."""
    driver = drivers(
        self_check=True, accept_no_watchdog=False, settling_s=0.05, feedback_timeout_s=0.2)
    arm(driver)
    assert driver.watchdog_s >= 0.35


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


def test_a_refusal_tells_the_reason(driver, device):
    device.coils.command(DRIVING)  # a hand at the board
    assert until(lambda: driver.gate.fault).reason is Reason.UNCOMMANDED
    assert until(lambda: driver.arm()).startswith('current flows without a command')
    device.eventually(ZERO)  # as it is said again and again


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
def test_a_pulse_that_lasts_is_not_a_stale_command(drivers):
    driver = drivers(self_check=True, accept_no_watchdog=False, command_timeout_s=0.25)
    arm(driver)
    assert driver.watchdog_s > 0.3


@pytest.mark.parametrize('watchdog_s', [0.4])
def test_a_held_command_feeds_the_watchdog_of_the_device(driver, device):
    drive(driver, device)
    sent, began_s = driver.amplifier.counters.frames_sent, time.monotonic()
    until(lambda: driver.amplifier.counters.frames_sent > sent + 20)
    assert time.monotonic() - began_s >= 19 * coil_driver._REFRESH_S  # and does not flood it
    assert device.flows(DRIVING)
    assert 'watchdog' not in device.causes


def test_a_command_that_goes_stale_ends_in_zero(drivers, device):
    driver = drivers(command_timeout_s=0.3)
    drive(driver, device)
    assert tripped(driver, device, Reason.STALE).detail.startswith('none for')


def test_a_command_that_waited_too_long_goes_nowhere(drivers, device):
    holding, held = threading.Event(), threading.Event()

    def hold(_):
        if holding.is_set():
            held.set()
            until(lambda: not holding.is_set())

    driver = drivers(hold, command_timeout_s=0.5)
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


def test_disarming_returns_when_the_zero_went_out(driver, device, monkeypatch):
    monkeypatch.setattr(coil_driver, '_DISARMING_S', 5.0)
    for _ in range(5):
        drive(driver, device)
        driver.disarm()
        assert driver._sent == ZERO
        device.eventually(ZERO)


def test_disarming_waits_until_it_was_done(driver, device, monkeypatch):
    monkeypatch.setattr(coil_driver, '_DISARMING_S', 5.0)
    drive(driver, device)
    request, held = driver._request, []
    monkeypatch.setattr(driver, '_request', held.append)
    disarming = threading.Thread(target=driver.disarm)
    disarming.start()
    until(lambda: held)
    disarming.join(0.05)
    assert disarming.is_alive()
    request(*held)
    disarming.join()
    assert driver._sent == ZERO


def test_disarming_does_not_wait_for_the_next_byte(driver, device):
    drive(driver, device)
    begin = time.monotonic()
    for _ in range(20):
        driver.disarm()
    assert time.monotonic() - begin < 20 * coil_driver._DISARMING_S / 2


@pytest.mark.parametrize(('fault', 'reason'), [
    ('open=1', Reason.DEVIATION), ('silence', Reason.SILENCE), ('reset=9000', Reason.SILENCE)])
def test_a_fault_of_the_device_ends_in_zero(drivers, device, fault, reason):
    driver = drivers(feedback_timeout_s=0.4)
    drive(driver, device)
    until(lambda: driver.command(DRIVING) and not driver.gate._replaced)
    device.fault(fault)
    tripped(driver, device, reason)


@pytest.mark.parametrize('protocol', ['roboteq'])
def test_what_the_device_says_of_itself_is_a_fault(drivers, device, monkeypatch):
    monkeypatch.setattr(polled, '_INSPECT_S', 0.02)
    driver = drivers(self_check=True, feedback_timeout_s=30.0, settling_s=20.0)
    arm(driver)
    device.fault('over_temperature')
    fault = until(lambda: driver.gate.fault)
    assert fault.reason is Reason.DEVICE
    assert driver.arm() == fault.detail
    assert not driver.gate.armed


@every_protocol
def test_a_lost_line_comes_back_at_zero_and_disarmed(driver, device):
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


def test_attempts_to_reconnect_go_on_as_often_as_a_line_may_be_back(driver, device):
    pauses_s = []
    wait = driver._ending.wait
    driver._ending.wait = lambda pause_s: pauses_s.append(pause_s) or wait(0.001)
    device.fault('unplug')
    until(lambda: len(pauses_s) > 7)
    assert set(pauses_s) == {0.1}
    device.mend()
    until(lambda: driver.connected)


def test_arming_that_was_asked_for_before_the_line_was_lost_is_refused_while_it_is(driver, device):
    device.fault('unplug')
    until(lambda: not driver.connected)
    answer = Future()
    driver._request(lambda: driver._begin_arming(answer, driver.epoch))
    assert answer.result(5.0) == 'the amplifier is not connected'


def test_stopping_while_the_line_is_away(driver, device):
    device.fault('unplug')
    until(lambda: not driver.connected)
    assert driver.stop() is Zero.UNREACHABLE
    assert driver.stop() is Zero.UNREACHABLE


def checking(drivers, **options):
    """A driver in a self-check that never ends, who is arming it, and what arming answers."""
    driver, answers = drivers(self_check=True, **options), []
    driver._go_on_checking = lambda *_: None
    arming = threading.Thread(target=lambda: answers.append(driver.arm()))
    until(lambda: driver.gate._measured_s > 0)
    arming.start()
    until(lambda: driver._arming is not None)
    return driver, arming, answers


def test_stopping_during_the_check_answers(drivers):
    driver, arming, answers = checking(drivers, settling_s=5.0)
    assert driver.arm() == 'the self-check is going on'
    assert not driver.command(DRIVING)
    driver.stop()
    arming.join()
    assert answers == ['the driver stopped']


def test_disarming_during_the_check_ends_it(drivers, device):
    driver, arming, answers = checking(drivers)
    driver.disarm()
    arming.join()
    assert answers == ['disarmed meanwhile']
    device.eventually(ZERO)
    del driver._go_on_checking
    drive(driver, device)


def test_a_line_lost_during_the_check_ends_it(drivers, device):
    _, arming, answers = checking(drivers)
    device.fault('unplug')
    arming.join(5.0)
    assert answers[0].startswith(Reason.LINE.value)


def test_a_check_without_an_answer_is_given_up(drivers, monkeypatch):
    monkeypatch.setattr(coil_driver, '_ARMING_S', 0.2)
    driver = drivers(self_check=True)
    driver._go_on_checking = lambda *_: None
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

    def refuse(currents, *more):
        if failing.is_set() and any(currents):
            raise RuntimeError('subscriber gone')
        return write(currents, *more)

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


@pytest.mark.parametrize('protocol', ['roboclaw'])
def test_a_device_that_cannot_be_read_any_more_is_zeroed(driver, device, monkeypatch):
    drive(driver, device)
    device.coils.watchdog_s, device.coils._deadline_s = None, math.inf

    def poll(_):
        raise RuntimeError('driver broken')

    monkeypatch.setattr(driver.amplifier, 'poll', poll)
    device.eventually(ZERO)
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
    assert driver.stop() is Zero.CONFIRMED
    assert not [one for one in threading.enumerate() if one.name == 'coil driver']
    until(lambda: not device.lines[0].present)
    assert not driver.gate.armed
    driver.start()
    assert driver._thread.daemon  # a process that ends without stopping it is not held up
    drive(driver, device)


def test_without_a_device_it_does_not_start(amplifier, device):
    driver = CoilDriver(amplifier, LIMITS, print)
    driver.disarm()
    assert driver.stop() is Zero.UNREACHABLE
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
            CoilDriver(amplifier, LIMITS, print, self_check=self_check)  # which is not accepted


def test_limits_without_room_for_a_pulse_are_refused_at_once():
    limits = Limits(**{**vars(LIMITS), 'deviation_A': 1.0})
    with pytest.raises(InputError, match='self-check'):
        CoilDriver(amplifier_class('roboclaw')('a', FULL_SCALE_A), limits, print)
    CoilDriver(amplifier_class('roboclaw')('a', FULL_SCALE_A), limits, print, self_check=False)


# Devices without a watchdog are watched -------------------------------------------------------

@pytest.mark.parametrize('watchdog_s', [None])
@pytest.mark.parametrize('protocol', ['serial_transfer', 'scpi'])
def test_a_thread_that_hangs_ends_in_zero(drivers, device):
    hanging = threading.Event()
    driver = drivers(lambda _: until(lambda: not hanging.is_set()))
    drive(driver, device)
    hanging.set()
    device.eventually(ZERO)
    hanging.clear()
    assert driver.stop() is Zero.CONFIRMED


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


# What is known of a zero ------------------------------------------------------------------------

@every_protocol
def test_a_zero_is_confirmed_by_a_reading_that_was_taken_after_it(driver, device):
    drive(driver, device)
    assert driver.zero is None
    driver.disarm()
    assert driver.await_zero(5.0) is Zero.CONFIRMED
    assert device.flows(ZERO)


def test_a_zero_that_nothing_reads_back_is_sent_and_not_confirmed(drivers, device):
    driver = drivers(feedback_timeout_s=0.3)
    drive(driver, device)
    device.fault('silence')
    driver.disarm()
    assert driver.await_zero(0.3) is Zero.SENT
    device.mend()
    assert driver.await_zero(5.0) is Zero.CONFIRMED
    device.fault('silence')  # what was seen once is not seen for ever
    until(lambda: driver.zero is Zero.SENT)


def test_current_that_stays_is_no_zero_and_outranks_what_stopped_it(drivers, device):
    driver = drivers(command_timeout_s=0.3)
    drive(driver, device)
    stuck = device.coils._settle
    device.coils._settle = lambda _: None  # a bridge that conducts whatever it is told
    assert until(lambda: driver.gate.fault).reason is Reason.STALE
    assert until(lambda: driver.gate.fault.reason is Reason.UNCOMMANDED)
    assert driver.zero is Zero.SENT
    sent = driver.amplifier.counters.frames_sent
    until(lambda: driver.amplifier.counters.frames_sent > sent + 3)  # and zero is said again
    device.coils._settle = stuck
    device.eventually(ZERO)
    assert driver.await_zero(5.0) is Zero.CONFIRMED


def test_a_lost_line_is_not_reachable_until_it_is_back(driver, device):
    drive(driver, device)
    device.fault('unplug+0.3')
    until(lambda: not driver.connected)
    assert driver.await_zero(0.1) is Zero.UNREACHABLE
    assert driver.amplifier.unreachable
    until(lambda: driver.connected)
    assert driver.await_zero(5.0) is Zero.CONFIRMED


# Arming is asked in an epoch --------------------------------------------------------------------

@pytest.mark.parametrize('stop', ['disarm', 'fault', 'trip'])
def test_arming_from_before_a_stop_is_refused(drivers, device, stop):
    driver = drivers(command_timeout_s=0.3)
    epoch = driver.epoch
    if stop == 'disarm':
        driver.disarm()
    elif stop == 'fault':
        device.coils.command(DRIVING)
        until(lambda: driver.gate.fault)
        device.eventually(ZERO)
    else:
        drive(driver, device)
        until(lambda: driver.gate.fault)
    until(lambda: driver.epoch > epoch)
    assert driver.arm(epoch) == coil_driver.STOPPED
    assert not driver.gate.armed
    arm(driver)


def test_a_stop_that_is_queued_behind_arming_goes_first(drivers, monkeypatch):
    """ARM, STOP, ARM: what arms twice was asked before the stop."""
    driver = drivers(self_check=True)
    until(lambda: driver.gate._measured_s > 0)
    requests = []
    monkeypatch.setattr(driver, '_request', requests.append)
    answers = [driver.request_arming(driver.epoch)]
    epoch = driver.epoch
    driver.request_zero()
    answers.append(driver.request_arming(epoch))
    monkeypatch.undo()
    for request in requests:
        driver._request(request)
    assert [answer.result(10.0) for answer in answers] == [coil_driver.STOPPED] * 2
    assert not driver.gate.armed


# Nothing from before arming flows ---------------------------------------------------------------

def test_a_command_from_before_arming_flows_only_after_a_zero(driver, device):
    until(lambda: driver.arm() is None)
    for _ in range(20):
        driver.command(DRIVING)
        time.sleep(0.002)
    assert driver.gate.armed
    assert driver.gate.holding
    driver.command(ZERO)
    driver.command(DRIVING)
    device.eventually(DRIVING)
    assert {*device.flowed[:-1]} == {ZERO}


def test_a_zero_from_before_arming_does_not_count(driver, device):
    driver.command(ZERO)
    until(lambda: driver.arm() is None)
    driver.command(DRIVING)
    until(lambda: driver._order is None)
    assert driver.gate.holding
    assert device.flows(ZERO)


def test_an_operator_who_leaves_ends_the_permission(driver, device, monkeypatch):
    monkeypatch.setattr('microbot_ros.drive.gate.UNATTENDED_S', 0.3)
    driver.attend()
    drive(driver, device)
    tripped(driver, device, Reason.UNATTENDED)
    drive(driver, device)  # unattended, as no heartbeat came since
    time.sleep(0.4)
    assert driver.gate.armed
