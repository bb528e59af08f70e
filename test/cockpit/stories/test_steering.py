"""The operator arms, steers, stops, and vanishes while steering."""

from __future__ import annotations

import math
import statistics
import time
from typing import Any

import numpy as np
import pytest
from hands import on_page, part

pytestmark = pytest.mark.rig

# A gamepad that tests move: `pad(axes, buttons)` sets it, `pad(null)` unplugs it.
_PAD = """
window.pads = [];
navigator.getGamepads = () => window.pads;
window.pad = (axes, buttons = []) => {
  window.pads = axes === null ? [] : [{ index: 0, connected: true, axes,
    buttons: Array.from({ length: 17 }, (_, n) => ({ pressed: buttons.includes(n) })) }];
};
"""
_HIDE = """(hidden) => {
  Object.defineProperty(document, 'visibilityState',
                        { value: hidden ? 'hidden' : 'visible', configurable: true });
  document.dispatchEvent(new Event('visibilitychange'));
}"""
_BLUR = """(blurred) => {
  document.hasFocus = () => !blurred;
  window.dispatchEvent(new Event(blurred ? 'blur' : 'focus'));
}"""


@pytest.fixture
def teleop(rig: Any, open_page: Any) -> Any:
    """A page before a rig that a hand may steer."""
    rig.told['controller']['name'] = 'teleop'
    page = open_page()
    page.evaluate(_PAD)
    page.wait_for_selector('#stick:enabled')
    return page


def _moving(rig: Any) -> list[tuple[float, float]]:
    return [value for value in rig.asked('stick') if value != (0, 0)]


def _assert_silent(page: Any, rig: Any, ms: float = 400) -> None:
    """Nothing that moves comes for `ms` [ms]."""
    before = len(_moving(rig))
    page.wait_for_timeout(ms)
    assert len(_moving(rig)) == before


def _angle(value: tuple[float, float]) -> float:
    return math.degrees(math.atan2(value[1], value[0]))


# Arming ------------------------------------------------------------------------------------------

def test_holding_arms(page, rig) -> None:
    page.check('#attended')
    page.hover('#arm')
    page.mouse.down()
    page.wait_for_selector('#arm:has-text("Keep holding")')
    began = time.monotonic()
    rig.wait_for('arm')
    assert time.monotonic() - began > 0.8
    page.mouse.up()
    page.wait_for_selector('#rig-chip[data-state=armed]:has-text("attended")')
    page.wait_for_timeout(1200)
    assert len(rig.asked('arm')) == 1


def test_nothing_else_arms(page, rig) -> None:
    page.click('#arm')
    page.focus('#arm')
    for key in ['Enter', 'Space']:
        page.keyboard.down(key)
        page.wait_for_timeout(1300)
        page.keyboard.up(key)
    page.hover('#arm')
    page.mouse.down()
    page.wait_for_timeout(600)
    page.mouse.up()
    page.mouse.down()
    page.wait_for_timeout(600)
    page.evaluate(_BLUR, True)
    page.wait_for_timeout(800)
    page.mouse.up()
    page.reload()
    page.wait_for_selector('body:not(.lost)')
    page.wait_for_timeout(300)
    assert not rig.asked('arm')


def test_a_page_that_stands_still_while_arming_does_not_arm(page, rig) -> None:
    page.hover('#arm')
    page.mouse.down()
    page.wait_for_timeout(100)
    page.evaluate('{ const end = performance.now() + 1300; while (performance.now() < end); }')
    page.mouse.up()
    page.wait_for_timeout(300)
    assert not rig.asked('arm')


def test_why_arming_was_refused_is_shown_word_for_word(page, rig) -> None:
    rig.refusals['arm'] = 'coil 2 does not answer: its cable, or its fuse'
    page.hover('#arm')
    page.mouse.down()
    page.wait_for_selector(f'#messages li:has-text("{rig.refusals["arm"]}")')
    page.mouse.up()
    assert page.get_attribute('#rig-chip', 'data-state') == 'disarmed'


