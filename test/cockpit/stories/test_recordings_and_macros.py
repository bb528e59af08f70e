"""The operator looks for yesterday's recording, and has done again what was done before."""

from __future__ import annotations

import time
from typing import Any

import pytest
from hands import arm, mode, on_page, part
from session.recordings import record, small_session

pytestmark = pytest.mark.rig


def test_a_recording_is_found_replayed_and_downloaded(tmp_path, page) -> None:
    record(tmp_path / 'yesterday', small_session())
    part(page, 'recording')
    row = '#recordings li:has-text("yesterday")'
    assert '00:01 min' in page.inner_text(row)
    with page.expect_popup() as opened:
        page.click(f'{row} a:has-text("Replay")')
    end = time.monotonic() + 60
    while not opened.value.evaluate('document.querySelector("video")?.currentTime > 0.2'):
        assert time.monotonic() < end
        opened.value.wait_for_timeout(100)
    with page.expect_download() as downloaded:
        page.click(f'{row} a:has-text("Download")')
    assert downloaded.value.suggested_filename == 'yesterday_0.mcap'


def _keep(page: Any, name: str) -> None:
    """A goal, a pause of half a second, another controller: kept under a `name`."""
    part(page, 'recording')
    page.fill('#macro-name', name)
    page.click('#macro-keep')
    mode(page, 'goal')
    page.mouse.click(*on_page(page, 500, 400, 1280))
    page.wait_for_selector('#messages li:has-text("Goal at")')
    page.wait_for_timeout(500)
    part(page, 'drive')
    page.select_option('#controller', 'hold')
    page.click('#controller-form button')
    page.wait_for_selector('#messages li:has-text("Switch to hold")')
    part(page, 'recording')
    page.click('#macro-keep')
    page.wait_for_selector('#macro-now:has-text("2 steps kept")')


def test_a_macro_survives_a_reload_and_does_the_same_again(page, rig) -> None:
    _keep(page, 'there')
    page.reload()
    page.wait_for_selector('#arm', state='attached')
    if page.is_visible('#take-control'):
        page.click('#take-control')
    part(page, 'recording')
    rig.heard.clear()
    page.click('#macro-form button[type=submit]')
    page.wait_for_selector('#macro-now:has-text("is done")')
    assert [verb for _, verb, _ in rig.heard] == ['goal', 'switch_controller']
    assert rig.times('switch_controller')[0] - rig.times('goal')[0] > 0.5
    other = page.context.new_page()
    other.goto(page.url)
    assert other.locator('#macro option').all_inner_texts() == ['there']
    page.click('#macro-delete')
    other.wait_for_selector('#macro:not(:has(option))', state='attached')


def test_a_macro_ends_with_stop_with_a_refusal_and_holds_no_arming(page, rig) -> None:
    part(page, 'recording')
    page.fill('#macro-name', 'armed')
    page.click('#macro-keep')
    part(page, 'drive')
    arm(page)
    part(page, 'recording')
    page.click('#macro-keep')
    page.wait_for_selector('#macro-now:has-text("0 steps")')
    _keep(page, 'there')
    rig.heard.clear()
    page.click('#macro-form button[type=submit]')
    rig.wait_for('goal')
    page.keyboard.press('Escape')
    page.wait_for_selector('#macro-now:has-text("ended by STOP")')
    time.sleep(0.5)
    assert [verb for _, verb, _ in rig.heard] == ['goal', 'stop']
    rig.refusals['goal'] = 'no goals today'
    page.click('#macro-form button[type=submit]')
    page.wait_for_selector('#macro-now:has-text("was refused")')
    assert rig.asked('switch_controller') == []
    assert page.locator('#messages li.refused:has-text("no goals today")').count()
