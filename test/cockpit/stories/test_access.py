"""The operator uses the keyboard, a screen reader, a finger, a phone, the dark."""

from __future__ import annotations

import io
from typing import Any

import hands
import pytest
from PIL import Image
from session.recordings import record, small_session

from microbot_ros.cockpit.faults import catalogue

pytestmark = pytest.mark.rig

# What is cut off: words wider than their box or, where nothing scrolls, higher; whatever lies
# outside the window or over STOP.
# After two frames of the browser: the picture follows a change of its box in the next one.
_CUT = """async () => {
  await new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)));
  const stop = document.querySelector('#stop'), red = stop.getBoundingClientRect();
  const end = document.querySelector('#panels').getBoundingClientRect().bottom;
  const answers = document.querySelector('.messages').getBoundingClientRect();
  const cut = [];
  const left = ':not(svg *, option, datalist, .unseen, .modes input)';
  for (const node of document.querySelectorAll(`body *${left}`)) {
    if (!node.checkVisibility()) continue;
    const box = node.getBoundingClientRect();
    // Older answers, for which there is no room, are in a column that is not seen; and long ones
    // stand in whole above the parts.
    if (node.closest('#messages li:not(:first-child)') && box.left >= answers.right) continue;
    if (node.matches('#messages li *')) continue;
    const name = node.id || node.className || node.textContent.slice(0, 30) || node.tagName;
    const note = (what) => cut.push([name, what]);
    const inside = node.closest('#panels') && node.id !== 'panels';
    const bottom = inside ? Math.min(box.bottom, end) : box.bottom;
    if (!node.matches('#messages, .messages') && node.clientWidth
        && node.scrollWidth > node.clientWidth + 1) note('wider than its box');
    if (!node.matches('#panels, #messages, .messages, #messages li') && node.clientHeight
        && node.scrollHeight > node.clientHeight + 2
        && getComputedStyle(node).overflowY !== 'visible') note('higher than its box');
    if (box.left < -1 || box.right > innerWidth + 1) note('outside');
    if (!inside && (box.top < -1 || box.bottom > innerHeight + 1)) note('above or below');
    if (!node.children.length && node.textContent.trim() && !stop.contains(node)
        && box.left < red.right && box.right > red.left
        && box.top < red.bottom && bottom > red.top) note('over STOP');
  }
  return cut;
}"""

# Whatever can be clicked, with the area in which it can: of what is in a label, the label's.
_TARGETS = """() => [...document.querySelectorAll('button, input, select, a, [tabindex], label')]
  .filter((node) => node.checkVisibility() && !node.matches('#panels, label:not(:has(input))')
    && node.getBoundingClientRect().width > 1)
  .map((node) => {
    const box = (node.closest('label') ?? node).getBoundingClientRect();
    return [node.id || node.textContent.trim() || node.tagName, box.width, box.height];
  })"""

# Whether anything can be hit at points around STOP but STOP itself.
_AROUND_STOP = """() => {
  const stop = document.querySelector('#stop');
  const box = stop.getBoundingClientRect();
  const hits = new Set();
  for (let x = box.left - 47; x <= box.right + 47; x += 6) {
    for (let y = box.top - 47; y <= box.bottom + 47; y += 6) {
      const hit = document.elementFromPoint(x, y);
      const found = hit?.closest('button, input, select, a, label, form, .frame, [tabindex="0"]');
      if (found && found !== stop) hits.add(found.id || found.className || found.tagName);
    }
  }
  return [...hits];
}"""


@pytest.fixture
def axe() -> Any:
    """What finds barriers in a page."""
    return pytest.importorskip('axe_playwright_python.sync_playwright').Axe()


def _barriers(axe: Any, page: Any) -> list[str]:
    """Serious and critical ones, one line each."""
    found = axe.run(page).response['violations']
    return [f'{one["id"]}: {node["html"]}' for one in found for node in one['nodes']
            if one['impact'] in ('serious', 'critical')]