# STOP --------------------------------------------------------------------------------------------

def _click(page: Any) -> None:
    page.click('#stop')


def _escape(page: Any) -> None:
    page.keyboard.press('Escape')


def _escape_from_a_field(page: Any) -> None:
    part(page, 'recording')
    page.focus('#title')
    page.keyboard.press('Escape')


def _enter(page: Any) -> None:
    page.focus('#stop')
    page.keyboard.press('Enter')


def _pad(page: Any) -> None:
    page.evaluate('pad([0, 0], [1])')


@pytest.mark.parametrize('way', [_click, _escape, _escape_from_a_field, _enter, _pad])
def test_stop(teleop, rig, way) -> None:
    teleop.on('dialog', lambda _: pytest.fail('STOP asks'))
    way(teleop)
    rig.wait_for('stop')
    teleop.wait_for_selector('#messages li.ok:has-text("STOP: zero, confirmed by a reading")')
    assert len(rig.asked('stop')) == 1


def test_stop_while_steering_ends_the_steering_too(teleop, rig) -> None:
    teleop.focus('#stick')
    teleop.keyboard.down('ArrowUp')
    rig.wait_for('stick', 3)
    teleop.keyboard.press('Escape')
    rig.wait_for('stop')
    teleop.wait_for_timeout(100)
    assert rig.asked('stick')[-1] == (0, 0)
    _assert_silent(teleop, rig)


def test_stop_works_as_a_viewer_who_can_do_nothing_else(open_page, rig) -> None:
    first, second = open_page(), open_page()
    assert not first.is_disabled('#arm')
    for selector in ['#arm', '#disarm', '#stick', '#controller', '#record', '#discover',
                     '#parameters input']:
        assert second.locator(selector).first.is_disabled(), selector
    second.click('#modes label:has(input[value=goal])')
    second.mouse.click(*on_page(second, 300, 300, 1280))
    second.wait_for_selector('#messages li:has-text("Another page has control")')
    second.keyboard.press('Escape')
    rig.wait_for('stop')
    assert not rig.asked('goal')


def test_stop_goes_on_until_the_zero_is_confirmed(page, rig) -> None:
    rig.refusals['stop'] = 'zero sent, not confirmed'
    page.keyboard.press('Escape')
    rig.wait_for('stop', 3)
    page.wait_for_selector('#stop[data-zero=sent]:has-text("zero sent, not confirmed")')
    rig.refusals['stop'] = 'not reachable: /dev/ttyUSB0'
    page.wait_for_selector('#stop[data-zero=unreachable]:has-text("NOT REACHABLE")')
    page.wait_for_selector('#alarm:has-text("Switch the amplifier off by hand.")')
    rig.told.update(zero='confirmed')  # as a driver says from then on
    del rig.refusals['stop']
    page.wait_for_selector('#stop[data-zero=confirmed]:has-text("confirmed by a reading")')
    page.wait_for_selector('#alarm', state='hidden')
    count = len(rig.asked('stop'))
    page.wait_for_timeout(700)
    assert len(rig.asked('stop')) == count


def test_stop_ends_when_somebody_says_that_the_amplifier_is_off(page, rig) -> None:
    rig.refusals['stop'] = 'not reachable: /dev/ttyUSB0'
    rig.told.update(zero='unreachable')
    page.keyboard.press('Escape')
    rig.wait_for('stop', 2)
    page.click('#alarm-off')
    page.wait_for_timeout(500)
    count = len(rig.asked('stop'))
    page.wait_for_timeout(700)
    assert len(rig.asked('stop')) == count
    assert page.is_hidden('#alarm')


