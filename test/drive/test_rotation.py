"""Currents that turn: continuous through every change, as fast as they are told, and judged."""

import math
import time
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench._emulator import FULL_SCALE_A, LIMITS, Served, until
from microbot_ros.drive.amplifier import amplifier_class
from microbot_ros.drive.coil_driver import CoilDriver
from microbot_ros.drive.gate import Reason
from microbot_ros.drive.rotation import Rotation, Turning

pytestmark = pytest.mark.rig

SLEW = 200.0
PER_AXIS = np.kron(np.eye(3), [[1.0], [-1.0]])
"""Six coils, a pair an axis."""

units = st.tuples(*[st.floats(-1, 1)] * 3).map(np.array).filter(
    lambda v: np.linalg.norm(v) > 0.1).map(lambda v: v / np.linalg.norm(v))


def turning(axis, rate, start=(1.0, 0.0, 0.0), strength=0.5, steady=0.0):
    return Turning(np.full(6, steady), strength * PER_AXIS, np.array(axis, float), rate,
                   np.array(start, float))


def vector(currents):
    return (currents[::2] - currents[1::2]) / 2


@given(axis=units, start=units, rate=st.floats(-300, 300))
def test_what_turns_keeps_its_strength_lies_across_and_turns_as_fast_as_told(axis, start, rate):
    rotation = Rotation(SLEW)
    order = turning(axis, rate, start)
    rotation.follow(order, 0.0, np.zeros(6))
    settled = [vector(rotation.currents(t)) for t in (1.0, 1.001)]  # the jump is made up for
    for field in settled:
        assert np.linalg.norm(field) == pytest.approx(0.5, rel=1e-9)
        assert field @ axis == pytest.approx(0.0, abs=1e-9)
    turned = math.atan2(np.cross(*settled) @ axis, settled[0] @ settled[1])
    assert turned == pytest.approx(rate * 0.001, abs=1e-6)


@given(data=st.data())
def test_no_change_of_axis_rate_or_strength_makes_a_jump(data):
    rotation, now = Rotation(SLEW), 0.0
    flowing = np.zeros(6)
    for _ in range(5):
        rate, strength = data.draw(st.floats(-250, 250)), data.draw(st.floats(0, 1))
        rotation.follow(turning(data.draw(units), rate, data.draw(units), strength), now, flowing)
        for _ in range(10):
            now += 0.001
            sample = rotation.currents(now)
            fastest = SLEW + strength * abs(rate)  # what makes up, and what turns
            assert np.all(np.abs(sample - flowing) <= 0.001 * fastest + 1e-9)
            flowing = sample


def test_the_phase_goes_on_where_the_axis_is_the_same():
    rotation = Rotation(SLEW)
    rotation.follow(turning((0, 0, 1), 10.0), 0.0, turning((0, 0, 1), 10.0).at((1, 0, 0)))
    for k in range(1, 101):  # ordered anew a hundred times, always with the same start
        rotation.follow(turning((0, 0, 1), 10.0), 0.01 * k, rotation.currents(0.01 * k))
    assert vector(rotation.currents(1.0)) == pytest.approx(
        [0.5 * math.cos(10), 0.5 * math.sin(10), 0], abs=1e-9)


def test_backwards_it_comes_back_the_way_it_went():
    rotation = Rotation(SLEW)
    rotation.follow(turning((0, 0, 1), 2.0), 0.0, turning((0, 0, 1), 2.0).at((1, 0, 0)))
    rotation.currents(0.4)
    rotation.follow(turning((0, 0, -1), 2.0), 0.4, rotation.currents(0.4))
    assert vector(rotation.currents(0.8)) == pytest.approx([0.5, 0, 0], abs=1e-9)


def test_an_axis_along_what_turned_takes_anything_across():
    rotation = Rotation(SLEW)
    rotation.follow(turning((1, 0, 0), 5.0, start=(1, 0, 0)), 0.0, np.zeros(6))
    field = vector(rotation.currents(1.0))
    assert np.linalg.norm(field) == pytest.approx(0.5)
    assert field[0] == pytest.approx(0.0, abs=1e-12)


@pytest.fixture(params=['driver', 'board'])
def rig(tmp_path, request):
    """A driver of six coils, and its device; the driver sends samples, or the board makes them."""
    device = Served(tmp_path, channels=6)
    amplifier = amplifier_class('serial_transfer')(device.url, FULL_SCALE_A, 6, baud=1_000_000)
    amplifier.swings = request.param == 'board'
    told = []
    driver = CoilDriver(amplifier, LIMITS, told.append, self_check=True,
                        names=[f'coil_{k}' for k in range(6)])
    driver.start()
    until(lambda: driver.arm() is None)
    driver.command([0.0] * 6)
    del device.flowed[:-1]
    yield driver, device, told
    driver.stop()
    device.end()


def test_the_driver_turns_the_field_and_ends_at_zero(rig):
    driver, device, told = rig
    del told[:]
    assert driver.turn(turning((0, 1, 0), math.tau * 5), 'exposure')
    began = time.monotonic()
    until(lambda: len(device.flowed) > 300)
    assert time.monotonic() - began > 0.8 * 300 * driver.amplifier.sample_s  # none in a queue
    sent = driver.amplifier.counters.frames_sent
    assert sent < 100 if driver.amplifier.swings else sent > 300
    flowed = np.array(device.flowed[100:300])
    assert np.abs(flowed[:, 2:4]).max() < 0.02  # nothing along the axis
    assert np.hypot(*vector(flowed.T)[[0, 2]]) == pytest.approx(0.5, abs=0.02)
    acknowledged = [one for one in told if one.acknowledges and one.acknowledges.tag]
    assert [one.acknowledges.tag for one in acknowledged] == ['exposure']
    driver.disarm()
    device.eventually((0.0,) * 6)


@pytest.mark.parametrize(('axis', 'strength'), [
    ((math.nan, 0, 1), 0.5), ((0, 0, math.inf), 0.5), ((0, 0, 1), math.nan),
    ((0, 0, 1), math.inf), ((0, 0, 1), 2 * FULL_SCALE_A)])
def test_what_cannot_be_affirmed_is_zero(rig, axis, strength):
    driver, device, _ = rig
    with np.errstate(invalid='ignore'):
        driver.turn(turning(axis, 30.0, strength=strength))
    assert until(lambda: driver.gate.fault).reason in (Reason.MALFORMED, Reason.LIMIT)
    device.eventually((0.0,) * 6)


def test_turning_coils_are_judged_by_what_flows_not_by_the_mean(rig):
    driver, device, _ = rig
    driver.gate.limits = replace(LIMITS, rated_current_A=0.1, thermal_s=0.5)
    driver.turn(turning((0, 0, 1), math.tau * 5))  # 0.35 A effective, and 0 in the mean
    assert until(lambda: driver.gate.fault).reason is Reason.HEAT
    device.eventually((0.0,) * 6)
