"""Who has control, and whether anybody is there, by a clock of our own."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from microbot_ros.cockpit.control import Control
from microbot_ros.cockpit.steering import Steering


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


def test_only_the_page_in_control_attends_and_only_a_rig_armed_so() -> None:
    control = Control()
    for page in (1, 2):
        control.join(page)
    assert not control.attends(1)
    control.arm(attended=True)
    assert control.attends(1)
    assert not control.attends(2)
    control.take(2)
    assert control.attends(2)
    control.leave(2)
    assert not control.attends(2)
    control.take(1)
    control.arm(attended=False)
    assert not control.attends(1)


def test_a_rig_that_was_armed_and_is_no_more_is_not_attended() -> None:
    control = Control()
    control.join(1)
    control.arm(attended=True)
    control.see(armed=False)  # the answer is there before the news
    assert control.attends(1)
    control.see(armed=True)
    assert control.attends(1)
    control.see(armed=False)
    assert not control.attends(1)


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
