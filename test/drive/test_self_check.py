"""The self-check over coils of arithmetic."""

import math
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench import _emulator as emulated
from bench._emulator import FULL_SCALE_A
from microbot_ros.common.errors import InputError
from microbot_ros.drive.amplifier import COILS, amplifier_class
from microbot_ros.drive.coil_driver import CoilDriver
from microbot_ros.drive.gate import Limits
from microbot_ros.drive.self_check import SelfCheck

ZERO = (0.0,) * 4

LIMITS = replace(emulated.LIMITS, deviation_A=0.2, settling_s=0.5)
PULSE_A = 3 * LIMITS.deviation_A
RATE_S = 0.02


def run(respond, limits=LIMITS):
    """Reads every 20 ms what `respond(wanted, age of the command)` says; what was commanded."""
    check, now, since, sent = SelfCheck(limits), 0.0, 0.0, [ZERO]
    while not (check.done or check.complaint or now > 60.0):
        now += RATE_S
        check.measured(respond(sent[-1], now - since), now)
        if check.wanted != sent[-1]:
            sent.append(check.wanted)
            since = now
    return check, sent


def conducting(shares):
    return lambda wanted, _: [share * current if current else 0.0
                              for share, current in zip(shares, wanted, strict=True)]


@settings(max_examples=50)
@given(st.lists(st.floats(0.7, 1.3), min_size=4, max_size=4))
def test_coils_that_are_right_pass_one_after_the_other(shares):
    check, sent = run(conducting(shares))
    assert check.done
    assert check.complaint == ''
    assert check.gains == pytest.approx(shares)
    pulses = [tuple(PULSE_A if i == k else 0.0 for i in range(4)) for k in range(4)]
    assert sent == [ZERO, *(one for pulse in pulses for one in (pulse, ZERO))]


@pytest.mark.parametrize('coil', range(4))
@pytest.mark.parametrize(('share', 'sentence'), [
    (0.0, 'is open'), (-1.0, 'is reversed'), (-0.6, 'is reversed'),
    (0.5, 'has the wrong gain, 0.5'), (0.66, 'has the wrong gain, 0.66'),
    (1.34, 'has the wrong gain, 1.3'), (2.0, 'has the wrong gain, 2'),
    (math.nan, 'has the wrong gain, nan'), (math.inf, 'has the wrong gain, inf'),
])
def test_the_coil_that_is_wrong_is_named(coil, share, sentence):
    shares = [1.0] * 4
    shares[coil] = share
    check, sent = run(conducting(shares))
    assert check.complaint.startswith(f'{COILS[coil]} {sentence}')
    assert not check.done
    assert len(check.gains) == coil
    assert len(sent) == 2 * (coil + 1)


EXACT = Limits(**{**vars(LIMITS), 'deviation_A': 0.25})  # a pulse of 0.75 A, all exact in binary
BELOW, ABOVE = -math.inf, math.inf


def pulsed():
    check = SelfCheck(EXACT)
    check.measured(ZERO, 1.0)
    assert check.wanted == (0.75, 0.0, 0.0, 0.0)
    return check


def next_to(value, towards):
    return math.nextafter(value, towards)


@pytest.mark.parametrize('currents', [
    [0.5, 0, 0, 0], [1.0, 0, 0, 0], [0.75, 0.25, 0, -0.25], [0.75, 0, 0.25, 0]])
def test_a_reading_agrees_to_within_the_deviation(currents):
    check = pulsed()
    check.measured(currents, 1.1)
    assert (check.gains, check.wanted) == ([currents[0] / 0.75], ZERO)


@pytest.mark.parametrize(('first', 'sentence'), [
    (-0.25, 'is open'), (0.0, 'is open'), (0.25, 'is open'),
    (next_to(0.25, ABOVE), 'has the wrong gain, 0.33'),
    (next_to(0.5, BELOW), 'has the wrong gain, 0.67')])
def test_a_reading_on_the_way_is_waited_for_as_long_as_settling_takes(first, sentence):
    check = pulsed()
    check.measured([first, 0.25, -0.25, 0], next_to(1.5, BELOW))
    assert (check.complaint, check.gains) == ('', [])
    check.measured([first, 0.25, -0.25, 0], 1.5)
    assert check.complaint.startswith(f'coil_plus_y {sentence}')


@pytest.mark.parametrize(('currents', 'sentence'), [
    ([next_to(-0.25, BELOW), 0, 0, 0], 'is reversed'),
    ([next_to(1.0, ABOVE), 0, 0, 0], 'has the wrong gain, 1.3'),
    ([0.75, next_to(0.25, ABOVE), 0, 0], 'drives coil_plus_x'),
    ([0.0, 0, 0, next_to(-0.25, BELOW)], 'drives coil_minus_x'),
    ([0.75, 0, 0.3, -0.3], 'drives coil_minus_y and coil_minus_x')])
