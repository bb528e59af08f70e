"""The dead-man at work: whatever fails, the emulated amplifier's log ends in zero."""

import glob
import math
import os
import signal
import subprocess
import sys
import threading
import time

import pytest

from microbot_ros.drive.amplifier import Zero, amplifier_class
from microbot_ros.drive.coil_driver import CoilDriver
from microbot_ros.drive.errors import NoAnswerError
from microbot_ros.drive.gate import Limits, Reason
from microbot_ros.drive.serial_transfer.driver import SerialTransferAmplifier
from microbot_ros.errors import InputError

pytestmark = pytest.mark.rig

FULL_SCALE_A = 2.0
LIMITS = Limits(
    current_A=FULL_SCALE_A, step_A=2 * FULL_SCALE_A, slew_A_per_s=1e4, command_timeout_s=0.8,
    deviation_A=0.1, settling_s=0.5, feedback_timeout_s=0.8, rated_current_A=1.5, thermal_s=60.0,
    idle_s=60.0)
DRIVING = [1.0, -1.0, 0.5, 0.0]
HOST = """
import sys, time
from microbot_ros.drive.coil_driver import CoilDriver
from microbot_ros.drive.gate import Limits
from microbot_ros.drive.amplifier import Zero, amplifier_class
driver = CoilDriver(amplifier_class(sys.argv[3])(sys.argv[1], 2.0), Limits(*eval(sys.argv[2])),
                    lambda _: None, accept_no_watchdog=True)
driver.start()
while True:
    if not driver.gate.armed:
        driver.arm()
        driver.command([0.0] * 4)
    driver.command([1.0, -1.0, 0.5, 0.0])
    time.sleep(0.01)
"""


@pytest.fixture
def board(emulate):
    return emulate('serial_transfer')


@pytest.fixture
def driver(board):
    driver = CoilDriver(SerialTransferAmplifier(board.url, FULL_SCALE_A), LIMITS, lambda _: None,
                        self_check=False, accept_no_watchdog=True)
    driver.start()
    yield driver
    driver.stop()


def drive(driver, board):
    board.until(lambda: driver.arm() is None)
    driver.command([0.0] * 4)
    assert driver.command(DRIVING)
    board.eventually_at(DRIVING)


def test_the_thread_goes_first_where_the_system_grants_it(driver, board, real_time):
    drive(driver, board)
    thread = next(t for t in threading.enumerate() if t.name == 'coil driver')
    policy = os.sched_getscheduler(thread.native_id)
    assert driver.real_time == real_time == (policy == os.SCHED_FIFO)


def test_nothing_goes_out_before_arming(driver, board):
    assert not driver.command(DRIVING)
    drive(driver, board)
    assert {entry['cause'] for entry in board.entries()} == {'reset', 'command'}


def test_a_command_that_goes_stale_ends_in_zero(driver, board):
    drive(driver, board)
    assert board.until(lambda: driver.gate.fault).reason is Reason.STALE
    board.eventually_at([0] * 4, 'command')


def test_commands_that_keep_coming_keep_driving(driver, board):
    drive(driver, board)
    for _ in range(30):
        threading.Event().wait(0.03)
        assert driver.command(DRIVING)
    assert driver.gate.fault is None
    assert board.currents() == pytest.approx(DRIVING)


def test_a_held_command_feeds_the_watchdog_of_the_device(emulate):
    board = emulate('serial_transfer', '--watchdog-ms', '100')
    limits = Limits(**{**vars(LIMITS), 'command_timeout_s': 60.0})
    driver = CoilDriver(SerialTransferAmplifier(board.url, FULL_SCALE_A), limits, lambda _: None)
    driver.start()
    drive(driver, board)
    threading.Event().wait(0.5)
    assert board.entries()[-1]['cause'] == 'command'
    assert board.currents() == pytest.approx(DRIVING)
    assert driver.stop() is Zero.CONFIRMED


@pytest.mark.parametrize('bad', [math.nan, math.inf, 2.1])
def test_a_bad_command_ends_in_zero_until_armed_again(driver, board, bad):
    drive(driver, board)
    driver.command([bad, 0, 0, 0])
    board.eventually_at([0] * 4, 'command')
    assert driver.gate.fault.reason in (Reason.MALFORMED, Reason.LIMIT)
    assert not driver.command(DRIVING)
    drive(driver, board)


def test_disarming_zeroes_at_once(driver, board):
    drive(driver, board)
    driver.disarm()
    board.eventually_at([0] * 4, 'command')
    assert not driver.command(DRIVING)


@pytest.mark.parametrize(('fault', 'reason'), [
    ('open=1', Reason.DEVIATION), ('over_temperature', Reason.DEVIATION),
    ('silence', Reason.SILENCE), ('reset=3000', Reason.SILENCE),
])
def test_a_fault_of_the_device_is_latched(driver, board, fault, reason):
    drive(driver, board)
    # Only then are zeros no late reading of what was before.
    board.until(lambda: driver.command(DRIVING) and not driver.gate._replaced)
    board.fault(fault)
    assert command_until_fault(driver).reason is reason
    board.eventually_at([0] * 4)


