"""The self-check at every amplifier that there is, and what the devices say of themselves."""

import threading

import pytest

from bench._served import MEASURED
from microbot_ros.drive.amplifier import amplifier_class
from microbot_ros.drive.coil_driver import CoilDriver
from microbot_ros.drive.gate import Limits, Reason

pytestmark = pytest.mark.rig

ZERO = (0.0,) * 4

FULL_SCALE_A = 2.0
LIMITS = Limits(
    current_A=FULL_SCALE_A, step_A=2 * FULL_SCALE_A, slew_A_per_s=1e4, command_timeout_s=0.8,
    deviation_A=0.2, settling_s=0.5, feedback_timeout_s=0.8, rated_current_A=1.5, thermal_s=60.0,
    idle_s=60.0)


@pytest.fixture
def fault():
    return ''


@pytest.fixture
def device(emulate, protocol, fault):
    return emulate(protocol, *(('--fault', fault) if fault else ()))


@pytest.fixture
def driver(device, protocol):
    amplifier = amplifier_class(protocol)(device.url, FULL_SCALE_A)
    # A loaded machine is slower than a device; what gets lost is asked for again after that time.
    amplifier.reply_s, amplifier._boot_s = 0.3, 2.0
    measured = threading.Event()
    driver = CoilDriver(amplifier, LIMITS, lambda _: measured.set(), accept_no_watchdog=True)
    driver.start()
    assert measured.wait(20.0)
    yield driver
    driver.stop()


every_amplifier = pytest.mark.parametrize('protocol', MEASURED)


@every_amplifier
def test_each_coil_gets_one_pulse_before_anything_else(driver, device):
    assert not driver.command([1.0, 0.0, 0.0, 0.0])
    assert driver.arm() is None
    assert driver.gains == pytest.approx([1.0] * 4, abs=0.1)
    flowed = [tuple(entry['currents_A']) for entry in device.entries()
              if any(entry['currents_A'])]
    assert [[abs(current) > 0.1 for current in currents] for currents in flowed] == [
        [coil == pulsed for coil in range(4)] for pulsed in range(4)]
    assert driver.arm() is None
    assert len([1 for entry in device.entries() if any(entry['currents_A'])]) == 4
    assert driver.command([1.0, 0.0, 0.0, 0.0]) is not None


@every_amplifier
@pytest.mark.parametrize(('fault', 'sentence'), [
    ('open=1', 'coil_plus_y is open'), ('reversed=3', 'coil_minus_y is reversed'),
    ('half_gain=4', 'coil_minus_x has a gain of 0.5'),
])
def test_a_coil_that_is_wrong_refuses_arming(driver, device, sentence):
    refusal = driver.arm()
    assert refusal.startswith(f'self-check: {sentence}')
    assert driver.gate.fault.reason is Reason.SELF_CHECK
    assert not driver.gate.armed
    assert driver.gains is None
    assert not driver.command([1.0, 0.0, 0.0, 0.0])
    device.eventually_at(ZERO)


@pytest.mark.parametrize('protocol', sorted({*MEASURED} - {'serial_transfer'}))
def test_a_device_that_is_too_hot_is_a_fault_and_cannot_be_armed(driver, device):
    device.fault('over_temperature')
    found = device.until(lambda: driver.gate.fault)
    assert found.reason is Reason.DEVICE
    assert any(word in found.detail for word in ('hot', 'heat', 'temperature'))
    assert driver.arm() == found.detail


@pytest.mark.parametrize('protocol', ['serial_transfer'])
@pytest.mark.parametrize(('sudden', 'reason'), [
    ('silence', Reason.SILENCE), ('unplug+0.2', Reason.LINE)])
def test_a_check_that_cannot_go_on_ends(driver, device, sudden, reason, monkeypatch):
    go_on = driver._go_on_checking

    def break_off(check, now):
        if len(check.gains) == 1 and check.measured.__name__ == 'measured':
            device.fault(sudden)
            check.measured = lambda *_: None  # the pulse lasts until the line is gone
        go_on(check, now)

    monkeypatch.setattr(driver, '_go_on_checking', break_off)
    assert driver.arm().startswith(reason.value)
    assert driver.gate.fault.reason is reason
    device.eventually_at(ZERO)
