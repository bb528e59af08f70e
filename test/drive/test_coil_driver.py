"""The dead-man at work: whatever fails, the emulated amplifier's log ends in zero."""

import math
import os
import signal
import subprocess
import sys
import threading

import pytest

from microbot_ros.drive.coil_driver import CoilDriver
from microbot_ros.drive.errors import NoAnswerError
from microbot_ros.drive.gate import Limits, Reason
from microbot_ros.drive.serial_transfer.driver import SerialTransferAmplifier
from microbot_ros.errors import InputError

FULL_SCALE_A = 2.0
LIMITS = Limits(
    current_A=FULL_SCALE_A, step_A=2 * FULL_SCALE_A, slew_A_per_s=1e4, stale_s=0.8,
    deviation_A=0.1, settling_s=0.5, silence_s=0.8, continuous_A=1.5, thermal_s=60.0, idle_s=60.0)
DRIVING = [1.0, -1.0, 0.5, 0.0]
HOST = """
import sys, time
from microbot_ros.drive.coil_driver import CoilDriver
from microbot_ros.drive.gate import Limits
from microbot_ros.drive.serial_transfer.driver import SerialTransferAmplifier
driver = CoilDriver(SerialTransferAmplifier(sys.argv[1], 2.0), Limits(*eval(sys.argv[2])), print)
driver.start()
while True:
    driver.arm()
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
    limits = Limits(**{**vars(LIMITS), 'stale_s': 60.0})
    driver = CoilDriver(SerialTransferAmplifier(board.url, FULL_SCALE_A), limits, lambda _: None)
    driver.start()
    drive(driver, board)
    threading.Event().wait(0.5)
    assert board.entries()[-1]['cause'] == 'command'
    assert board.currents() == pytest.approx(DRIVING)
    assert driver.stop()


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
    assert driver.stop() is False


@pytest.mark.parametrize('number', [signal.SIGKILL, signal.SIGSTOP])
def test_the_watchdog_of_the_device_outlives_the_host(board, number):
    limits = str(tuple(vars(LIMITS).values()))
    with subprocess.Popen([sys.executable, '-c', HOST, board.url, limits],
                          stdout=subprocess.DEVNULL) as host:
        try:
            board.eventually_at(DRIVING)
            host.send_signal(number)
            board.eventually_at([0] * 4, 'watchdog')
        finally:
            host.kill()


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
    assert driver.stop()


def test_it_leaves_no_thread_and_no_port(driver, board):
    before = threading.active_count()
    assert driver.stop()
    assert threading.active_count() == before - 1
    again = SerialTransferAmplifier(board.url, FULL_SCALE_A)
    again.connect()
    assert again.close()


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