def command_until_fault(driver):
    while driver.gate.fault is None:
        driver.command(DRIVING)
        threading.Event().wait(0.02)
    return driver.gate.fault


@pytest.mark.parametrize('fault', ['drop=0.02', 'double=0.02', 'truncate=0.3'])
def test_a_damaged_line_never_drives_a_wrong_current(driver, board, fault):
    drive(driver, board)
    board.fault(fault)
    for _ in range(100):
        driver.command(DRIVING)
        threading.Event().wait(0.002)
    driver.stop()
    counters = driver.amplifier.counters
    assert counters.discarded_bytes > 0
    flowed = {tuple(entry['currents_A']) for entry in board.entries()}
    assert flowed <= {(0.0,) * 4, tuple(DRIVING)}


def test_bits_that_flip_in_pairs_and_pass_a_crc_of_8_bits_do_not_last(driver, board):
    # One damaged packet in 256 gets through: what then flows deviates, or the next packet ends it.
    drive(driver, board)
    board.fault('flip=0.05')
    for _ in range(200):
        driver.command(DRIVING)
        threading.Event().wait(0.002)
    driver.stop()
    board.eventually_at([0] * 4)
    assert all(abs(current) <= FULL_SCALE_A for entry in board.entries()
               for current in entry['currents_A'])


def test_an_unplugged_line_comes_back_at_zero_and_disarmed(driver, board):
    drive(driver, board)
    board.fault('unplug+0.3')
    assert command_until_fault(driver).reason is Reason.LINE
    assert 'connected' in driver.arm()
    board.eventually_at([0] * 4, 'watchdog')
    board.until(lambda: driver.connected)
    assert not driver.gate.armed
    assert not driver.command(DRIVING)
    assert driver.gate.fault.reason is Reason.LINE
    drive(driver, board)
    assert driver.gate.fault is None


def test_stopping_works_while_the_line_is_away(driver, board):
    board.fault('unplug')
    board.until(lambda: not driver.connected)
    assert driver.stop() is Zero.UNREACHABLE


@pytest.mark.parametrize(('protocol', 'options', 'cause'), [
    ('roboclaw', (), 'watchdog'), ('roboteq', (), 'watchdog'), ('modbus', (), 'command'),
    ('scpi', (), 'command'), ('serial_transfer', ('--no-watchdog',), 'command')])
@pytest.mark.parametrize('number', [signal.SIGKILL, signal.SIGSTOP])
def test_a_host_that_dies_or_hangs_ends_in_zero(emulate, number, protocol, options, cause):
    """By the watchdog of the device, and where it has none, by the process that watches ours."""
    board = emulate(protocol, *options)
    limits = str(tuple(vars(LIMITS).values()))
    with subprocess.Popen([sys.executable, '-c', HOST, board.url, limits, protocol]) as host:
        try:
            board.eventually_at(DRIVING)
            host.send_signal(number)
            ended_s = time.monotonic()
            zeroed = board.eventually_at([0] * 4, cause)
            assert zeroed['t_monotonic_s'] - ended_s < 1.0  # how long it takes is benched
            threading.Event().wait(0.3)
            assert board.currents() == pytest.approx([0] * 4)
        finally:
            host.kill()
    board.until(lambda: not sentinels(board))


def sentinels(board):
    """The processes that hold the line: neither the host nor its sentinel is to stay."""
    ports = {os.path.realpath(url) for url in board.url.split(',')}
    return [link for link in glob.glob('/proc/[0-9]*/fd/*')
            if link_target(link) in ports]


def link_target(link):
    try:
        return os.readlink(link)
    except OSError:
        return ''


def test_without_its_sentinel_an_unwatched_device_is_not_driven(emulate):
    board = emulate('serial_transfer', '--no-watchdog')
    driver = CoilDriver(SerialTransferAmplifier(board.url, FULL_SCALE_A), LIMITS, lambda _: None,
                        accept_no_watchdog=True)
    driver.start()
    try:
        drive(driver, board)
        driver._last_resort._process.kill()
        assert command_until_fault(driver).detail.startswith('the process that watches over')
        board.eventually_at([0] * 4)
        drive(driver, board)  # with another one
    finally:
        assert driver.stop() is Zero.CONFIRMED
    assert not sentinels(board)


def test_a_firmware_without_a_watchdog_is_found_out_on_arming(emulate):
    board = emulate('serial_transfer', '--no-watchdog')
    driver = CoilDriver(SerialTransferAmplifier(board.url, FULL_SCALE_A), LIMITS, lambda _: None)
    driver.start()
    try:
        board.until(lambda: 'the amplifier has no watchdog' in driver.arm())
        board.eventually_at([0] * 4, 'command')
        assert not driver.gate.armed
    finally:
        driver.stop()


def test_a_firmware_with_a_watchdog_shows_it_on_arming(board):
    driver = CoilDriver(SerialTransferAmplifier(board.url, FULL_SCALE_A), LIMITS, lambda _: None)
    driver.start()
    try:
        board.until(lambda: driver.arm() is None)
        assert 0.09 < driver.watchdog_s < 0.5
        assert board.entries()[-1]['cause'] == 'watchdog'
        driver.command([0.0] * 4)
        assert driver.command(DRIVING)
        board.eventually_at(DRIVING)
    finally:
        driver.stop()


