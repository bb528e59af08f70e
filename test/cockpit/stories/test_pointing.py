"""The operator sees particles, and points: goals, paths, examples."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np
import pytest
from hands import draw, mode, on_page, part
from stand_in import HEIGHT, PIXEL_UM, WIDTH

pytestmark = pytest.mark.rig

# Where rings and marks are, in pixels of the camera, and which picture is under them.
_SHOWN = """(layer) => {
  const frame = document.querySelector('#frame').getBoundingClientRect();
  const scale = frame.width / WIDTH;
  const places = [...document.querySelectorAll(`#overlay .${layer} > g`)].map((node) => {
    const { e, f } = node.getCTM();
    return [Number(node.dataset.id ?? -1), e / scale - 0.5, f / scale - 0.5];
  });
  return { stamp: document.querySelector('#picture').dataset.stamp, places };
}""".replace('WIDTH', str(WIDTH))

# The middle of what is dark within 20 pixels of a place, in pixels of the camera.
_DARK = """([x, y]) => {
  const canvas = document.querySelector('#picture');
  const reduced = WIDTH / canvas.width;
  const [left, top] = [Math.round((x - 20) / reduced), Math.round((y - 20) / reduced)];
  const size = Math.round(40 / reduced);
  const { data } = canvas.getContext('2d').getImageData(left, top, size, size);
  let [sum, sumX, sumY] = [0, 0, 0];
  for (let i = 0; i < size * size; i++) {
    const dark = Math.max(120 - data[4 * i], 0);
    sum += dark; sumX += dark * (left + i % size); sumY += dark * (top + Math.floor(i / size));
  }
  return [(sumX / sum + 0.5) * reduced - 0.5, (sumY / sum + 0.5) * reduced - 0.5];
}""".replace('WIDTH', str(WIDTH))


def _on_page(page: Any, x_px: float, y_px: float) -> tuple[float, float]:
    return on_page(page, x_px, y_px, WIDTH)


def _farthest(points: np.ndarray, line: np.ndarray) -> float:
    """How far the farthest of `points` is from a `line` through its corners."""
    a, d = line[:-1], np.diff(line, axis=0)
    share = np.clip(((points[:, None] - a) * d).sum(-1) / (d * d).sum(-1), 0, 1)
    return float(np.linalg.norm(points[:, None] - a - share[..., None] * d, axis=-1)
                 .min(axis=1).max())


def _um(x_px: float, y_px: float) -> tuple[float, float]:
    return (x_px - (WIDTH - 1) / 2) * PIXEL_UM, ((HEIGHT - 1) / 2 - y_px) * PIXEL_UM


def test_another_that_is_chosen_shows_its_own_numbers_at_once(page) -> None:
    part(page, 'estimates')
    page.wait_for_selector('#readings dd:has-text("±")')
    for chosen, speed in ('2', '6.00'), ('1', '5.00'):
        shown = page.evaluate("""(id) => {
          const list = document.querySelector('#particle');
          list.value = id;
          list.dispatchEvent(new Event('change'));
          return document.querySelector('#readings dd').textContent;
        }""", chosen)
        assert shown.startswith(speed)


def test_rings_are_where_the_tracker_found_particles_in_the_picture_shown(page, rig) -> None:
    stamps, deadline = set(), time.monotonic() + 20.0
    while len(stamps) < 8:
        assert time.monotonic() < deadline
        shown = page.evaluate(_SHOWN, 'rings')
        assert len(shown['places']) == 3
        for number, x, y in shown['places']:
            assert math.dist((x, y), rig.shown[int(shown['stamp'])][number]) < 2
        stamps.add(shown['stamp'])
        page.wait_for_timeout(90)


def test_the_picture_under_the_rings_is_the_one_of_their_stamp(page) -> None:
    shown, dark = page.evaluate(
        f'(layer) => {{ const shown = ({_SHOWN})(layer);'
        f' return [shown, shown.places.map(([, x, y]) => ({_DARK})([x, y]))]; }}', 'rings')
    for (_, x, y), found in zip(shown['places'], dark, strict=True):
        assert math.dist((x, y), found) < 2


def test_without_a_tracker_pictures_go_on(page, rig) -> None:
    rig.tracker = False
    page.wait_for_timeout(1100)
    before = page.evaluate(_SHOWN, 'rings')['stamp']
    page.wait_for_function('(before) => document.querySelector("#picture").dataset.stamp > before',
                           arg=before)
    page.wait_for_selector('#overlay .rings:not(:has(g))', state='attached')


def test_without_a_camera_particles_are_shown_on_an_empty_ground(rig, open_page) -> None:
    rig.seen_by = None
    page = open_page()
    page.wait_for_selector('#arm:enabled')
    # Its half width is the first of 50, 100, 200, … µm that holds them all.
    place = """() => {
      const width = document.querySelector('#frame').getBoundingClientRect().width;
      const { e, f } = document.querySelector('#overlay [data-id="1"]').getCTM();
      return [document.querySelector('#overlay').dataset.stamp, e / width * 640 - 0.5,
              f / width * 640 - 0.5];
    }"""
    stamp, x, y = page.evaluate(place)
    x_um, y_um = _um(*rig.shown[int(stamp)][1])
    scale = 400 / 319.5 if max(abs(_um(*one)[0]) for shown in rig.shown.values()
                               for one in shown.values()) > 200 else 200 / 319.5
    assert math.dist((x, y), (319.5 + x_um / scale, 239.5 - y_um / scale)) < 1
    assert page.inner_text('#curtain') == 'No picture yet.'


def test_nothing_is_shown_on_a_picture_of_an_unknown_camera(page, rig) -> None:
    rig.told['controller'] = {**rig.told['controller'],
                              'goals': [{'x_um': 20.0, 'y_um': 30.0, 'id': -1}]}
    rig.camera_known = False
    page.reload()
    page.wait_for_selector('#picture[data-stamp]')
    page.wait_for_timeout(400)
    assert page.locator('#overlay .rings g, #overlay .goals g').count() == 0
    assert page.is_hidden('#scale')
    rig.camera_known = True
    page.wait_for_selector('#overlay .rings g', state='attached')
    page.wait_for_timeout(300)  # of the picture shown first the particles are of the next one
    shown = page.evaluate(_SHOWN, 'rings')
    for number, x, y in shown['places']:
        assert math.dist((x, y), rig.shown[int(shown['stamp'])][number]) < 2


def test_an_old_picture_is_said_to_be_old(page, rig) -> None:
    page.wait_for_selector('#curtain', state='hidden')
    rig.pictures = False
    page.wait_for_selector('#curtain:has-text("This one is old")')


def test_a_goal_is_sent_where_it_was_clicked_and_marked_once_it_was_taken(page, rig) -> None:
    mode(page, 'goal')
    page.mouse.click(*_on_page(page, 400, 200))
    x_um, y_um, particle = rig.wait_for('goal')
    assert math.dist((x_um, y_um), _um(400, 200)) < PIXEL_UM
    assert particle is None
    page.wait_for_timeout(300)
    assert page.evaluate(_SHOWN, 'goals')['places'] == []

    rig.told['controller'] = {**rig.told['controller'],
                              'goals': [{'x_um': x_um, 'y_um': y_um, 'id': -1}]}
    page.wait_for_selector('#overlay .goals g')
    (_, x, y), = page.evaluate(_SHOWN, 'goals')['places']
    assert math.dist((x, y), (400, 200)) < 1


_WAY_ENDS = """(ends) => {
  const [, x0, y0, x, y] = document.querySelector('#overlay .way path').getAttribute('d')
    .match(/M([\\d.]+) ([\\d.]+)L([\\d.]+) ([\\d.]+)/).map(Number);
  return [...document.querySelectorAll('#overlay .goals > g')].map((node) => {
    const { e, f } = node.getCTM();
    return Math.hypot(e - x, f - y) < 1;
  });
}"""
"""Of each goal, whether the line from the driven particle ends there."""


@pytest.mark.parametrize(('present', 'ends'), [(None, [True, False, False]),
                                               (2, [False, False, True])])
def test_the_driven_particle_is_joined_to_the_goal_that_it_goes_to(
        page, rig, present, ends) -> None:
    goals = [dict(zip(('x_um', 'y_um'), _um(x, y), strict=True), id=None)
             for x, y in ((200, 200), (300, 400), (600, 300))]
    rig.told['controller'] = {**rig.told['controller'], 'goals': goals, 'driven': [2],
                              'goal': present}
    page.wait_for_selector('#overlay .way path', state='attached')
    assert page.evaluate(_WAY_ENDS) == ends


def test_a_goal_for_the_chosen_particle_only(page, rig) -> None:
    part(page, 'estimates')
    page.select_option('#particle', '2')
    mode(page, 'goal')
    page.check('#goal-only')
    page.mouse.click(*_on_page(page, 640, 300))
    assert rig.wait_for('goal')[2] == 2
    page.click('#clear-goals')
    rig.wait_for('clear_goals')


def test_clicking_a_particle_chooses_it(page) -> None:
    for _ in range(30):  # it moves on while the click is on its way
        shown = page.evaluate(_SHOWN, 'rings')
        x, y = next((x, y) for number, x, y in shown['places'] if number == 1)
        page.mouse.click(*_on_page(page, x, y))
        if page.input_value('#particle') == '1':
            break
    assert page.input_value('#particle') == '1'
    assert page.locator('#overlay .chosen').get_attribute('data-id') == '1'


def test_a_path_is_the_one_that_was_drawn(page, rig) -> None:
    mode(page, 'path')
    angles = np.linspace(0, 1.5 * math.pi, 60)
    drawn = np.column_stack([640 + 250 * np.cos(angles), 480 + 250 * np.sin(angles)])
    draw(page, [_on_page(page, *place) for place in drawn])
    sent = np.array(rig.wait_for('path'))
    expected = np.array([_um(*place) for place in drawn])
    assert _farthest(sent, expected) < 2 * PIXEL_UM
    assert _farthest(expected, sent) < 2 * PIXEL_UM


def test_a_path_of_corners_can_be_taken_back_and_is_sent_when_asked(page, rig) -> None:
    mode(page, 'path')
    corners = [(300, 300), (900, 300), (1000, 100), (900, 700)]
    for place in corners[:3]:
        page.mouse.click(*_on_page(page, *place))
    page.press('#frame', 'Backspace')
    page.mouse.click(*_on_page(page, *corners[3]))
    assert not rig.asked('path')
    page.click('#path-send')
    sent = rig.wait_for('path')
    assert len(sent) == 3
    for place, corner in zip(sent, [corners[0], corners[1], corners[3]], strict=True):
        assert math.dist(place, _um(*corner)) < PIXEL_UM


def test_pointing_by_keyboard(page, rig) -> None:
    page.focus('#modes input:checked')
    page.keyboard.press('ArrowRight')
    assert page.is_checked('#modes input[value=goal]')
    page.focus('#frame')
    for key in ['ArrowRight', 'ArrowRight', 'ArrowUp', 'Shift+ArrowUp', 'Enter']:
        page.keyboard.press(key)
    x_um, y_um, _ = rig.wait_for('goal')
    assert math.dist((x_um, y_um), _um(WIDTH / 2 + 20, HEIGHT / 2 - 11)) < PIXEL_UM


@pytest.mark.parametrize('example', ['like', 'unlike'])
def test_teaching_names_the_place_and_the_picture(page, rig, example) -> None:
    mode(page, example)
    page.fill('#teach-kind', 'small one')
    page.mouse.click(*_on_page(page, 500, 600))
    like, x, y, kind, stamp = rig.wait_for('teach')
    assert like == (example == 'like')
    assert math.dist((x, y), (500, 600)) < 1
    assert kind == 'small_one'
    assert stamp in rig.shown


def test_the_wheel_zooms_about_the_pointer_and_a_drag_moves_the_picture(page, size) -> None:
    # A picture that does not fill its box stays at its middle.
    at = (800, 500) if size[0] > 1100 else (WIDTH / 2, HEIGHT / 2)
    before, width = _on_page(page, *at), page.locator('#frame').bounding_box()['width']
    page.mouse.move(*before)
    for _ in range(5):
        page.mouse.wheel(0, -100)
    page.wait_for_function('(before) => document.querySelector("#frame").clientWidth > 2 * before',
                           arg=width)
    after = _on_page(page, *at)
    assert math.dist(before, after) < 2
    page.mouse.down()
    page.mouse.move(after[0] - 60, after[1] - 30, steps=6)
    page.mouse.up()
    assert math.dist(_on_page(page, *at), (after[0] - 60, after[1] - 30)) < 2
    page.click('#look summary')
    page.click('#zoom-all')
    assert math.dist(_on_page(page, *at), before) < 2


def test_scale_cursor_and_layers(page) -> None:
    page.wait_for_selector('#scale-words:has-text("µm")')
    length = float(page.inner_text('#scale-words').split()[0])
    width = page.locator('#scale-bar').bounding_box()['width']
    scale = page.locator('#frame').bounding_box()['width'] / WIDTH
    assert width == pytest.approx(length / PIXEL_UM * scale, rel=0.02)
    page.mouse.move(*_on_page(page, 700, 300))
    x_um, y_um = _um(700, 300)
    page.wait_for_selector(f'#scale-cursor:has-text("{x_um:.0f}.")')
    told = page.inner_text('#scale-cursor').strip('· µm').split(', ')
    assert [float(one) for one in told] == pytest.approx([x_um, y_um], abs=1.0)
    page.click('#look summary')
    page.click('#layers label:has-text("ids")')
    assert page.locator('#overlay .rings text').first.is_hidden()
    assert page.locator('#overlay .rings .ring').first.is_visible()
