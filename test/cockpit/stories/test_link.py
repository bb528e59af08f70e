"""The page loses the node, is reloaded, swaps, tunes, records, and asks nobody else."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest
from hands import on_page, part

from microbot_ros.cockpit.discovery import Discovery
from microbot_ros.cockpit.recordings import Recordings
from microbot_ros.cockpit.server import Server

pytestmark = pytest.mark.rig

_LINKED = 'body:not(.lost)'


@pytest.fixture
def second_life(rig: Any, server: Any, tmp_path: Path) -> Any:
    """Ends the server as a killed one ends; `second_life()` then begins another where it was."""
    port = urlsplit(server.address).port
    made = []

    def begin() -> None:
        made.append(Server(
            rig, Discovery('', tmp_path), Recordings(tmp_path), '127.0.0.1', port,
            open_to_all=True))
        made[0].start()

    yield begin
    for one in made:
        rig.close()
        one.stop()


def test_a_lost_node_greys_the_page_and_nothing_is_sent_later(page, rig, server,
                                                              second_life) -> None:
    rig.told['controller']['name'] = 'teleop'
    page.wait_for_selector('#stick:enabled')
    page.focus('#stick')
    page.keyboard.down('ArrowRight')
    rig.wait_for('stick', 3)
    rig.close()
    server.stop()
    gone = time.monotonic()
    page.wait_for_selector('body.lost')
    assert time.monotonic() - gone < 1
    for selector in ['#arm', '#disarm', '#stick', '#record', '#note-add', '#discover',
                     '#controller']:
        assert page.is_disabled(selector), selector
    assert page.inner_text('#rig-chip') == '? unknown'

    page.click('#modes label:has(input[value=goal])')
    page.mouse.click(*on_page(page, 300, 300, 1280))
    page.keyboard.press('Escape')
    page.wait_for_selector('#messages li:has-text("STOP could not be sent")')

    heard = len(rig.heard)
    rig.reopen()
    second_life()
    page.wait_for_selector(_LINKED, timeout=5000)
    page.wait_for_selector('#arm:enabled')
    page.wait_for_timeout(500)
    assert [verb for _, verb, _ in rig.heard[heard:]] == []


def test_a_reload_keeps_what_the_rig_keeps(page, rig) -> None:
    part(page, 'recording')
    page.fill('#title', 'two rollers')
    page.click('#record')
    assert rig.wait_for('record') == (True, 'two rollers')
    page.fill('#note', 'a bubble at the left')
    page.press('#note', 'Enter')
    assert rig.wait_for('note') == 'a bubble at the left'
    page.wait_for_function('() => document.querySelector("#note").value === ""')
    rig.told['recording'] = {'on': True, 'seconds': 75.2, 'lost': 3, 'title': 'two rollers'}
    page.reload()
    page.wait_for_selector('#recording-now:has-text("“two rollers” for 01:15, 3 messages lost")')
    assert page.inner_text('#fact-recording') == '01:15, 3 lost'
    assert page.input_value('#title') == 'two rollers'
    page.click('#record')
    assert rig.wait_for('record', 2)[0] is False


def test_a_note_that_was_refused_is_not_lost(page, rig) -> None:
    rig.refusals['note'] = 'nothing is being recorded'
    part(page, 'recording')
    page.fill('#note', 'a bubble')
    page.click('#note-add')
    page.wait_for_selector('#messages li:has-text("Note: nothing is being recorded")')
    assert page.input_value('#note') == 'a bubble'


def test_a_refused_swap_leaves_the_old_one(page, rig) -> None:
    rig.refusals['switch_controller'] = 'particle 7 is not tracked'
    page.select_option('#controller', 'hold')
    page.click('#controller-form button')
    page.wait_for_selector('#messages li:has-text("Switch to hold: particle 7 is not tracked")')
    assert 'At work: waypoint.' in page.inner_text('#controller-now')
    del rig.refusals['switch_controller']
    page.click('#controller-form button')
    page.wait_for_selector('#controller-now:has-text("At work: hold.")')


_SAID = """addEventListener('DOMContentLoaded', () => {
  window.said = [];
  const about = document.querySelector('#controller-about');
  new MutationObserver(() => window.said.push(about.textContent)).observe(
    about, { childList: true });
});"""


def test_the_list_says_what_the_controller_chosen_there_is_for(page) -> None:
    page.add_init_script(_SAID)
    page.reload()
    page.wait_for_selector('#controller-now:has-text("At work")')
    page.select_option('#controller', 'hold')
    page.wait_for_selector('#controller-about:has-text("Stays where it is.")')
    assert page.evaluate('window.said') == ['Stays where it is.']


def test_parameters_are_as_their_descriptors_say(page, rig) -> None:
    field = page.get_by_label('field [mT]')
    assert (field.get_attribute('min'), field.get_attribute('max')) == ('0.01', '100')
    field.fill('7.5')
    page.wait_for_timeout(300)  # several states have come: what is typed stays
    assert field.input_value() == '7.5'
    assert not rig.asked('set')
    field.press('Enter')
    assert rig.wait_for('set') == ('waypoint.field_mT', 7.5)
    page.click('.all summary')
    fixed = page.locator('.parameter:has-text("slew [mT/s]")')
    assert fixed.locator('input').is_disabled()
    assert not fixed.locator('button').is_visible()
    assert 'Fixed at start-up' in page.locator('.parameter').last.inner_text()
    page.get_by_label('learn').uncheck()
    page.locator('.parameter:has-text("learn") button').click()
    assert rig.wait_for('set', 2) == ('waypoint.learn', False)


def test_a_refused_value_gives_way_to_the_one_in_force(page, rig) -> None:
    rig.refusals['set'] = 'field_mT must be at most 100; received 500'
    field = page.get_by_label('field [mT]')
    field.fill('500')
    field.press('Enter')
    page.wait_for_selector('#messages li:has-text("must be at most 100; received 500")')
    page.wait_for_function('(node) => node.value === "5"', arg=field.element_handle())


def test_heartbeats_come_while_the_page_is_looked_at(open_page) -> None:
    page = open_page()
    sent = []
    page.on('websocket', lambda socket: socket.on(
        'framesent', lambda text: sent.append(text)))
    page.reload()
    page.wait_for_selector(_LINKED)
    page.wait_for_timeout(3200)
    beats = [one for one in sent if '"heartbeat"' in str(one)]
    assert 2 <= len(beats) <= 4
    page.evaluate('Object.defineProperty(document, "visibilityState", { value: "hidden" })')
    page.wait_for_timeout(200)
    before = len([one for one in sent if '"heartbeat"' in str(one)])
    page.wait_for_timeout(2200)
    assert len([one for one in sent if '"heartbeat"' in str(one)]) == before


def test_no_request_leaves_the_origin(browser, server) -> None:
    context = browser.new_context()
    page = context.new_page()
    asked = []
    page.on('request', lambda request: asked.append(request.url))
    page.on('websocket', lambda socket: asked.append(socket.url))
    page.goto(server.address)
    page.wait_for_selector(_LINKED)
    page.wait_for_selector('#picture[data-stamp]')
    own = urlsplit(server.address).netloc
    assert len(asked) > 10
    assert {urlsplit(url).netloc for url in asked if not url.startswith('data:')} == {own}
    context.close()


def test_a_slow_browser_shows_new_pictures_not_old_ones(page) -> None:
    """Six times slower than this machine: what is shown is as old after five seconds as before."""
    page.context.new_cdp_session(page).send('Emulation.setCPUThrottlingRate', {'rate': 6})
    age = 'Date.now() - Number(document.querySelector("#picture").dataset.stamp.slice(0, -6))'

    def median_age() -> float:
        ages = []
        for _ in range(15):
            ages.append(page.evaluate(age))
            page.wait_for_timeout(40)
        return sorted(ages)[len(ages) // 2]

    page.wait_for_timeout(500)
    early = median_age()
    page.wait_for_timeout(3000)
    assert median_age() < 1.5 * early + 50
