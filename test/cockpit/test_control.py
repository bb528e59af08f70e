"""Who has control, and whether anybody is there, by a clock of our own."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from microbot_ros.cockpit.control import UNATTENDED_S, Control
from microbot_ros.cockpit.steering import Steering


def test_the_first_page_has_control_and_others_look() -> None:
    control = Control()
    control.join(1)
    control.join(2)
    assert (control.holder, control.pages) == (1, 2)
    control.take(2)
    assert control.holder == 2
    control.leave(1)
    assert (control.holder, control.pages) == (2, 1)
    control.leave(2)
    assert (control.holder, control.pages) == (None, 0)


@given(st.lists(st.tuples(st.sampled_from(['join', 'leave', 'take']), st.integers(1, 4))))
def test_whoever_has_control_is_there(steps: list[tuple[str, int]]) -> None:
    control, there = Control(), set()
    for what, page in steps:
        if what == 'join':
            there.add(page)
        elif what == 'leave':
            there.discard(page)
        elif page not in there:
            continue
        getattr(control, what)(page)
        assert control.pages == len(there)
        assert control.holder is None or control.holder in there


@pytest.mark.parametrize(('now_s', 'deserted'), [
    (100.0, False), (100.0 + UNATTENDED_S, False), (100.001 + UNATTENDED_S, True),
    (math.inf, True), (math.nan, True)])
def test_deserted_after_three_seconds_and_whenever_the_clock_says_nothing(
        now_s: float, deserted: bool) -> None:
    control = Control()
    control.join(1)
    control.armed(True, 90.0)
    control.heard(1, 100.0)
    assert control.deserted(now_s) is deserted
    control.armed(False, 90.0)
    assert not control.deserted(now_s)


def test_only_the_page_in_control_is_somebody() -> None:
    control = Control()
    for page in (1, 2):
        control.join(page)
    control.armed(True, 0.0)
    control.heard(2, 2.0)
    assert control.deserted(3.5)
    control.take(2)
    control.heard(2, 3.4)
    assert not control.deserted(3.5)
    control.leave(2)
    control.heard(2, 100.0)
    assert control.deserted(100.0)


class TestSteering:
    """A stick of one page, told with its moments."""

    @pytest.mark.parametrize(('told', 'passed'), [
        # x, y, moment [s], whether the page may steer
        ([(1, 0, 0.0, True), (0, 1, 0.05, True), (0, 0, 0.1, True)], [True, True, True]),
        ([(1, 0, 0.0, True), (1, 0, 0.3, True), (1, 0, 0.35, True)], [True, False, False]),
        ([(1, 0, 0.0, True), (1, 0, 0.3, True), (0, 0, 0.4, True), (1, 0, 9.0, True)],
         [True, False, True, True]),
        ([(1, 0, 0.0, True), (0, 0, 0.05, True), (1, 0, 60.0, True)], [True, True, True]),
        ([(1, 0, 0.0, False), (1, 0, 0.05, True), (0, 0, 0.1, True), (1, 0, 0.15, True)],
         [False, False, True, True]),
        ([(0, 0, 0.0, False)], [False]),
        ([(1, 0, 0.0, True), (1, 0, 0.25, True)], [True, True]),
    ])
    def test_after_a_silence_only_neutral_counts(
            self, told: list[tuple[float, float, float, bool]], passed: list[bool]) -> None:
        stick = Steering()
        assert [stick.counts(*one) for one in told] == passed
