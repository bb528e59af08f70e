"""What of the driver of the coils is true of real threads, ports and processes alone.

The rest is in `test_coil_driver.py`, on virtual time.
"""

import glob
import os
import signal
import subprocess
import sys
import threading
import time

import pytest

from bench._emulator import FULL_SCALE_A, until
from microbot_ros.drive.amplifier import Zero
from microbot_ros.drive.amplifiers.serial_transfer.driver import SerialTransferAmplifier
from microbot_ros.drive.coil_driver import CoilDriver
from microbot_ros.drive.errors import NoAnswerError
from microbot_ros.drive.gate import Limits, Reason

pytestmark = pytest.mark.rig

LIMITS = Limits(
    current_A=FULL_SCALE_A, step_A=2 * FULL_SCALE_A, slew_A_per_s=1e4, command_timeout_s=0.8,
    deviation_A=0.1, settling_s=0.5, feedback_timeout_s=0.8, rated_current_A=1.5, thermal_s=60.0,
    idle_s=60.0)
DRIVING = [1.0, -1.0, 0.5, 0.0]
HOST = """
import sys, time
from microbot_ros.drive.coil_driver import CoilDriver
from microbot_ros.drive.gate import Limits
from microbot_ros.drive.amplifier import amplifier_class
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
    until(lambda: driver.arm() is None)
    driver.command([0.0] * 4)
    assert driver.command(DRIVING)
    board.eventually(DRIVING)


def test_the_thread_goes_first_where_the_system_grants_it(driver, board, real_time):
    drive(driver, board)
    thread = next(t for t in threading.enumerate() if t.name == 'coil driver')
    policy = os.sched_getscheduler(thread.native_id)
    assert driver.real_time == real_time == (policy == os.SCHED_FIFO)


def command_until_fault(driver):
    while driver.gate.fault is None:
        driver.command(DRIVING)
        threading.Event().wait(0.02)
    return driver.gate.fault


def test_an_unplugged_line_comes_back_at_zero_and_disarmed(driver, board):
    drive(driver, board)
    board.fault('unplug+0.3')
    assert command_until_fault(driver).reason is Reason.LINE
    assert 'connected' in driver.arm()
    board.eventually([0] * 4, 'watchdog')
    until(lambda: driver.connected)
    assert not driver.gate.armed
    assert not driver.command(DRIVING)
    assert driver.gate.fault.reason is Reason.LINE
    drive(driver, board)
    assert driver.gate.fault is None


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
            board.eventually(DRIVING)
            host.send_signal(number)
            ended_s = time.monotonic()
            zeroed = board.eventually([0] * 4, cause)
            assert zeroed['t_monotonic_s'] - ended_s < 1.0  # how long it takes is benched
            threading.Event().wait(0.3)
            assert board.currents == pytest.approx([0] * 4)
        finally:
            host.kill()
    until(lambda: not sentinels(board))


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
        assert command_until_fault(driver).detail.startswith('the sentinel process ended')
        board.eventually([0] * 4)
        drive(driver, board)  # with another one
    finally:
        assert driver.stop() is Zero.CONFIRMED
    assert not sentinels(board)


def test_the_thread_alone_writes(driver, board, monkeypatch):
    writers = set()
    write = driver.amplifier.write

    def watched(currents, *more):
        writers.add(threading.current_thread().name)
        return write(currents, *more)

    monkeypatch.setattr(driver.amplifier, 'write', watched)
    drive(driver, board)
    driver.disarm()
    board.eventually([0] * 4)
    assert writers == {'coil driver'}


def test_firmware_without_a_watchdog_keeps_its_last_command(emulate):
    board = emulate('serial_transfer', '--no-watchdog')
    amplifier = SerialTransferAmplifier(board.url, FULL_SCALE_A)
    amplifier.connect()
    amplifier.write(DRIVING)
    board.eventually(DRIVING)
    amplifier._release()  # as a host that dies
    threading.Event().wait(0.4)
    assert board.currents == pytest.approx(DRIVING)


def test_it_leaves_no_thread_and_no_port(driver, board):
    before = threading.active_count()
    assert driver.stop() is Zero.CONFIRMED
    assert threading.active_count() == before - 1
    again = SerialTransferAmplifier(board.url, FULL_SCALE_A)
    again.connect()
    assert again.close() is Zero.CONFIRMED


def test_it_does_not_start_without_an_amplifier(board):
    board.fault('silence')
    driver = CoilDriver(SerialTransferAmplifier(board.url, 2.0, boot_s=0.1), LIMITS, print)
    threads = threading.active_count()
    with pytest.raises(NoAnswerError):
        driver.start()
    assert threading.active_count() == threads
    assert driver.arm() == 'the amplifier is not connected'
