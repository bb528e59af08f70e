"""What of the driver of the coils is true of its real thread alone, at a port in this process."""

import os
import threading
import time

import pytest

from bench._emulator import until
from microbot_ros.common.patience import PATIENCE
from microbot_ros.drive.amplifier import Zero

pytestmark = pytest.mark.rig

ZERO = (0.0,) * 4
DRIVING = (1.0, -1.0, 0.5, 0.2)


def drive(driver, device):
    until(lambda: driver.arm() is None)
    driver.command(ZERO)
    assert driver.command(DRIVING)
    device.eventually(DRIVING)


def test_the_thread_goes_first_where_the_system_grants_it(driver, device, real_time):
    drive(driver, device)
    thread = next(t for t in threading.enumerate() if t.name == 'coil driver')
    policy = os.sched_getscheduler(thread.native_id)
    assert driver.real_time == real_time == (policy == os.SCHED_FIFO)


def test_the_thread_alone_writes(driver, device, monkeypatch):
    writers = set()
    write = driver.amplifier.write

    def watched(currents, *more):
        writers.add(threading.current_thread().name)
        return write(currents, *more)

    monkeypatch.setattr(driver.amplifier, 'write', watched)
    drive(driver, device)
    driver.disarm()
    device.eventually(ZERO)
    assert writers == {'coil driver'}


def test_disarming_waits_until_it_was_done(driver, device, monkeypatch, patience):
    patience(disarming_s=5.0)
    drive(driver, device)
    request, held = driver._request, []
    monkeypatch.setattr(driver, '_request', held.append)
    disarming = threading.Thread(target=driver.disarm, daemon=True)
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
    assert time.monotonic() - begin < 20 * PATIENCE.disarming_s / 2


def test_a_check_without_an_answer_is_given_up(drivers, patience):
    patience(arming_s=0.2)
    driver = drivers(self_check=True)
    driver._go_on_checking = lambda *_: None
    until(lambda: driver.gate._measured_s > 0)
    assert driver.arm() == 'the coil driver did not answer within 0.2 s'
    until(lambda: not driver.gate.armed)


def test_a_driver_that_starts_again_drives_again(driver, device):
    drive(driver, device)
    assert driver.stop() is Zero.CONFIRMED
    assert not [one for one in threading.enumerate() if one.name == 'coil driver']
    until(lambda: not device.lines[0].present)
    assert not driver.gate.armed
    driver.start()
    assert driver._thread.daemon  # a process that ends without stopping it is not held up
    drive(driver, device)


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


@pytest.mark.parametrize(('protocol', 'accepted', 'watched'), [
    ('serial_transfer', True, True), ('serial_transfer', False, False), ('roboclaw', True, False)])
def test_only_what_has_no_watchdog_is_watched(drivers, accepted, watched):
    driver = drivers(self_check=True, accept_no_watchdog=accepted)
    assert (driver._last_resort is not None) == watched
