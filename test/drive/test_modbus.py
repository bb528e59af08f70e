"""Modbus frames of the H-bridges: golden bytes and the transcript of a session."""

import math

import pytest

from microbot_ros.drive.amplifier import Zero
from microbot_ros.drive.amplifiers.modbus import codec
from microbot_ros.drive.amplifiers.modbus.driver import ModbusAmplifier
from microbot_ros.drive.errors import NoAnswerError


def crc16(data: bytes) -> bytes:
    """CRC-16/MODBUS bit by bit: reflected 0x8005, initial value FFFF, low byte first."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc >> 1) ^ (0xA001 if crc & 1 else 0)
    return crc.to_bytes(2, 'little')


def frame(text: str) -> bytes:
    body = bytes.fromhex(text)
    return body + crc16(body)


def test_golden_bytes():
    assert codec.read(1, codec.CURRENT_MA) == bytes.fromhex('01030005 0001940b')
    assert codec.write(2, codec.DUTY_PERCENT, -50) == frame('02 06 0001 ffce')
    assert ModbusAmplifier.gap_s >= 0.00175  # above 19,200 Bd (Modbus over serial line, 2.5.1.1)


@pytest.mark.parametrize(('duty', 'percent'), [(1.0, 100), (-1.0, -100), (0.254, 25), (0.0, 0)])
def test_duties_are_whole_percents(duty, percent):
    assert codec.duty_percent(duty) == percent


@pytest.mark.parametrize('duty', [math.nan, math.inf, -math.inf, 1.001, -1.001])
def test_a_duty_outside_is_refused(duty):
    with pytest.raises(ValueError, match='duty'):
        codec.duty_percent(duty)


def test_an_answer_passes_whole_undamaged_and_from_the_slave_asked_only():
    whole = frame('01 03 02 fa24')
    assert codec.values(1, 1, whole) == (-1500,)
    for length in range(len(whole)):
        assert codec.values(1, 1, whole[:length]) is None
    for bit in range(8 * len(whole)):
        damaged = bytearray(whole)
        damaged[bit // 8] ^= 1 << bit % 8
        assert codec.values(1, 1, bytes(damaged)) is None
    for other in (frame('02 03 02 fa24'), frame('01 83 02'), frame('01 03 04 fa24 0000'),
                  frame('01 06 0001 ffce'), whole + b'\0'):
        assert codec.values(1, 1, other) is None


def test_a_write_is_confirmed_by_its_echo_only():
    request = codec.write(1, codec.DUTY_PERCENT, 50)
    assert codec.written(1, request, request) is True
    for other in (request[:-1], frame('01 06 0001 0033'), frame('02 06 0001 0032'), b''):
        assert codec.written(1, request, other) is None


def setting(register: str, *values: str) -> list[tuple[str, bytes, bytes]]:
    frames = [frame(f'0{slave} 06 {register} {value}') for slave, value in enumerate(values, 1)]
    return [('line', request, request) for request in frames]


def measuring(*values: str) -> list[tuple[str, bytes, bytes]]:
    return [('line', frame(f'0{slave} 03 0005 0001'), frame(f'0{slave} 03 02 {value}'))
            for slave, value in enumerate(values, 1)]


ZERO = ('0000',) * 4
IDENTIFYING = [*setting('0001', *ZERO), *setting('0000', *('0001',) * 4)]


def inspecting(*values: str) -> list[tuple[str, bytes, bytes]]:
    return [('line', frame(f'0{slave} 03 0007 0004'), frame(f'0{slave} 03 08 {value}'))
            for slave, value in enumerate(values, 1)]


BROADCAST = ('line', frame('00 06 0001 0000'), b'')
ZEROING = [BROADCAST, *setting('0001', *ZERO), *measuring(*ZERO)]
COOL, HOT = '0dac 0dac 2134 0dac', '0dac 0dac 0dac 2135'


def test_a_bridge_that_is_too_hot_says_so(scripted):
    scripted([*IDENTIFYING, *inspecting(COOL, HOT, COOL, COOL), *ZEROING])
    amplifier = ModbusAmplifier('line', 2.0)
    amplifier.connect()
    assert amplifier.fault == 'slave 2 is too hot: 85.01 °C, at most 85'


def test_the_transcript_of_a_session(scripted):
    scripted([
        *IDENTIFYING, *inspecting(*(COOL,) * 4), *ZEROING,
        *setting('0001', '0064', 'ffce', '0000', '0019'),
        *measuring('07d0', 'fc18', '0000', '01f4'),
        BROADCAST, *ZEROING, *setting('0000', *ZERO)])
    amplifier = ModbusAmplifier('line', 2.0)
    amplifier.connect()
    command = amplifier.write([2.0, -1.0, 0.0, 0.504])
    reading, = amplifier.poll(1.0)
    assert reading.currents_A == pytest.approx([2.0, -1.0, 0.0, 0.5])
    assert reading.acknowledges is command
    assert amplifier.close() is Zero.CONFIRMED


def test_an_answer_of_another_slave_is_none(scripted):
    request = frame('01 06 0001 0000')
    # The others are asked all the same.
    scripted([*[('line', request, frame('05 06 0001 0000'))] * 2, *setting('0001', *ZERO)[1:]])
    amplifier = ModbusAmplifier('line', 2.0)
    amplifier.reply_s = 0.01
    amplifier._abort = lambda _: None  # what that says is in test_lines
    with pytest.raises(NoAnswerError, match='slave 1'):
        amplifier.connect()
