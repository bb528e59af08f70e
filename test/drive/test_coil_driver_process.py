"""What of the driver of the coils is true of real processes alone.

The rest is in `test_coil_driver.py`, on virtual time.
"""

import glob
import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace

import pytest

from bench import _emulator as emulated
from bench._emulator import FULL_SCALE_A, until
from microbot_ros.drive.amplifier import Zero
from microbot_ros.drive.amplifiers.serial_transfer.driver import SerialTransferAmplifier
from microbot_ros.drive.coil_driver import CoilDriver

pytestmark = pytest.mark.rig

LIMITS = replace(emulated.LIMITS, command_timeout_s=0.8, deviation_A=0.1, settling_s=0.5,
                 feedback_timeout_s=0.8, rated_current_A=1.5)
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


def drive(driver, board):
    until(lambda: driver.arm() is None)
    driver.command([0.0] * 4)
    assert driver.command(DRIVING)
    board.eventually(DRIVING)


def command_until_fault(driver):
    while driver.gate.fault is None:
        driver.command(DRIVING)
        threading.Event().wait(0.02)
    return driver.gate.fault


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
