"""What emulated devices carry and report where a real one would be at its limit."""

import io
import math

import pytest

from microbot_ros.drive.amplifiers.modbus import codec as modbus
from microbot_ros.drive.amplifiers.roboclaw import codec as roboclaw
from microbot_ros.drive.amplifiers.serial_transfer import codec as serial_transfer
from microbot_ros.drive.emulator.coils import Coils
from microbot_ros.drive.emulator.process import make_device


@pytest.mark.parametrize('watchdog_s', [0.1, None])
def test_a_board_turns_the_field_with_and_without_a_watchdog(watchdog_s):
    now = [0.0]
    coils = Coils(2.0, watchdog_s, io.StringIO(), lambda: now[0])
    board = make_device('serial_transfer', coils)
    turn = serial_transfer.turn([[0] * 4, [0.5, 0, 0, 0], [0, 0.5, 0, 0]], math.tau * 10)
    board.receive(0, serial_transfer.encode(turn, serial_transfer.TURN_ID), 0.0)
    flowed = []
    for k in range(1, 60):
        now[0] = 1e-3 * k
        board.speak(now[0])
        flowed.append(coils.currents_A[0])
    assert min(flowed) == pytest.approx(-1.0, abs=0.01)


def test_registers_hold_no_more_than_they_can():
    coils = Coils(40.0, None, io.StringIO(), lambda: 0.0)
    supply = make_device('modbus', coils)
    supply.receive(0, modbus.write(1, 0, 1), 0.1)
    supply.receive(0, modbus.write(1, 1, 90), 0.2)
    shown = modbus.values(1, 1, supply.receive(0, modbus.read(1, 5), 0.3))
    assert coils.currents_A[0] == pytest.approx(36.0)
    assert 32_767 in shown
    driver = make_device('roboclaw', Coils(400.0, None, io.StringIO(), lambda: 0.0))
    driver.receive(0, roboclaw.drive(0x80, 1.0, 0), 0.1)
    assert driver.receive(0, roboclaw.ask(0x80, roboclaw.GET_CURRENTS), 0.2)