def test_a_reading_that_no_settling_leads_through_is_judged_at_once(currents, sentence):
    check = pulsed()
    check.measured(currents, 1.001)
    assert check.complaint.startswith(f'coil_plus_y {sentence}')


def test_a_slow_line_has_its_own_time_to_bring_the_pulse():
    check = pulsed()
    check.measured(ZERO, 9.0, next_to(1.5, BELOW))
    assert check.complaint == ''
    check.measured(ZERO, 9.0, 1.5)
    assert 'is open' in check.complaint


def watched():
    check = SelfCheck(EXACT, tries_watchdog=True)
    for coil in range(4):
        check.measured(ZERO, 1.0)
        assert not check.silent
        check.measured([0.75 * (index == coil) for index in range(4)], 1.0)
    return check


@pytest.mark.parametrize('currents', [ZERO, [0.25, -0.25, 0.25, -0.25]])
def test_the_last_pulse_is_left_to_the_watchdog(currents):
    check = watched()
    assert (check.silent, check.done) == (True, False)
    assert check.wanted == (0.0, 0.0, 0.0, 0.75)
    check.measured([0, 0, 0, 0.75], 1.1)
    check.measured([0, 0, 0, next_to(0.25, ABOVE)], 1.1)
    assert check.silent
    check.measured(currents, 1.125)
    assert (check.done, check.silent, check.wanted, check.watchdog_s) == (True, False, ZERO, 0.125)
    assert check.complaint == ''


@pytest.mark.parametrize('currents', [
    [0, 0, 0, 0.75], [0, 0, 0, math.nan], [0.26, 0, 0, 0], [0, -0.26, 0, 0]])
def test_current_that_flows_on_is_no_watchdog(currents):
    check = watched()
    check.measured(currents, next_to(1.5, BELOW))
    assert check.complaint == ''
    check.measured(currents, 1.5)
    assert check.complaint.startswith('the amplifier has no watchdog: current still flowed 0.5 s')
    assert not check.done


def test_channels_that_are_swapped_or_joined_are_named():
    swapped, _ = run(lambda wanted, _: [wanted[1], wanted[0], wanted[2], wanted[3]])
    assert 'coil_plus_y drives coil_plus_x: channels are swapped' in swapped.complaint
    joined, _ = run(lambda wanted, _: [wanted[0], wanted[1], wanted[2], wanted[3] + wanted[1]])
    assert 'coil_plus_x drives coil_minus_x' in joined.complaint


def test_a_coil_may_take_its_time_but_not_more():
    def rising(time_constant):
        def respond(wanted, age):
            part = 1 - math.exp(-age / time_constant)
            return [part * current for current in wanted]
        return respond
    assert run(rising(0.1))[0].done
    slow, _ = run(rising(2.0))
    assert 'coil_plus_y has the wrong gain' in slow.complaint or 'is open' in slow.complaint


def test_a_pulse_that_is_repeated_has_its_whole_time_again():
    check, half = SelfCheck(LIMITS), (PULSE_A / 2, 0.0, 0.0, 0.0)
    check.measured(ZERO, 0.0)
    assert any(check.wanted)
    check.repeat(0.4)
    check.measured(half, 0.4 + 0.9 * LIMITS.settling_s)
    assert not check.complaint
    check.measured(half, 0.4 + LIMITS.settling_s)
    assert check.complaint


def test_repeating_while_the_device_is_to_end_the_pulse_gives_it_no_more_time():
    check, now_s = SelfCheck(LIMITS, tries_watchdog=True), 0.0
    while not check.silent:
        now_s += RATE_S
        check.measured(check.wanted, now_s)
    pulsed_s = now_s - RATE_S
    check.repeat(now_s + 0.1)
    check.measured(ZERO, now_s + 0.2)
    assert check.watchdog_s == pytest.approx(now_s + 0.2 - pulsed_s)


def test_a_current_that_stays_holds_the_next_pulse():
    pulsed = []

    def respond(wanted, _):
        pulsed.append(any(wanted) or any(pulsed))
        return [PULSE_A if pulsed[-1] else 0.0, 0.0, 0.0, 0.0]

    check, sent = run(respond)
    assert not check.done
    assert len(sent) == 3


@pytest.mark.parametrize('change', [
    {'deviation_A': 1.0}, {'deviation_A': 0.5, 'step_A': 1.0}, {'current_A': 0.4},
])
def test_limits_without_room_for_a_pulse_are_refused(change):
    limits = Limits(**{**vars(LIMITS), **change})
    with pytest.raises(InputError, match='deviation_A: expected less than half'):
        SelfCheck(limits)
    amplifier = amplifier_class('serial_transfer')('nowhere', FULL_SCALE_A)
    with pytest.raises(InputError, match='self-check'):
        CoilDriver(amplifier, limits, print)
    CoilDriver(amplifier, limits, print, self_check=False, accept_no_watchdog=True)


def test_the_pulse_stays_within_the_limits():
    limits = Limits(**{**vars(LIMITS), 'current_A': 0.5})
    assert SelfCheck(limits).pulse_A == 0.5
