"""The base of polled drivers in a time of its own, which passes only while something waits."""

from collections.abc import Callable

import numpy as np
import pytest

from bench._virtual import VirtualClock
from microbot_ros.drive import polled
from microbot_ros.drive.errors import NoAnswerError

# All times are sums of powers of two, and therefore exact.
ANSWER_S, PERIOD_S, REPLY_S, STRAY_S, INSPECT_S = 1 / 128, 1 / 64, 1 / 32, 1 / 16, 1 / 2
ONE_COIL = (1.0, 0.0, 0.0, 0.0)


class Line:
    """A device that sets and tells one current, and what was said to it when."""

    url = 'line'

    def __init__(self, clock: VirtualClock) -> None:
        self.said: list[tuple[float, bytes]] = []
        self.coming: list[tuple[float, bytes]] = []
        self.silent = False
        self._clock, self._current = clock, b'0'

    def send(self, data: bytes) -> None:
        self.said.append((self._clock.now_s, data))
        if data.startswith(b'set'):
            self._current = data.split()[1]
        elif not self.silent:
            self.coming.append((self._clock.now_s + ANSWER_S, self._current + b'\n'))

    def receive(self, timeout_s: float) -> bytes:
        if self.coming and self.coming[0][0] <= self._clock.now_s + timeout_s:
            at_s, data = self.coming.pop(0)
            self._clock.now_s = max(self._clock.now_s, at_s)
            return data
        self._clock.sleep(timeout_s)
        return b''

    def discard_input(self) -> None:
        self.coming = [one for one in self.coming if one[0] > self._clock.now_s]

    def times_s(self, said: bytes) -> list[float]:
        return [at_s for at_s, data in self.said if data == said]


class Device(polled.PolledAmplifier):
    """What drives it."""

    period_s, reply_s = PERIOD_S, REPLY_S
    channels_per_device = 4

    def _identify(self, device):
        yield from ()

    def _drive(self, device, currents_A):
        yield polled.Exchange(f'set {currents_A[0]:g}'.encode())

    def _measure(self, device):
        answer = yield polled.Exchange(b'tell', parse, 'a current')
        return [answer, 0.0, 0.0, 0.0]

    def _inspect(self, device):
        answer = yield polled.Exchange(b'inspect', parse)
        return f'at {answer:g}'

    def _zeros(self):
        return [b'set 0 at once']


def parse(received: bytes) -> float | None:
    return float(received) if received.endswith(b'\n') else None


@pytest.fixture
def clock(monkeypatch):
    clock = VirtualClock()
    clock.now_s = 0.0
    monkeypatch.setattr(Device, 'clock', clock)
    monkeypatch.setattr(polled, '_STRAY_S', STRAY_S)
    return clock


@pytest.fixture
def line(clock):
    return Line(clock)


@pytest.fixture
def device(line):
    device = Device('line', 2.0)
    device._lines = [line]
    return device


def poll_until(device: Device, true: Callable[[], bool]) -> None:
    while not true():
        device.poll(1.0)


def test_currents_are_asked_for_once_a_period(device, line):
    for _ in range(4):
        reading, = device.poll(1.0)
        assert reading.currents_A.tolist() == [0.0] * 4
    assert line.said == [(count * PERIOD_S, b'tell') for count in range(4)]


def test_a_command_goes_out_at_once_and_once(device, line, clock):
    device.poll(1.0)
    began_s = clock.now_s
    device.write(ONE_COIL)
    for _ in range(4):
        reading, = device.poll(1.0)
        assert reading.currents_A.tolist() == [1.0, 0.0, 0.0, 0.0]
    assert line.times_s(b'set 1') == [began_s]
    assert line.times_s(b'tell') == [0.0, *(began_s + count * PERIOD_S for count in range(4))]


def test_a_reading_is_given_when_it_arrives(device, clock):
    reading, = device.poll(1.0)
    assert reading.t_monotonic_s == clock.now_s == ANSWER_S


def test_what_came_before_the_question_is_no_answer(device, line, clock):
    line.coming.append((clock.now_s, b'7\n'))
    reading, = device.poll(1.0)
    assert reading.currents_A.tolist() == [0.0] * 4


@pytest.mark.parametrize('silent', [True, False])
def test_a_poll_ends_when_it_promised(device, line, clock, silent):
    device.poll(1.0)
    line.silent = silent
    ends_s = clock.now_s + PERIOD_S / 4
    assert device.poll(PERIOD_S / 4) == []
    assert clock.now_s == ends_s
    assert device.poll(PERIOD_S / 2) == []  # with a question under way
    assert clock.now_s == ends_s + PERIOD_S / 2


def test_silence_is_asked_once_more_and_then_an_error(device, line, clock):
    line.silent = True
    with pytest.raises(NoAnswerError, match='a current'):
        device.poll(1.0)
    assert line.said == [(0.0, b'tell'), (REPLY_S, b'tell'), (2 * REPLY_S, b'set 0 at once')]
    assert clock.now_s == 2 * REPLY_S


def test_a_zero_goes_out_at_once_and_again_when_stray_answers_have_come(device, line, clock):
    device.write(ONE_COIL)
    poll_until(device, lambda: clock.now_s > INSPECT_S / 2)
    device.poll(PERIOD_S / 4)
    said, zero_s = len(line.said), clock.now_s
    device.zero()
    assert line.said[said:] == [(zero_s, b'set 0 at once')]
    reading, = device.poll(1.0)
    assert reading.currents_A.tolist() == [0.0] * 4
    again_s = zero_s + STRAY_S
    assert line.said[said + 1:] == [(again_s, b'set 0'), (again_s, b'tell')]


def test_what_is_wrong_is_asked_for_half_a_second_after_the_last_answer(device, clock):
    inspection, answers, asked_s = device._inspect_again(), None, []
    for clock.now_s in np.arange(0.0, 2.25, 1 / 8).tolist():
        question = inspection.send(answers)
        answers = None if question is None else {0: 0.0}  # which comes at the next look
        asked_s += [clock.now_s] if answers else []
    assert asked_s == [0.5, 1.125, 1.75]


def test_what_is_wrong_is_asked_for_between_measurements(device, line, clock):
    poll_until(device, lambda: clock.now_s > 3 * INSPECT_S)
    first_s, second_s = line.times_s(b'inspect')
    assert 0.0 <= first_s - INSPECT_S <= PERIOD_S
    assert 0.0 <= second_s - (first_s + ANSWER_S + INSPECT_S) <= PERIOD_S
    assert device.fault == 'at 0'
