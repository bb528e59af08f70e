"""The self-check at every amplifier that there is, and what the devices say of themselves."""

import pytest

from bench._virtual import VirtualAmplifier, VirtualDriver
from microbot_ros.drive.amplifier import amplifier_class
from microbot_ros.drive.emulator.process import DEVICES
from microbot_ros.drive.gate import Limits, Reason

ZERO = (0.0,) * 4
FULL_SCALE_A = 2.0
LIMITS = Limits(
    current_A=FULL_SCALE_A, step_A=2 * FULL_SCALE_A, slew_A_per_s=1e4, command_timeout_s=0.8,
    deviation_A=0.2, settling_s=0.5, feedback_timeout_s=0.8, rated_current_A=1.5, thermal_s=60.0,
    idle_s=60.0)
MEASURED = sorted(name for name in DEVICES if amplifier_class(name).reads_back)

every_amplifier = pytest.mark.parametrize('protocol', MEASURED)


@pytest.fixture
def device(protocol):
    return VirtualAmplifier(protocol)


@pytest.fixture
def rig(device):
    rig = VirtualDriver(device, LIMITS, accept_no_watchdog=True)
    rig.connect()
    rig.turn(0.1)  # a measurement, without which arming is refused
    return rig


@every_amplifier
def test_each_coil_gets_one_pulse_before_anything_else(rig, device):
    assert not rig.driver.command([1.0, 0.0, 0.0, 0.0])
    assert rig.ask() is None
    assert rig.driver.gains == pytest.approx([1.0] * 4, abs=0.1)
    flowed = [currents for currents in device.flowed if any(currents)]
    assert [[abs(current) > 0.1 for current in currents] for currents in flowed] == [
        [coil == pulsed for coil in range(4)] for pulsed in range(4)]
    assert rig.ask() is None
    assert len([currents for currents in device.flowed if any(currents)]) == 4
    rig.driver.command(ZERO)
    rig.turn(0.01)
    assert rig.driver.command([1.0, 0.0, 0.0, 0.0])
    rig.until(lambda: device.flows([1.0, 0.0, 0.0, 0.0]))


@every_amplifier
@pytest.mark.parametrize(('fault', 'sentence'), [
    ('open=1', 'coil_plus_y is open'), ('reversed=3', 'coil_minus_y is reversed'),
    ('half_gain=4', 'coil_minus_x has the wrong gain, 0.5'),
])
def test_a_coil_that_is_wrong_refuses_arming(rig, device, fault, sentence):
    device.fault(fault)
    assert rig.ask().startswith(f'self-check: {sentence}')
    assert rig.gate.fault.reason is Reason.SELF_CHECK
    assert not rig.gate.armed
    assert rig.driver.gains is None
    assert not rig.driver.command([1.0, 0.0, 0.0, 0.0])
    rig.until(lambda: device.flows(ZERO), 0.2)


@pytest.mark.parametrize('protocol', sorted({*MEASURED} - {'serial_transfer'}))
def test_a_device_that_is_too_hot_is_a_fault_and_cannot_be_armed(rig, device):
    device.fault('over_temperature')
    found = rig.until(lambda: rig.gate.fault)
    assert found.reason is Reason.DEVICE
    assert any(word in found.detail for word in ('hot', 'heat', 'temperature'))
    assert rig.ask() == found.detail


@every_amplifier
@pytest.mark.parametrize(('sudden', 'reasons'), [
    ('silence', (Reason.SILENCE, Reason.LINE)), ('unplug+0.2', (Reason.LINE,))])
def test_a_check_that_cannot_go_on_ends(rig, device, sudden, reasons):
    device.coils.feed = lambda: None  # no watchdog helps
    device.fault('delay=10')  # so that a pulse lasts
    answer = rig.driver.request_arming(rig.driver.epoch)
    rig.until(lambda: any(device.coils.currents_A))
    device.fault(sudden)
    rig.until(answer.done)
    assert rig.gate.fault.reason in reasons
    assert answer.result().startswith(rig.gate.fault.reason.value)
    rig.until(lambda: device.flows(ZERO), 0.4)
