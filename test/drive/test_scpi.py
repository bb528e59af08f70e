"""SCPI lines: golden text and the transcript of a session."""

from types import SimpleNamespace

import pytest

from bench._virtual import VirtualAmplifier
from microbot_ros.drive.amplifier import Zero
from microbot_ros.drive.amplifiers.scpi import codec
from microbot_ros.drive.amplifiers.scpi.driver import ScpiAmplifier
from microbot_ros.drive.errors import PortLostError, WrongDeviceError

LINES = ('a', 'b', 'c', 'd')


@pytest.mark.parametrize(('answer', 'value'), [
    (b'2.71E1\n', 27.1), (b'-1.0000E-1\r\n', -0.1), (b'\r\n 0\n', 0.0), (b'+3.\r', 3.0),
    (b'2.71E1', None), (b'', None), (b'nan\n', None), (b'inf\n', None), (b'1E400\n', None),
    (b'1_0\n', None), (b'2.71E1\x80\n', None), (b'1 2\n', None), (b'\n', None),
    (b'1.0\n2.0\n', None), (400 * b'9' + b'\n', None), (b'1.0\r\n', 1.0),
])
def test_numbers_pass_whole_and_finite_only(answer, value):
    assert codec.number(answer) == value


def test_lines_end_at_a_line_feed_and_fit_the_buffer():
    assert codec.line('CURR 1', 'OUTP ON') == b'CURR 1;OUTP ON\n'
    assert len(codec.line('x' * 252)) == 253
    with pytest.raises(ValueError, match='253'):
        codec.line('x' * 253)


@pytest.mark.parametrize(('amperes', 'text'), [
    (0.0, 'CURR 0.0E-9'), (-0.0, 'CURR 0.0E-9'), (-1.25, 'CURR -1.2500E+00'),
    (0.033333, 'CURR 3.3333E-02'),
])
def test_currents_are_written_with_five_digits(amperes, text):
    assert codec.current(amperes) == text


def on_each(request: bytes, *answers: bytes) -> list[tuple[str, bytes, bytes]]:
    answers = answers * 4 if len(answers) == 1 else answers
    return [(line, request, answer) for line, answer in zip(LINES, answers, strict=True)]


def identifying(identity: bytes = b'KEPCO,BOP 20-5,E1,3.05\n') -> list[tuple[str, bytes, bytes]]:
    return [*on_each(b'\x1b', b''), *on_each(b'*IDN?\n', identity)]


def limiting(limit: bytes, taken: bytes) -> list[tuple[str, bytes, bytes]]:
    return [*on_each(b'FUNC:MODE CURR;CURR 0.0E-9;CURR:PROT:LIM ' + limit + b'\n', b''),
            *on_each(b'CURR:PROT:LIM?\n', taken + b'\n')]


CONNECTING = [*identifying(), *limiting(b'2.0000E+00', b'2.00E0'), *on_each(b'OUTP ON\n', b'')]
ZEROING = [*on_each(b'CURR 0.0E-9\n', b''), *on_each(b'MEAS:CURR?\n', b'0.00E0\r\n')]


def test_the_transcript_of_a_session(scripted):
    script = scripted([
        *CONNECTING, *on_each(b'STAT:QUES:COND?\n', b'0\n'), *ZEROING,
        ('a', b'CURR 1.0000E+00\n', b''), ('b', b'CURR -5.0000E-01\n', b''),
        ('c', b'CURR 0.0E-9\n', b''), ('d', b'CURR 2.0000E+00\n', b''),
        *on_each(b'MEAS:CURR?\n', b'1.00E0\n', b'-5.01E-1\n', b'0.00E0\n', b'1.99E0\n'),
        *on_each(b'\x1bCURR 0.0E-9\n', b''), *ZEROING, *on_each(b'OUTP OFF\n', b'')])
    amplifier = ScpiAmplifier('a,b,c,d', 2.0)
    amplifier.connect()
    assert script.opened == [(line, 9600, True) for line in LINES]
    command = amplifier.write([1.0, -0.5, 0.0, 2.0])
    reading, = amplifier.poll(1.0)
    assert reading.currents_A == pytest.approx([1.0, -0.501, 0.0, 1.99])
    assert reading.acknowledges is command
    assert amplifier.close() is Zero.CONFIRMED


