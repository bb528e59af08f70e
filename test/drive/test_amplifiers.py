"""Conventions over all registered amplifiers, each against its emulator on real terminals."""

import math
import os
import signal
import threading
from importlib.metadata import entry_points

import numpy as np
import pytest

from bench._served import MEASURED
from microbot_ros.drive import transport
from microbot_ros.drive.amplifier import Zero, amplifier_class
from microbot_ros.drive.errors import (
    AmplifierError,
    NoAnswerError,
    PortBusyError,
    WrongDeviceError,
)
from microbot_ros.errors import InputError

PROTOCOLS = sorted(
    entry.name for entry in entry_points(group='microbot_ros.amplifiers')
    if amplifier_class(entry.name).reads_back)
WITH_WATCHDOG = {'serial_transfer', 'roboclaw', 'roboteq'}
FULL_SCALE_A = 2.0
DRIVING = [1.0, -0.5, 2.0, 0.2]
ZERO = [0.0] * 4

pytestmark = [pytest.mark.rig, pytest.mark.parametrize('protocol', PROTOCOLS)]


@pytest.fixture
def device(emulate, protocol):
    return emulate(protocol)


@pytest.fixture
def amplifier(device, protocol):
    amplifier = make(protocol, device)
    amplifier.connect()
    yield amplifier
    amplifier.close()


def make(protocol, device, reply_s=0.5):
    """A driver as patient as a loaded machine needs it, or as impatient as silence does."""
    amplifier = amplifier_class(protocol)(device.url, FULL_SCALE_A)
    amplifier.reply_s = amplifier._boot_s = reply_s
    return amplifier


def readings(amplifier, count):
    found = []
    while len(found) < count:
        found += amplifier.poll(1.0)
    return found


def drive(amplifier, device):
    """Currents flow; on a slow line it is polling that brings them out."""
    amplifier.write(DRIVING)
    device.until(lambda: (amplifier.poll(0.005), device.currents())[1] == pytest.approx(
        DRIVING, abs=0.022))


def test_each_has_an_emulator(protocol):
    assert protocol in MEASURED
    assert len(MEASURED) == len(PROTOCOLS)

def test_connecting_leaves_zero(amplifier, device):
    assert readings(amplifier, 1)
    assert {tuple(entry['currents_A']) for entry in device.entries()} == {(0.0,) * 4}


def test_a_command_flows_and_is_acknowledged(amplifier, device):
    for currents in (DRIVING, [-2.0, 2.0, 0.0, -0.2]):
        command = amplifier.write(currents)
        reading = next(reading for _ in range(1000) for reading in amplifier.poll(1.0)
                       if reading.acknowledges)
        assert reading.acknowledges is command
        assert reading.currents_A == pytest.approx(currents, abs=0.06)
        device.eventually_at(currents)


def test_reading_never_moves_current(amplifier, device):
    drive(amplifier, device)
    before = device.entries()
    assert all(np.isfinite(reading.currents_A).all() for reading in readings(amplifier, 4))
    assert [e for e in device.entries() if e['cause'] == 'command'] == [
        e for e in before if e['cause'] == 'command']


def test_closing_zeroes_and_reads_back(amplifier, device):
    drive(amplifier, device)
    assert amplifier.close() is Zero.CONFIRMED
    assert device.currents() == ZERO
    with pytest.raises(NoAnswerError):
        amplifier.poll()
    with pytest.raises(NoAnswerError):
        amplifier.write(ZERO)
    assert amplifier.close() is Zero.UNREACHABLE
    amplifier.connect()


def test_an_answer_that_comes_too_late_hides_no_zero(amplifier, device):
    drive(amplifier, device)
    os.kill(device.process.pid, signal.SIGSTOP)
    going_on = threading.Timer(0.1, os.kill, (device.process.pid, signal.SIGCONT))
    going_on.start()
    amplifier.poll(0.03)  # something is asked, whose answer comes when others are waited for
    confirmed = amplifier.close()
    going_on.join()
    assert confirmed is Zero.CONFIRMED
    assert device.currents() == ZERO


def test_a_current_outside_is_refused_before_any_byte(amplifier, monkeypatch):
    monkeypatch.setattr(transport.Port, 'send', lambda *_: pytest.fail('a byte was written'))
    for value in (math.nan, math.inf, -math.inf, math.nextafter(2.0, 3), -5.0):
        for coil in range(4):
            currents = list(DRIVING)
            currents[coil] = value
            with pytest.raises(ValueError, match='within'):
                amplifier.write(currents)
    for shape in ([], [0.0] * 3, [0.0] * 5, [[0.0] * 4]):
        with pytest.raises(ValueError, match='4 values'):
            amplifier.write(shape)
    monkeypatch.undo()


@pytest.mark.parametrize('full_scale_A', [0.0, -1.0, math.nan, math.inf, [1.0, 1.0, 0.0, 1.0]])
def test_a_full_scale_that_is_none_is_refused(protocol, full_scale_A):
    with pytest.raises(InputError, match='amperes above 0'):
        amplifier_class(protocol)('a,b,c,d', full_scale_A)


def test_another_model_is_refused(device, protocol):
    device.fault('wrong_reply')
    with pytest.raises((WrongDeviceError, NoAnswerError)):
        make(protocol, device, 0.2).connect()
    assert device.currents() == ZERO


def test_silence_is_named(device, protocol):
    device.fault('silence')
    with pytest.raises(NoAnswerError, match='no answer'):
        make(protocol, device, 0.2).connect()


def test_two_drivers_on_one_port_is_an_error(amplifier, device, protocol):
    with pytest.raises(PortBusyError):
        make(protocol, device).connect()
    assert readings(amplifier, 1)


def test_a_host_that_dies_leaves_it_to_the_watchdog(amplifier, device, protocol):
    drive(amplifier, device)
    amplifier._release()
    if protocol in WITH_WATCHDOG:
        device.eventually_at(ZERO, 'watchdog')
    else:
        threading.Event().wait(0.3)
        device.eventually_at(DRIVING)
    amplifier.connect()
    assert device.currents() == ZERO


def test_an_unplugged_line_is_an_error(amplifier, device):
    def use() -> None:
        for _ in range(1000):
            amplifier.write(ZERO)
            amplifier.poll(0.1)

    device.fault('unplug')
    with pytest.raises(AmplifierError):
        use()
    assert amplifier.close() is Zero.UNREACHABLE


@pytest.mark.parametrize('fault', ['open=3', 'over_temperature'])
def test_a_coil_that_does_not_conduct_is_measured(amplifier, device, fault):
    drive(amplifier, device)
    device.fault(fault)
    device.until(lambda: device.currents()[2] == 0.0)
    for _ in range(1000):
        amplifier.write(DRIVING)
        reading = readings(amplifier, 1)[-1]
        if abs(reading.currents_A[2]) < 0.05:
            return
    pytest.fail('the open coil was never seen')


def test_nothing_is_left_open(device, protocol):
    before = len(os.listdir('/proc/self/fd'))
    for _ in range(3):
        amplifier = make(protocol, device)
        amplifier.connect()
        amplifier.close()
    assert len(os.listdir('/proc/self/fd')) == before


def test_an_amplifier_that_nobody_registered_is_refused(protocol):
    with pytest.raises(InputError, match=f'expected one of .*{protocol}'):
        amplifier_class('steam')
