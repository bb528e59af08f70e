"""RoboClaw packets: golden bytes and the transcript of a session."""

import math

import pytest

from microbot_ros.drive.amplifier import Zero
from microbot_ros.drive.amplifiers.roboclaw import codec
from microbot_ros.drive.amplifiers.roboclaw.driver import RoboclawAmplifier
from microbot_ros.drive.errors import NoAnswerError, WrongDeviceError

VERSION = b'USB Roboclaw 2x15a v4.1.34\n\0'


def crc16(data: bytes) -> bytes:
    """The remainder of data · x¹⁶ by x¹⁶ + x¹² + x⁵ + 1, as polynomials."""
    remainder = int.from_bytes(data, 'big') << 16
    while remainder.bit_length() > 16:
        remainder ^= 0x11021 << (remainder.bit_length() - 17)
    return remainder.to_bytes(2, 'big')


def packet(text: str) -> bytes:
    body = bytes.fromhex(text)
    return body + crc16(body)


def answer(question: str, data: bytes) -> tuple[bytes, bytes]:
    asked = bytes.fromhex(question)
    return asked, data + crc16(asked + data)


def test_golden_bytes():
    assert codec.packet(0x80, 0x20, b'\x40\x00') == bytes.fromhex('802040005632')
    assert codec.set_timeout(0x80, 0.5) == bytes.fromhex('800e0548f0')


@pytest.mark.parametrize(('duty', 'steps'), [(1.0, 0x7FFF), (-1.0, -0x7FFF), (0.5, 16384)])
def test_duties_are_signed_big_endian(duty, steps):
    assert codec.drive(0x81, duty, 0.0) == bytes.fromhex('8122') + crc_body(steps)


def crc_body(steps: int) -> bytes:
    data = steps.to_bytes(2, 'big', signed=True) + bytes(2)
    return data + crc16(b'\x81\x22' + data)


@pytest.mark.parametrize('duty', [math.nan, math.inf, -math.inf, 1.001, -1.001])
def test_a_duty_outside_is_refused(duty):
    for pair in ((duty, 0.0), (0.0, duty)):
        with pytest.raises(ValueError, match='duty'):
            codec.drive(0x80, *pair)


