"""What is only true of real ports: every amplifier at an emulated device on pseudo-terminals."""

import os
import threading
import time

import pytest

from bench._emulator import FULL_SCALE_A, MEASURED, until
from microbot_ros.drive import sentinel
from microbot_ros.drive.amplifier import Zero
from microbot_ros.drive.errors import PortBusyError, PortLostError

ZERO = (0.0,) * 4
DRIVING = (1.0, -1.0, 0.5, 0.2)

pytestmark = [pytest.mark.rig, pytest.mark.parametrize('protocol', MEASURED)]


def drive(amplifier, device):
    amplifier.connect()
    amplifier.write(DRIVING)
    until(lambda: any(one.currents_A == pytest.approx(DRIVING, abs=0.06)
                      for one in amplifier.poll(0.05)))
    device.eventually(DRIVING)


def test_a_session_over_a_real_terminal(amplifier, device):
    before = len(os.listdir('/proc/self/fd'))
    for _ in range(2):
        drive(amplifier, device)
        other = type(amplifier)(device.url, FULL_SCALE_A)
        with pytest.raises(PortBusyError):
            other.connect()
        assert amplifier.close() is Zero.CONFIRMED
        assert device.flowed[-1] == ZERO
        until(lambda: not any(line.present for line in device.lines))
    assert len(os.listdir('/proc/self/fd')) == before


def test_the_last_words_zero_all_coils_whatever_became_of_their_host(amplifier, device):
    drive(amplifier, device)
    device.coils.feed = lambda: None
    device.coils._deadline_s = float('inf')
    words = amplifier.last_words()
    assert len(words) == len(device.lines)
    sentinel.say(words)
    device.eventually(ZERO)
    assert device.causes[-1] == 'command'


def test_a_line_that_is_pulled_out_is_named_and_the_others_are_zeroed(amplifier, device):
    drive(amplifier, device)
    device.coils.feed = lambda: None
    device.coils._deadline_s = float('inf')
    number = len(device.lines)
    device.fault(f'unplug/{number}')
    with pytest.raises(PortLostError) as lost:
        until(lambda: amplifier.poll(0.01) and amplifier.zero() and None)
    assert lost.value.url == device.url.split(',')[-1]
    assert amplifier.close() is Zero.UNREACHABLE
    per_line = 4 // number
    device.eventually([0.0] * (4 - per_line) + list(device.flowed[-1][4 - per_line:]))


def test_a_waiting_poll_is_woken_by_another_thread(amplifier, device):
    drive(amplifier, device)
    device.fault('silence')
    amplifier.reply_s = 60.0
    until(lambda: not amplifier.poll(0.01))
    returned = threading.Event()

    def wake():
        while not returned.wait(0.05):
            amplifier.wake()

    waking = threading.Thread(target=wake, daemon=True)
    waking.start()
    begin = time.monotonic()
    amplifier.poll(5.0)
    waited_s = time.monotonic() - begin
    returned.set()
    waking.join()
    assert waited_s < 4.0
