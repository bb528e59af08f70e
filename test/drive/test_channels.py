"""Amplifiers of more and of fewer than four coils, at emulated devices that have as many."""

import math
from dataclasses import replace

import pytest

from bench._served import FULL_SCALE_A, LIMITS, MEASURED, Served, until
from microbot_ros.drive.amplifier import Zero, amplifier_class
from microbot_ros.drive.coil_driver import CoilDriver
from microbot_ros.drive.gate import Gate, Reason
from microbot_ros.errors import InputError

pytestmark = pytest.mark.rig

CHANNELS = [(protocol, channels) for protocol in MEASURED for channels in (2, 3, 6, 16)
            if not (protocol == 'serial_transfer' and channels > 6)]


@pytest.fixture(params=CHANNELS, ids=lambda case: f'{case[0]}-{case[1]}')
def served(request, tmp_path):
    protocol, channels = request.param
    made = Served(protocol, tmp_path, 0.1 if protocol == 'serial_transfer' else None, channels)
    yield protocol, channels, made
    made.end()


def patient(amplifier):
    """A loaded machine is slower than a device."""
    amplifier.reply_s, amplifier._boot_s = 0.3, 5.0
    return amplifier


def pattern(channels):
    return tuple(round((-1) ** k * (k + 1) / channels, 1) for k in range(channels))


def test_each_coil_is_driven_and_measured_whatever_their_number(served):
    protocol, channels, device = served
    amplifier = patient(amplifier_class(protocol)(device.url, FULL_SCALE_A, channels))
    amplifier.connect()
    try:
        for currents in (pattern(channels), pattern(channels)[::-1]):
            amplifier.write(currents)
            until(lambda own=currents: any(one.currents_A == pytest.approx(own, abs=0.06)
                                           for one in amplifier.poll(0.05)))
            device.eventually(currents)
    finally:
        assert amplifier.close() is Zero.CONFIRMED
    assert device.flowed[-1] == (0.0,) * channels


def test_a_driver_checks_drives_and_zeroes_all_of_its_coils(served):
    protocol, channels, device = served
    names = [f'coil_{k}' for k in range(channels)]
    driver = CoilDriver(patient(amplifier_class(protocol)(device.url, FULL_SCALE_A, channels)),
                        replace(LIMITS, settling_s=1.0), lambda _: None, names=names,
                        accept_no_watchdog=protocol in ('modbus', 'scpi'))
    driver.start()
    try:
        until(lambda: driver.arm() is None)  # once it has heard what flows
        assert driver.gains == pytest.approx([1.0] * channels, abs=0.12)  # steps of 0.1 A
        pulsed = {k for flowed in device.flowed for k, current in enumerate(flowed) if current}
        assert pulsed == set(range(channels))
        driver.command((0.0,) * channels)
        driver.command(pattern(channels))
        device.eventually(pattern(channels))
        driver.disarm()
        device.eventually((0.0,) * channels)
    finally:
        driver.stop()


def test_a_coil_that_is_open_is_named(tmp_path):
    device = Served('serial_transfer', tmp_path, 0.1, 6)
    names = ['coil_plus_y', 'coil_plus_x', 'coil_minus_y', 'coil_minus_x', 'coil_plus_z',
             'coil_minus_z']
    driver = CoilDriver(amplifier_class('serial_transfer')(device.url, FULL_SCALE_A, 6), LIMITS,
                        lambda _: None, names=names)
    driver.start()
    try:
        device.fault('open=5')
        until(lambda: 'coil_plus_z is open' in (driver.arm() or ''))
    finally:
        driver.stop()
        device.end()


@pytest.mark.parametrize('channels', [0, 7])
def test_more_coils_than_a_board_has_are_refused(channels):
    with pytest.raises(InputError, match='expected 1 to 6 coils'):
        amplifier_class('serial_transfer')('nowhere', FULL_SCALE_A, channels)


@pytest.mark.parametrize('channels', [1, 2, 6, 16])
def test_the_gate_wants_a_finite_number_for_each_coil(channels):
    for wrong in ((0.1,) * (channels + 1), (0.1,) * (channels - 1),
                  (0.1,) * (channels - 1) + (math.nan,), (0.1,) * (channels - 1) + (math.inf,)):
        gate = Gate(LIMITS, channels)
        gate.measured(gate.zero, 0.0)
        assert gate.arm(0.0) is None
        assert gate.command((0.1,) * channels, 0.0) == (0.1,) * channels
        assert gate.command(wrong, 0.0) == (0.0,) * channels
        assert gate.fault.reason is Reason.MALFORMED
