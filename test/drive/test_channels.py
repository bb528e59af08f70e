"""Amplifiers of more and of fewer than four coils, at emulated devices that have as many."""

import math
from dataclasses import replace

import pytest

from bench._emulator import FULL_SCALE_A, LIMITS
from bench._virtual import VirtualAmplifier, VirtualDriver
from microbot_ros.common.errors import InputError
from microbot_ros.drive.amplifier import Zero, amplifier_class
from microbot_ros.drive.emulator.process import DEVICES
from microbot_ros.drive.gate import Gate, Reason

CHANNELS = [(protocol, channels) for protocol in sorted(DEVICES)
            if amplifier_class(protocol).reads_back for channels in (2, 3, 6, 16)
            if not (protocol == 'serial_transfer' and channels > 6)]


@pytest.fixture(params=CHANNELS, ids=lambda case: f'{case[0]}-{case[1]}')
def device(request):
    protocol, channels = request.param
    return VirtualAmplifier(protocol, channels=channels,
                            watchdog_s=0.1 if protocol == 'serial_transfer' else None)


def pattern(channels):
    return tuple(round((-1) ** k * (k + 1) / channels, 1) for k in range(channels))


def test_each_coil_is_driven_and_measured_whatever_their_number(device):
    channels = device.coils.channels
    amplifier = device.amplifier()
    amplifier.connect()
    for currents in (pattern(channels), pattern(channels)[::-1]):
        amplifier.write(currents)
        shown = (reading.currents_A for _ in range(100) for reading in amplifier.poll(0.01))
        assert any(measured == pytest.approx(currents, abs=0.06) for measured in shown)
        assert device.flows(currents)
    assert amplifier.close() is Zero.CONFIRMED
    assert device.flowed[-1] == (0.0,) * channels


@pytest.mark.parametrize('protocol', ['roboclaw', 'roboteq'])
def test_a_spare_channel_is_told_zero(protocol):
    """A coil may hang on it that no command reaches."""
    device, told = VirtualAmplifier(protocol, channels=3), []
    command = device.coils.command

    def remember(wanted_A, *feeds):
        told.append(dict(wanted_A))
        command(wanted_A, *feeds)

    device.coils.command = remember
    amplifier = device.amplifier()
    amplifier.connect()
    amplifier.write(pattern(3))
    shown = (reading.currents_A for _ in range(100) for reading in amplifier.poll(0.01))
    assert any(measured == pytest.approx(pattern(3), abs=0.06) for measured in shown)
    assert {wanted[3] for wanted in told if 3 in wanted} == {0.0}
    assert amplifier.close() is Zero.CONFIRMED


def test_a_driver_checks_drives_and_zeroes_all_of_its_coils(device):
    channels = device.coils.channels
    names = [f'coil_{k}' for k in range(channels)]
    rig = VirtualDriver(device, replace(LIMITS, settling_s=1.0), names=names,
                        accept_no_watchdog=device.protocol in ('modbus', 'scpi'))
    rig.connect()
    rig.drive(pattern(channels))
    assert rig.driver.gains == pytest.approx([1.0] * channels, abs=0.12)  # steps of 0.1 A
    pulsed = {k for flowed in device.flowed for k, current in enumerate(flowed) if current}
    assert pulsed == set(range(channels))
    done = rig.driver.request_zero()
    rig.until(done.is_set)
    rig.until(lambda: device.flows((0.0,) * channels), 0.2)
    assert rig.stop() is Zero.CONFIRMED


def test_a_coil_that_is_open_is_named():
    device = VirtualAmplifier('serial_transfer', channels=6)
    names = ['coil_plus_y', 'coil_plus_x', 'coil_minus_y', 'coil_minus_x', 'coil_plus_z',
             'coil_minus_z']
    rig = VirtualDriver(device, LIMITS, names=names)
    rig.connect()
    rig.turn(0.1)
    device.fault('open=5')
    assert 'coil_plus_z is open' in rig.ask()


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