def test_a_driver_that_is_not_reachable_alarms_a_page_that_did_not_stop(page, rig) -> None:
    rig.told.update(rig='fault', zero='unreachable')
    page.wait_for_selector('#alarm:has-text("Switch the amplifier off by hand.")')
    assert not rig.asked('stop')
    rig.told.update(rig='disarmed', zero='confirmed')
    page.wait_for_selector('#alarm', state='hidden')
    page.wait_for_selector('#stop[data-zero=confirmed]')


def test_a_stop_that_is_not_answered_says_so(page, rig) -> None:
    rig.refusals['stop'] = 'the driver does not answer'
    page.click('#stop')
    page.wait_for_selector('#messages li:has-text("the driver does not answer")')
    assert 'Switch the amplifier off by hand' in page.inner_text('#messages')


def test_control_is_taken_at_once(open_page) -> None:
    first, second = open_page(), open_page()
    second.click('#take-control')
    second.wait_for_selector('#arm:enabled')
    first.wait_for_selector('#arm:disabled')
    assert 'another page' in first.inner_text('#fact-control')
    assert second.inner_text('#fact-control').startswith('yours')


# Steering ----------------------------------------------------------------------------------------

@pytest.mark.parametrize(('keys', 'angle'), [
    (['ArrowRight'], 0), (['ArrowUp', 'ArrowRight'], 45), (['KeyW'], 90), (['ArrowLeft'], 180),
    (['KeyS', 'KeyA'], -135)])
def test_keys_steer_where_they_point(teleop, rig, keys, angle) -> None:
    teleop.focus('#stick')
    for key in keys:
        teleop.keyboard.down(key)
    teleop.wait_for_timeout(500)
    for key in keys:
        teleop.keyboard.up(key)
    released = time.monotonic()
    teleop.wait_for_timeout(150)
    value = _moving(rig)[4]  # all keys are down, and none is up yet
    assert abs(_angle(value) - angle) < 1
    assert math.hypot(*value) == pytest.approx(1)
    assert 0.04 < statistics.median(np.diff(rig.times('stick'))) < 0.06
    assert rig.asked('stick')[-1] == (0, 0)
    assert rig.times('stick')[-1] - released < 0.1
    _assert_silent(teleop, rig)


def test_the_stick_steers_by_touch(rig, open_page) -> None:
    rig.told['controller']['name'] = 'teleop'
    page = open_page(has_touch=True, viewport={'width': 820, 'height': 1180})
    page.wait_for_selector('#stick:enabled')
    page.locator('#stick').scroll_into_view_if_needed()
    box = page.locator('#stick').bounding_box()
    x, y = box['x'] + box['width'] / 2, box['y'] + box['height'] / 2
    session = page.context.new_cdp_session(page)

    def touch(kind: str, *points: tuple[float, float]) -> None:
        session.send('Input.dispatchTouchEvent', {
            'type': kind, 'touchPoints': [{'x': x + right, 'y': y - up} for right, up in points]})

    touch('touchStart', (2, 2))
    touch('touchMove', (60 * math.cos(0.6), 60 * math.sin(0.6)))
    page.wait_for_timeout(300)
    assert abs(_angle(_moving(rig)[-1]) - math.degrees(0.6)) < 5
    assert math.hypot(*_moving(rig)[-1]) == pytest.approx(1)
    touch('touchMove', (20 * math.cos(2), 20 * math.sin(2)))
    page.wait_for_timeout(200)
    assert abs(_angle(_moving(rig)[-1]) - math.degrees(2)) < 5
    assert 0.3 < math.hypot(*_moving(rig)[-1]) < 0.5
    released = time.monotonic()
    touch('touchEnd')
    page.wait_for_timeout(150)
    assert rig.asked('stick')[-1] == (0, 0)
    assert rig.times('stick')[-1] - released < 0.1


def test_a_pad_steers(teleop, rig) -> None:
    teleop.evaluate('pad([0, 0])')
    teleop.wait_for_timeout(120)
    teleop.evaluate('pad([0.3, -0.4])')
    teleop.wait_for_timeout(250)
    assert _moving(rig)[-1] == pytest.approx((0.3, 0.4))
    teleop.evaluate('pad([0.05, 0.1])')
    teleop.wait_for_timeout(150)
    assert rig.asked('stick')[-1] == (0, 0)


