"""The operator uses the keyboard, a screen reader, a finger, a phone, the dark."""

from __future__ import annotations

from typing import Any

import pytest

pytestmark = pytest.mark.rig

_SIZES = [(1440, 900), (1920, 1080), (1100, 700), (1024, 768), (820, 1180), (390, 844), (844, 390)]

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
def test_axe_finds_no_barrier(open_page, rig, axe, scheme, size) -> None:
    rig.told.update(rig='armed', controller={**rig.told['controller'], 'name': 'teleop'})
    page = open_page(color_scheme=scheme, viewport={'width': size[0], 'height': size[1]})
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


@pytest.mark.parametrize('size', _SIZES)
def test_targets_are_large_and_stop_stands_alone(open_page, rig, size) -> None:
    rig.told.update(controller={**rig.told['controller'], 'name': 'teleop'})
    page = open_page(viewport={'width': size[0], 'height': size[1]})
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
      'button:enabled, select:enabled, input:enabled:not([type=radio]), #frame')]
      .filter((node) => node.checkVisibility()).map((node) => {
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


def test_on_narrow_screens_parts_are_tabs_below_the_picture(open_page) -> None:
    page = open_page(viewport={'width': 820, 'height': 1180})
    frame, tabs = page.locator('#frame').bounding_box(), page.locator('#tabs').bounding_box()
    assert frame['y'] + frame['height'] <= tabs['y']
    assert page.is_visible('#drive')
    assert not page.is_visible('#health')
    page.focus('#tab-drive')
    page.keyboard.press('ArrowLeft')
    assert page.is_visible('#health')
    assert not page.is_visible('#drive')
    page.set_viewport_size({'width': 1440, 'height': 900})
    page.wait_for_selector('#drive')
    assert not page.is_visible('#tabs')