@pytest.mark.parametrize(('protocol', 'self_check'), [
    ('modbus', True), ('scpi', True), ('serial_transfer', False)])
def test_what_has_no_watchdog_must_be_accepted(protocol, self_check):
    amplifier = amplifier_class(protocol)('a,b,c,d' if protocol == 'scpi' else 'a', FULL_SCALE_A)
    with pytest.raises(InputError, match='accept_no_watchdog'):
        CoilDriver(amplifier, LIMITS, print, self_check=self_check)
    assert 'loses its power' in CoilDriver(amplifier, LIMITS, print, self_check=self_check,
                                           accept_no_watchdog=True).warning


def test_the_newest_command_takes_the_place_of_one_that_waits(driver, board, monkeypatch):
    drive(driver, board)
    busy, sent = threading.Event(), []
    write = driver.amplifier.write

    def slow(currents, *more):
        sent.append(list(currents))
        busy.wait(0.3)
        return write(currents, *more)

    monkeypatch.setattr(driver.amplifier, 'write', slow)
    for share in range(1, 21):
        driver.command([share / 20, 0, 0, 0])
        threading.Event().wait(0.02)
    busy.set()
    board.eventually_at([1.0, 0, 0, 0])
    assert 2 <= len({tuple(currents) for currents in sent}) < 10


def test_the_thread_alone_writes(driver, board, monkeypatch):
    writers = set()
    write = driver.amplifier.write

    def watched(currents, *more):
        writers.add(threading.current_thread().name)
        return write(currents, *more)

    monkeypatch.setattr(driver.amplifier, 'write', watched)
    drive(driver, board)
    driver.disarm()
    board.eventually_at([0] * 4)
    assert writers == {'coil driver'}


def test_what_went_out_is_told_with_its_tag(board):
    told = []
    driver = CoilDriver(SerialTransferAmplifier(board.url, FULL_SCALE_A), LIMITS,
                        lambda reading: told.append(reading.acknowledges), on_sent=told.append)
    driver.start()
    try:
        board.until(lambda: driver.arm() is None)
        driver.command([0.0] * 4)
        driver.command(DRIVING, 'frame 1')
        board.until(lambda: sum(one is not None and one.tag == 'frame 1' for one in told) == 2)
        driver.command([math.nan] * 4, 'frame 2')
        last = board.until(lambda: next((one for one in told if one and one.tag == 'frame 2'), 0))
        assert last.currents_A == pytest.approx([0] * 4)
    finally:
        driver.stop()


def test_firmware_without_a_watchdog_keeps_its_last_command(emulate):
    board = emulate('serial_transfer', '--no-watchdog')
    amplifier = SerialTransferAmplifier(board.url, FULL_SCALE_A)
    amplifier.connect()
    amplifier.write(DRIVING)
    board.eventually_at(DRIVING)
    amplifier._release()  # as a host that dies
    threading.Event().wait(0.4)
    assert board.currents() == pytest.approx(DRIVING)


def test_an_exception_in_the_thread_ends_in_zero_and_the_thread_goes_on(board):
    failing = threading.Event()

    def publish(_):
        if failing.is_set():
            raise RuntimeError('subscriber gone')

    driver = CoilDriver(SerialTransferAmplifier(board.url, FULL_SCALE_A), LIMITS, publish)
    driver.start()
    drive(driver, board)
    failing.set()
    fault = board.until(lambda: driver.gate.fault)
    assert (fault.reason, 'subscriber gone' in fault.detail) == (Reason.INTERNAL, True)
    board.eventually_at([0] * 4, 'command')
    assert not driver.command(DRIVING)
    failing.clear()
    drive(driver, board)  # no restart is needed
    assert driver.stop() is Zero.CONFIRMED


def test_it_leaves_no_thread_and_no_port(driver, board):
    before = threading.active_count()
    assert driver.stop() is Zero.CONFIRMED
    assert threading.active_count() == before - 1
    again = SerialTransferAmplifier(board.url, FULL_SCALE_A)
    again.connect()
    assert again.close() is Zero.CONFIRMED


@pytest.mark.parametrize('full_scale_A', [math.nextafter(FULL_SCALE_A, 0), [9.0, 9.0, 1.0, 9.0]])
def test_a_limit_beyond_what_the_amplifier_gives_is_refused(full_scale_A):
    with pytest.raises(InputError, match='at most the full scale'):
        CoilDriver(SerialTransferAmplifier('nowhere', full_scale_A), LIMITS, print)


def test_it_does_not_start_without_an_amplifier(board):
    board.fault('silence')
    driver = CoilDriver(SerialTransferAmplifier(board.url, 2.0, boot_s=0.1), LIMITS, print)
    threads = threading.active_count()
    with pytest.raises(NoAnswerError):
        driver.start()
    assert threading.active_count() == threads
    assert driver.arm() == 'the amplifier is not connected'