@pytest.mark.parametrize(('parse', 'data', 'value'), [
    (codec.timeout, b'\x05', 0.5), (codec.version, VERSION, 'USB Roboclaw 2x15a v4.1.34'),
    (codec.temperature, b'\x01\x5e', 35.0),
    (codec.currents, bytes.fromhex('0096ff6a'), (1.5, -1.5)),
])
def test_an_answer_passes_whole_and_undamaged_only(parse, data, value):
    question = b'\x80\x31'
    whole = codec.answer(question, data)
    assert parse(question, whole) == (value if isinstance(value, str) else pytest.approx(value))
    for length in range(len(whole)):
        assert parse(question, whole[:length]) is None
    for bit in range(8 * len(whole)):
        damaged = bytearray(whole)
        damaged[bit // 8] ^= 1 << bit % 8
        assert parse(question, bytes(damaged)) is None
    assert parse(b'\x81\x31', whole) is None


def connecting(timeout: bytes = b'\x01', temperatures: tuple[str, str] = ('015e', '015e'),
               ) -> list[tuple[str, bytes, bytes]]:
    exchanges = [('line', *answer(address + '15', VERSION)) for address in ('80', '81')]
    for address in ('80', '81'):
        exchanges += [
            ('line', packet(address + '22 0000 0000'), b'\xff'),
            ('line', packet(address + '0e 01'), b'\xff'),
            ('line', *answer(address + '0f', timeout))]
    return [*exchanges, *inspecting(*temperatures), *ZEROING]


def driving(first: str, second: str) -> list[tuple[str, bytes, bytes]]:
    return [('line', packet(f'{address} 22 {duties}'), b'\xff')
            for address, duties in (('80', first), ('81', second))]


def measuring(first: bytes, second: bytes) -> list[tuple[str, bytes, bytes]]:
    return [('line', *answer('80 31', first)), ('line', *answer('81 31', second))]


def inspecting(first: str, second: str) -> list[tuple[str, bytes, bytes]]:
    return [('line', *answer(f'{address} {question}', bytes.fromhex(found)))
            for address, temperature in (('80', first), ('81', second))
            for question, found in (('0f', '01'), ('52', temperature))]


AT_ONCE = ('line', packet('80 22 0000 0000') + packet('81 22 0000 0000'), b'')
ZEROING = [*driving('0000 0000', '0000 0000'), *measuring(bytes(4), bytes(4))]


@pytest.mark.parametrize(('temperatures', 'fault'), [
    (('0352', '0352'), ''),
    (('0353', '0352'), 'controller 0x80 is too hot: 85.1 °C, at most 85'),
    (('0352', '0353'), 'controller 0x81 is too hot: 85.1 °C, at most 85'),
])
def test_a_controller_that_is_too_hot_says_so(scripted, temperatures, fault):
    scripted(connecting(temperatures=temperatures))
    amplifier = RoboclawAmplifier('line', 2.0)
    amplifier.connect()
    assert amplifier.fault == fault


def test_the_transcript_of_a_session(scripted):
    scripted([
        *connecting(),
        *driving('7fff c000', '0000 2000'),
        *measuring(bytes.fromhex('00c8 ff9c'), bytes.fromhex('0000 0032')),
        AT_ONCE, *ZEROING])
    amplifier = RoboclawAmplifier('line', 2.0)
    amplifier.connect()
    command = amplifier.write([2.0, -1.00003, 0.0, 0.5])
    reading, = amplifier.poll(1.0)
    assert reading.currents_A == pytest.approx([2.0, -1.0, 0.0, 0.5])
    assert reading.acknowledges is command
    assert amplifier.close() is Zero.CONFIRMED


def test_a_damaged_answer_is_asked_for_again(scripted):
    question, good = answer('80 31', bytes(4))
    scripted([*connecting(), ('line', question, b'\1' + good[1:]), ('line', question, good),
              ('line', *answer('81 31', bytes(4)))])
    amplifier = RoboclawAmplifier('line', 2.0)
    amplifier.reply_s = 0.01
    amplifier.connect()
    assert len(amplifier.poll(1.0)) == 1
    assert amplifier.counters.crc_errors == 1


def test_the_controller_that_does_not_answer_is_named(scripted):
    question = bytes.fromhex('8115')
    scripted([('line', *answer('8015', VERSION)), *[('line', question, b'')] * 2])
    amplifier = RoboclawAmplifier('line', 2.0)
    amplifier.reply_s = 0.01
    amplifier._abort = lambda _: None
    with pytest.raises(NoAnswerError, match='a version from the controller at 0x81'):
        amplifier.connect()


def test_a_timeout_that_is_not_taken_stops_the_connection(scripted):
    scripted([*connecting(timeout=b'\x00')[:8], AT_ONCE, *ZEROING])
    with pytest.raises(WrongDeviceError, match='timeout'):
        RoboclawAmplifier('line', 2.0).connect()


@pytest.mark.parametrize('timeout', ['00', '02'])
def test_a_controller_whose_timeout_is_not_ours_any_more_was_reset(scripted, timeout):
    found = ('line', *answer('80 0f', bytes.fromhex(timeout)))
    scripted([*connecting()[:8], found, *inspecting('015e', '015e')[2:]])
    amplifier = RoboclawAmplifier('line', 2.0)
    amplifier._abort = lambda _: None  # what that says is in test_lines
    with pytest.raises(NoAnswerError, match=r'0x80 .*it was reset'):
        amplifier.connect()


def test_no_acknowledgement_is_an_error(scripted):
    zero = packet('80 22 0000 0000')
    # The other controller is configured all the same.
    scripted([*connecting()[:2], ('line', zero, b''), ('line', zero, b''), *connecting()[5:8]])
    amplifier = RoboclawAmplifier('line', 2.0)
    amplifier.reply_s = 0.01
    amplifier._abort = lambda _: None  # what that says is in test_lines
    with pytest.raises(NoAnswerError, match='FF'):
        amplifier.connect()