def test_a_pad_that_went_must_come_back_to_neutral(teleop, rig) -> None:
    teleop.evaluate('pad([0.5, 0])')  # deflected when it comes
    _assert_silent(teleop, rig)
    teleop.evaluate('pad([0, 0])')
    teleop.wait_for_timeout(120)
    teleop.evaluate('pad([0.5, 0])')
    rig.wait_for('stick', 2)
    teleop.evaluate('pad(null)')
    teleop.wait_for_timeout(150)
    assert rig.asked('stick')[-1] == (0, 0)
    teleop.evaluate('pad([0.5, 0])')
    _assert_silent(teleop, rig)


def test_only_the_controller_that_is_steered_is_sent_sticks(page, rig) -> None:
    page.evaluate(_PAD)
    page.evaluate('pad([0, 0])')
    page.wait_for_timeout(120)
    page.evaluate('pad([0.5, 0])')
    page.wait_for_timeout(300)
    assert page.is_disabled('#stick')
    assert not rig.asked('stick')


# Vanishing ---------------------------------------------------------------------------------------

@pytest.mark.parametrize('away', [_HIDE, _BLUR])
@pytest.mark.parametrize('source', ['keys', 'pad', 'mouse'])
def test_a_page_that_is_not_looked_at_lets_go(teleop, rig, away, source) -> None:
    _press(teleop, source)
    rig.wait_for('stick', 3)
    left = time.monotonic()
    teleop.evaluate(away, True)
    teleop.wait_for_timeout(150)
    assert rig.asked('stick')[-1] == (0, 0)
    assert rig.times('stick')[-1] - left < 0.1
    teleop.evaluate(away, False)
    _assert_silent(teleop, rig)  # still held: that is no new press
    _release(teleop, source)
    teleop.wait_for_timeout(150)
    before = len(_moving(rig))
    _press(teleop, source)
    teleop.wait_for_timeout(250)
    assert len(_moving(rig)) > before
    _release(teleop, source)


def _press(page: Any, source: str) -> None:
    if source == 'keys':
        page.focus('#stick')
        page.keyboard.down('ArrowRight')
    elif source == 'pad':
        page.evaluate('pad([0, 0])')
        page.wait_for_timeout(120)
        page.evaluate('pad([1, 0])')
    else:
        page.locator('#stick').scroll_into_view_if_needed()
        box = page.locator('#stick').bounding_box()
        page.mouse.move(box['x'] + box['width'] - 20, box['y'] + box['height'] / 2)
        page.mouse.down()


def _release(page: Any, source: str) -> None:
    if source == 'keys':
        page.keyboard.up('ArrowRight')
    elif source == 'pad':
        page.evaluate('pad([0, 0])')
    else:
        page.mouse.up()


@pytest.mark.parametrize('source', ['keys', 'pad', 'mouse'])
def test_a_page_that_was_frozen_lets_go(teleop, rig, source) -> None:
    _press(teleop, source)
    rig.wait_for('stick', 3)
    teleop.evaluate('{ const end = performance.now() + 600; while (performance.now() < end); }')
    woke = time.monotonic()
    teleop.wait_for_timeout(300)
    assert not [when for when, value in zip(rig.times('stick'), rig.asked('stick'), strict=True)
                if when > woke + 0.01 and value != (0, 0)]
    assert rig.asked('stick')[-1] == (0, 0)
    _release(teleop, source)


def test_losing_control_lets_go(teleop, rig, open_page) -> None:
    _press(teleop, 'keys')
    rig.wait_for('stick', 3)
    other = open_page()
    other.click('#take-control')
    teleop.wait_for_selector('#stick:disabled')
    other.wait_for_timeout(100)
    _assert_silent(teleop, rig)