@pytest.mark.parametrize('scheme', ['light', 'dark'])
@pytest.mark.parametrize('size', [(1440, 900), (390, 844)])
def test_axe_finds_no_barrier(open_page, rig, axe, scheme) -> None:
    rig.told.update(rig='armed', controller={**rig.told['controller'], 'name': 'teleop'})
    page = open_page(color_scheme=scheme)
    page.wait_for_selector('#rig-chip[data-state=armed]')
    assert _barriers(axe, page) == []
    for mode in ['goal', 'path', 'like']:
        page.click(f'#modes label:has(input[value={mode}])')
        assert _barriers(axe, page) == []
    for tab in page.locator('[role=tab]').all():
        if tab.is_visible():
            tab.click()
            assert _barriers(axe, page) == []


@pytest.mark.parametrize('scheme', ['light', 'dark'])
def test_axe_finds_no_barrier_for_viewers_and_without_a_link(open_page, rig, server, axe,
                                                             scheme) -> None:
    open_page()
    viewer = open_page(color_scheme=scheme)
    rig.told.update(rig='fault', sentence='Coil 2 drew no current for 80 ms.')
    viewer.wait_for_selector('#take-control')
    viewer.wait_for_selector('#rig-chip[data-state=fault]')
    assert _barriers(axe, viewer) == []
    rig.close()
    server.stop()
    viewer.wait_for_selector('body.lost')
    assert _barriers(axe, viewer) == []


@pytest.mark.parametrize('size', hands.SIZES)
def test_targets_are_large_and_stop_stands_alone(open_page, rig, size) -> None:
    rig.told.update(controller={**rig.told['controller'], 'name': 'teleop'})
    page = open_page()
    page.wait_for_selector('#stick:enabled', state='attached')
    stop = page.locator('#stop').bounding_box()
    assert min(stop['width'], stop['height']) >= 96
    assert stop['x'] + stop['width'] > size[0] - 40
    assert stop['y'] + stop['height'] > size[1] - 40
    for mode in ['goal', 'path', 'like']:
        page.click(f'#modes label:has(input[value={mode}])')
        small = [one for one in page.evaluate(_TARGETS) if min(one[1:]) < 43.9]
        assert small == []
    for scroll in [0, 150, 400, 1000, 5000]:
        for box in ['#panels', 'main', 'html']:
            page.evaluate('([box, top]) => { document.querySelector(box).scrollTop = top; }',
                          [box, scroll])
        assert page.evaluate(_AROUND_STOP) == []


def test_everything_that_is_on_is_reached_by_tab_and_seen_to_be(page) -> None:
    wanted = page.evaluate("""() => [...document.querySelectorAll(
      `button:enabled:not([tabindex="-1"]), select:enabled, input:enabled:not([type=radio]),
       #frame`)].filter((node) => node.checkVisibility()).map((node) => {
        node.dataset.wanted = 'yes'; return 1; }).length""")
    reached = set()
    for _ in range(wanted + 5):
        page.keyboard.press('Tab')
        index, outline = page.evaluate("""() => {
          const node = document.activeElement;
          const seen = node.matches('.modes input') ? node.parentElement : node;
          return [[...document.querySelectorAll('[data-wanted]')].indexOf(node),
                  getComputedStyle(seen).outlineStyle];
        }""")
        if index >= 0:
            reached.add(index)
            assert outline == 'solid'
    assert len(reached) == wanted


def test_state_is_told_by_words_and_shapes_not_by_colour_alone(page, rig) -> None:
    said = {}
    for state in ['armed', 'disarmed', 'fault', 'unknown']:
        rig.told = {**rig.told, 'rig': state}
        page.wait_for_selector(f'#rig-chip[data-state={state}]')
        said[state] = page.inner_text('#rig-chip')
        assert state in said[state]
        assert state in page.title()
    assert len({text[0] for text in said.values()}) == 4
    rig.told = {**rig.told, 'health': [{'name': level, 'level': level, 'sentence': '.'}
                                       for level in ['ok', 'warn', 'error', 'stale']]}
    page.wait_for_selector('#health-list li:nth-child(4)', state='attached')
    levels = page.locator('#health-list .level').all_inner_texts()
    assert levels == ['✕ error', '… silent', '! warning', '✓ well']


