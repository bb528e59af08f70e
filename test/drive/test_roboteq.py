"""Roboteq lines: golden text and the transcript of a session."""

import math

import pytest

from microbot_ros.drive.amplifier import Zero
from microbot_ros.drive.amplifiers.roboteq import codec
from microbot_ros.drive.amplifiers.roboteq.driver import RoboteqAmplifier
from microbot_ros.drive.errors import WrongDeviceError


def test_golden_text():
    assert codec.drive(0.5, -1.0) == b'!G 1 500\r!G 2 -1000\r'


@pytest.mark.parametrize('share', [math.nan, math.inf, -math.inf, 1.001, -1.001])
def test_a_command_outside_is_refused(share):
    for pair in ((share, 0.0), (0.0, share)):
        with pytest.raises(ValueError, match='commands'):
            codec.drive(*pair)


@pytest.mark.parametrize(('answer', 'currents'), [
    (b'A=15:-15\r', (1.5, -1.5)), (b'A=0:0\r', (0.0, 0.0)),
    (b'A=15:-15', None), (b'A=15\r', None), (b'A=15:-15:3\r', None), (b'V=15:-15\r', None),
    (b'A=1.5:2\r', None), (b'A=:2\r', None), (b'+\rA=1:2\r', None), (b'A=1:2\r+\r', None),
    (b'A=\xff1:2\r', None), (b'', None), (b'A=--1:2\r', None),
    (b'A=' + 5000 * b'1' + b':2\r', None),
])
def test_currents_pass_whole_and_alone_only(answer, currents):
    assert codec.currents(answer) == (None if currents is None else pytest.approx(currents))


@pytest.mark.parametrize(('answer', 'faults'), [
    (b'FF=0\r', ()), (b'FF=1\r', ('overheat',)), (b'FF=18\r', ('overvoltage', 'emergency stop')),
    (b'FF=128\r', ()), (b'FF=1', None), (b'FF=-1\r', None), (b'FF=\r', None), (b'', None),
    (b'A=1\r', None), (b'FF=' + 5000 * b'1' + b'\r', None), (b'FF=\xb2\r', None),
])
def test_faults_pass_whole_and_alone_only(answer, faults):
    assert codec.faults(answer) == faults


def test_each_command_must_be_accepted():
    assert codec.accepted(2, b'+\r+\r') is True
    for answer in (b'', b'+\r', b'+\r-\r', b'+\r+', b'+\r+\r+\r'):
        assert codec.accepted(2, answer) is None


def on_both(request: bytes, *answers: bytes) -> list[tuple[str, bytes, bytes]]:
    answers = answers * 2 if len(answers) == 1 else answers
    return [(line, request, answer) for line, answer in zip('ab', answers, strict=True)]


ZEROING = [*on_both(b'!G 1 0\r!G 2 0\r', b'+\r+\r'), *on_both(b'?A\r', b'A=0:0\r')]
INSPECTING = on_both(b'?FF\r', b'FF=0\r')
IDENTIFYING = [*on_both(b'\r^ECHOF 1\r', b'\r^ECHOF 1\r+\r'),
               *on_both(b'?FID\r', b'FID=Roboteq v2.1 SDC2130\r'),
               *ZEROING[:2], *on_both(b'^RWD 100\r', b'+\r'), *on_both(b'~RWD\r', b'RWD=100\r')]


def test_the_transcript_of_a_session(scripted):
    scripted([
        *IDENTIFYING, *INSPECTING, *ZEROING,
        ('a', b'!G 1 1000\r!G 2 -500\r', b'+\r+\r'), ('b', b'!G 1 0\r!G 2 250\r', b'+\r+\r'),
        *on_both(b'?A\r', b'A=20:-10\r', b'A=0:5\r'),
        *on_both(b'\r!G 1 0\r!G 2 0\r', b''), *ZEROING])
    amplifier = RoboteqAmplifier('a,b', 2.0)
    amplifier.connect()
    command = amplifier.write([2.0, -1.0, 0.0, 0.5])
    reading, = amplifier.poll(1.0)
    assert reading.currents_A == pytest.approx([2.0, -1.0, 0.0, 0.5])
    assert reading.acknowledges is command
    assert amplifier.close() is Zero.CONFIRMED


def test_the_device_says_what_is_wrong(scripted):
    scripted([*IDENTIFYING, *on_both(b'?FF\r', b'FF=0\r', b'FF=5\r'), *ZEROING])
    amplifier = RoboteqAmplifier('a,b', 2.0)
    amplifier.connect()
    assert amplifier.fault == 'b: overheat, undervoltage'


def test_another_model_is_refused(scripted):
    scripted([*IDENTIFYING[:2], *on_both(b'?FID\r', b'FID=Sabertooth\r')])
    with pytest.raises(WrongDeviceError, match='Sabertooth'):
        RoboteqAmplifier('a,b', 2.0).connect()


def test_a_watchdog_that_is_not_taken_stops_the_connection(scripted):
    scripted([*IDENTIFYING[:-2], *on_both(b'~RWD\r', b'RWD=1000\r'),
              *on_both(b'\r!G 1 0\r!G 2 0\r', b''), *ZEROING])
    with pytest.raises(WrongDeviceError, match='watchdog of 100 ms'):
        RoboteqAmplifier('a,b', 2.0).connect()