@pytest.mark.parametrize(('condition', 'fault'), [
    (0, ''), (3, ''), (8, 'questionable condition 8, over-temperature'),
    (17, 'questionable condition 16, over-temperature'), (1024, 'questionable condition 1024'),
])
def test_the_supply_says_what_is_wrong(scripted, condition, fault):
    answers = [b'0\n', b'0\n', f'{condition}\n'.encode(), b'0\n']
    scripted([*CONNECTING, *on_each(b'STAT:QUES:COND?\n', *answers), *ZEROING])
    amplifier = ScpiAmplifier('a,b,c,d', 2.0)
    amplifier.connect()
    assert amplifier.fault == (fault and f'c: {fault}')


def test_another_maker_is_refused(scripted):
    scripted(identifying(b'HEWLETT-PACKARD,34401A,0,1\n'))
    with pytest.raises(WrongDeviceError, match='HEWLETT'):
        ScpiAmplifier('a,b,c,d', 2.0).connect()


@pytest.mark.parametrize(('full_scale_A', 'limit', 'taken'), [
    (2.0, b'2.0000E+00', b'5.00E0'), (2.0, b'2.0000E+00', b'1.00E0'),
    (0.1, b'1.0000E-01', b'1.50E-1'), (100.0, b'1.0000E+02', b'1.02E2'),
])
def test_a_protection_limit_that_is_not_taken_is_refused(scripted, full_scale_A, limit, taken):
    scripted([*identifying(), *limiting(limit, taken), *on_each(b'\x1bCURR 0.0E-9\n', b''),
              *ZEROING, *on_each(b'OUTP OFF\n', b'')])
    with pytest.raises(WrongDeviceError, match=f'limit of {full_scale_A:g} A'):
        ScpiAmplifier('a,b,c,d', full_scale_A).connect()


@pytest.mark.parametrize('taken', [b'9.90E1', b'1.01E2'])
def test_a_protection_limit_may_be_off_by_one_in_a_hundred(scripted, taken):
    scripted([*identifying(), *limiting(b'1.0000E+02', taken), *on_each(b'OUTP ON\n', b''),
              *on_each(b'STAT:QUES:COND?\n', b'0\n'), *ZEROING])
    ScpiAmplifier('a,b,c,d', 100.0).connect()


def test_a_zero_does_not_queue_behind_what_waits_in_the_line():
    done = {line: [] for line in LINES}
    amplifier = ScpiAmplifier('a,b,c,d', 2.0)
    amplifier._lines = [
        SimpleNamespace(send=calls.append, discard_output=lambda calls=calls: calls.append('all'))
        for calls in done.values()]
    amplifier.write([1.0, 0.0, 0.0, 0.0])
    amplifier.zero()
    assert done == {line: ['all', b'\x1bCURR 0.0E-9\n'] for line in LINES}


def test_no_bit_that_flips_on_the_line_makes_a_current_of_a_zero():
    device = VirtualAmplifier('scpi')
    device.amplifier().connect()
    device.device.receive(0, b'CURR 1.0\n', 0.0)
    assert device.coils.currents_A[0] == 1.0
    zero = ScpiAmplifier.zero_again
    for place in range(len(zero)):
        for bit in range(8):
            damaged = bytearray(zero)
            damaged[place] ^= 1 << bit
            device.device.receive(0, zero + damaged + b'\n', 0.0)
            assert abs(device.coils.currents_A[0]) < 1e-6, damaged


def test_a_zero_is_repeated_while_an_answer_is_awaited():
    device = VirtualAmplifier('scpi')
    amplifier = device.amplifier()
    amplifier.connect()
    amplifier.write([1.0] * 4)
    amplifier.poll(0.1)
    amplifier.zero()
    device.fault('silence')
    for _ in range(7):
        amplifier.poll(0.005)
    assert {line.sent[-1][1] for line in device.lines} == {b'MEAS:CURR?\n'}
    amplifier.zero()
    assert [line.sent[-1][1] for line in device.lines] == [b'CURR 0.0E-9\n'] * 4
    count = [len(line.sent) for line in device.lines]
    device.lines[0].takes = False
    with pytest.raises(PortLostError):
        amplifier.zero()
    assert [len(line.sent) for line in device.lines] == [count[0], *(n + 1 for n in count[1:])]
    assert amplifier.unreachable == (device.urls[0],)