@pytest.mark.parametrize('size', hands.SIZES)
def test_nothing_is_cut_at_any_size(open_page, rig, size, tmp_path) -> None:
    rig.told.update(rig='fault', sentence='disarmed, measured current deviates (deviation_A, '
                    'settling_ms): (0, 0, 0, 0) A measured, (0.799, 0.1, -0.3, 0.2) A '
                    'commanded; zero, confirmed by a reading', zero='confirmed',
                    fault={'reason': 'measured current deviates', 'detail':
                           '(0, 0, 0, 0) A measured, (0.799, 0.1, -0.3, 0.2) A commanded'},
                    field={'wanted_mT': [-12.93, -10.86], 'applied_mT': [-12.93, -10.86],
                           'measured_mT': [-12.93, -10.86]})
    page = open_page()
    page.wait_for_selector('#rig-chip[data-state=fault]')
    page.wait_for_selector('#arm:enabled', state='attached')
    for tab in page.locator('[role=tab]').all():
        tab.click()
        assert page.evaluate(_CUT) == []
    for mode in ['goal', 'path', 'like']:
        page.click(f'#modes label:has(input[value={mode}])')
        assert page.evaluate(_CUT) == []
    picture, panels = page.locator('#frame').bounding_box(), page.locator('#panels').bounding_box()
    assert picture['height'] >= 150
    assert panels['height'] >= 44
    shot = Image.open(io.BytesIO(page.screenshot(path=tmp_path / 'page.png'))).convert('RGB')
    stop = page.locator('#stop').bounding_box()
    left, middle = stop['x'] + 10, stop['y'] + stop['height'] / 2
    red, green, blue = shot.getpixel((int(left), int(middle)))
    assert red > 150 > 100 > max(green, blue)
    viewer = open_page(has_touch=True, is_mobile=True)  # whose window grows with what is too wide
    viewer.wait_for_selector('#fact-control:has-text("another page’s, 2 pages")')
    assert viewer.evaluate('innerWidth') == size[0]
    assert viewer.evaluate(_CUT) == []


@pytest.mark.parametrize('size', hands.SIZES)
def test_a_long_answer_and_its_advice_are_told_in_whole(open_page, rig) -> None:
    page = open_page()
    page.wait_for_selector('#arm:enabled')
    sentence, (_, cure) = max(
        ((sentence, told) for known in catalogue().values() for sentence, told in known.items()),
        key=lambda one: len(one[0] + one[1][1]))
    rig.refusals['switch_controller'] = sentence.replace('…', '4')
    page.click('#controller-form button')
    page.wait_for_selector('#answer:visible .cure')
    assert page.inner_text('#answer .cure') == f'What to do: {cure.replace("`", "")}'
    assert sentence.replace('…', '4') in page.inner_text('#answer')
    assert page.evaluate(_CUT) == []
    assert page.evaluate('document.querySelector("#panels").scrollTop') == 0
    page.click('#answer-close')
    assert page.is_hidden('#answer')
    page.click('#controller-form button')
    page.wait_for_selector('#answer:visible')
    del rig.refusals['switch_controller']
    page.click('#controller-form button')
    page.wait_for_selector('#answer', state='hidden')


@pytest.mark.parametrize('size', [(820, 1180), (1440, 900)])
def test_each_part_is_one_click_away_at_any_size(open_page) -> None:
    page = open_page()
    assert page.is_visible('#drive')
    page.focus('#tab-drive')
    page.keyboard.press('ArrowLeft')
    assert page.is_visible('#events')
    assert not page.is_visible('#drive')
    for part in ('field', 'estimates', 'recording', 'discovery', 'health'):
        page.click(f'#tab-{part}')
        assert page.is_visible(f'#{part}')


def test_every_fault_of_the_catalogue_is_shown_with_cause_and_cure(page, rig) -> None:
    """As the sentence of a node, in the part Health and in the event log."""
    every = {sentence.replace('…', '4'): cure for known in catalogue().values()
             for sentence, (_, cure) in known.items()
             if not cure.startswith(('See there', 'See the sentence'))}
    assert len(every) > 120
    rig.told = {**rig.told, 'health': [
        {'name': f'node_{n}', 'level': 'error', 'sentence': sentence}
        for n, sentence in enumerate(every)]}
    for part, row in (('health', '#health-list li[data-level=error]'),
                      ('events', '#event-list li.error')):
        page.click(f'#tab-{part}')
        page.wait_for_selector(f'{row}:nth-child({len(every)})')
        without = page.locator(f'{row}:not(:has(.cure))').all_inner_texts()
        assert without == []
        told = page.locator(f'{row} .cure').all_inner_texts()
        assert len(told) == len(every)
        assert all(text.startswith('What to do: ') for text in told)


def test_the_gates_fault_is_named_above_every_part(page, rig) -> None:
    reason, detail = 'measured current deviates', '0 A measured, 0.8 A commanded'
    rig.told.update(rig='fault', zero='confirmed', fault={'reason': reason, 'detail': detail},
                    sentence=f'disarmed, {reason} (deviation_A): {detail}; zero')
    page.wait_for_selector(f'#why b:has-text("{reason}")')
    assert page.inner_text('#why').startswith(f'{reason}. {detail}. Cause: '.split(' Cause')[0])
    assert page.inner_text('#rig-sentence') == f'{reason}; zero, confirmed by a reading'
    assert page.locator('#why .cure').count() == 1


@pytest.mark.parametrize('size', hands.SIZES)
def test_eight_tasks_take_three_clicks_each_at_any_size(open_page, rig, tmp_path) -> None:
    record(tmp_path / 'yesterday', small_session())
    page = open_page()
    page.wait_for_selector('#arm:enabled')
    page.evaluate("""() => { window.presses = 0;
      addEventListener('pointerdown', () => { window.presses += 1; }, true); }""")
    presses = []

    def done() -> None:
        presses.append(page.evaluate('window.presses') - sum(presses))

    box = page.locator('#frame').bounding_box()
    middle = box['x'] + box['width'] / 2, box['y'] + box['height'] / 2
    page.hover('#arm')
    page.mouse.down()
    page.wait_for_selector('#rig-chip[data-state=armed]')
    page.mouse.up()
    done()
    hands.mode(page, 'goal')
    page.mouse.click(*middle)
    rig.wait_for('goal')
    done()
    hands.mode(page, 'path')
    hands.draw(page, [(middle[0] + 3 * k, middle[1]) for k in range(12)])
    rig.wait_for('path')
    done()
    hands.part(page, 'recording')
    page.click('#record')
    page.wait_for_selector('#recording-now:has-text("● Recording")')
    page.click('#note')
    page.keyboard.type('a bubble')
    page.keyboard.press('Enter')
    rig.wait_for('note')
    done()
    page.click('#stop')
    rig.wait_for('stop')
    done()
    hands.part(page, 'recording')
    page.wait_for_selector('#recordings li:has-text("yesterday") a:has-text("Replay")')
    done()
    hands.part(page, 'discovery')
    page.click('#discover')
    page.wait_for_selector('#messages li.refused:has-text("not armed")')
    done()
    rig.told = {**rig.told, 'rig': 'fault', 'sentence': 'disarmed, coil heat: hot; zero'}
    page.wait_for_selector('#why:visible .cure')
    done()
    assert presses == [1, 2, 2, 3, 1, 1, 2, 0]
