"""The page before a virtual rig of real nodes and a serial line, judged by the amplifier's log."""

from __future__ import annotations

import math
import signal
import time
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import numpy as np
import psutil
import pytest
from cockpit.virtual import VirtualRig
from hands import (
    PIXEL_UM,
    arm,
    draw,
    mode,
    on_page,
    opened,
    part,
    sizes,
    switch,
    take_control,
)

pytestmark = [pytest.mark.rig, pytest.mark.timeout(240)]
STOP_S, VANISHED_S, TOPIC_S = 0.1, 0.4, 0.2
"""Asked for: from STOP, or from letting go, to zero; from a page's end while it steers to zero;
from a click to its topic."""

# Where the rings are, in pixels of the camera, and of which picture.
_RINGS = """() => {
  const scale = document.querySelector('#frame').getBoundingClientRect().width / 640;
  return [document.querySelector('#picture').dataset.stamp,
    [...document.querySelectorAll('#overlay .rings > g')].map((node) => {
      const { e, f } = node.getCTM();
      return [Number(node.dataset.id), e / scale - 0.5, f / scale - 0.5];
    })];
}"""


@pytest.fixture(scope='module', params=sizes(always=1))
def size(request: pytest.FixtureRequest) -> Any:
    """Width and height of the window."""
    return request.param


@pytest.fixture(scope='module')
def virtual(browser: Any, size: Any, tmp_path_factory: pytest.TempPathFactory,
            ) -> Iterator[VirtualRig]:
    """One rig for all stories at a `size`; none without a `browser`."""
    assert browser.is_connected()
    assert size  # a rig for each: what one leaves behind is no other's
    with VirtualRig(tmp_path_factory.mktemp('rig'), coil_driver={
            'command_timeout_ms': 250.0, 'max_command_age_ms': 250.0}) as made:
        yield made


@pytest.fixture
def listener() -> Iterator[Any]:
    """A node of the tests' own."""
    from microbot_ros.nodes.client.graph_client import GraphClient
    with GraphClient('listener') as client:
        yield client


@pytest.fixture(autouse=True)
def _at_rest(virtual: VirtualRig) -> Iterator[None]:
    """Nothing flows after a story, whatever became of its page."""
    yield
    from microbot_ros.nodes.client.graph_client import GraphClient
    assert virtual.address
    with GraphClient() as client:
        client.set('controller', controller='hold')
        client.stop()


@pytest.fixture
def visit(browser: Any, virtual: VirtualRig, size: tuple[int, int]) -> Iterator[Any]:
    """Opens a page in a window of its own, and gives it control."""
    with ExitStack() as pages:
        yield lambda: take_control(pages.enter_context(opened(browser, virtual.address, size)))


@pytest.fixture
def page(visit: Any) -> Any:
    """A page in control."""
    return visit()


def _steer(page: Any, virtual: VirtualRig, *keys: str) -> None:
    """Keys are held until currents flow, and half a second more."""
    page.bring_to_front()
    page.wait_for_selector('#stick:enabled')
    page.focus('#stick')
    for key in keys:
        page.keyboard.down(key)
    virtual.until(lambda: not virtual.zero)
    page.wait_for_timeout(500)
    assert not virtual.zero


def test_v_and_phi_are_the_truth(page, truth) -> None:
    """As they are read on the page, of each particle, once it was steered every way: first of all
    stories, while none is at a wall."""
    true = [(3.71, -1.09), (4.38, 3.82), (4.98, 2.64)]
    switch(page, 'teleop')
    arm(page)
    page.focus('#stick')
    for keys in [['KeyD'], ['KeyW'], ['KeyA'], ['KeyS'], ['KeyD', 'KeyW'], ['KeyA', 'KeyS']]:
        for key in keys:
            page.keyboard.down(key)
        page.wait_for_timeout(1200)
        for key in keys:
            page.keyboard.up(key)
    part(page, 'estimates')
    places = truth()
    rings = page.evaluate(_RINGS)[1]
    for number, (v_true, phi_true) in enumerate(true):
        name, _, _ = min(rings, key=lambda ring, at=places[number]: math.dist(ring[1:], at))
        page.select_option('#particle', str(name))
        page.wait_for_selector('#readings div:first-child dd:has-text("±")')  # v; D may come first
        v, phi = (_measured(text) for text in page.locator('#readings dd').all_inner_texts()[:2])
        assert abs(v[0] - v_true) <= 3 * v[1], number
        assert abs(math.remainder(phi[0] - math.degrees(phi_true), 360)) <= 3 * phi[1], number


def _measured(text: str) -> tuple[float, float]:
    """Value and standard deviation of what reads `3.71 ± 0.05 µm/s`."""
    value, _, rest = text.replace('\u2212', '-').replace('\xa0', ' ').partition(' ± ')
    return float(value), float(rest.rstrip('°').split()[0])


def test_a_goal_arrives_in_time_and_is_marked_once_it_was_taken(page, listener) -> None:
    from geometry_msgs.msg import PoseArray

    heard = []
    listener.node.create_subscription(
        PoseArray, 'goals',
        lambda message: heard.append((time.monotonic(), message.poses[0].position)), 10)
    listener.spin(1.0)
    switch(page, 'waypoint')
    mode(page, 'goal')
    place = on_page(page, 400, 150)
    began = time.monotonic()
    page.mouse.click(*place)
    end = began + 5
    while not heard and time.monotonic() < end:
        listener.spin(0.01)
    when, place = heard[0]
    assert when - began < TOPIC_S
    assert math.dist((place.x * 1e6, place.y * 1e6),
                     (80.5 * PIXEL_UM, 89.5 * PIXEL_UM)) < PIXEL_UM
    page.wait_for_selector('#overlay .goals g', state='attached')
    page.click('#clear-goals')
    page.wait_for_selector('#overlay .goals:not(:has(g))', state='attached')


def test_a_goal_takes_the_place_of_a_path_and_a_path_that_of_a_goal(page) -> None:
    """And while the rig is disarmed each says that nothing moves yet."""
    for name in ('path_following', 'waypoint', 'path_following'):
        switch(page, name)
        if name == 'waypoint':
            mode(page, 'goal')
            page.mouse.click(*on_page(page, 400, 150))
            page.wait_for_selector('#messages li.ok:has-text("not armed: nothing moves")')
            page.wait_for_selector('#overlay .goals g', state='attached')
            page.wait_for_selector('#overlay .path polyline[points=""]', state='attached')
        else:
            mode(page, 'path')
            draw(page, [on_page(page, 200 + 20 * k, 240) for k in range(10)])
            page.wait_for_selector('#messages li.ok:has-text("not armed: nothing moves")')
            page.wait_for_selector('#overlay .path polyline[points*=" "]', state='attached')
            page.wait_for_selector('#overlay .goals:not(:has(g))', state='attached')


@pytest.fixture
def truth(listener: Any) -> Any:
    """Where the particles really are: () → {number: (x, y)} [px], by the virtual rig."""
    from sensor_msgs.msg import PointCloud2

    from microbot_ros.nodes.base import messages

    heard: list[PointCloud2] = []
    listener.node.create_subscription(PointCloud2, 'virtual_rig/truth', heard.append, 1)

    def now() -> dict[int, tuple[float, float]]:
        heard.clear()
        assert listener.until(lambda: heard, 10.0)
        points = messages.points(heard[-1], np.dtype([('id', '<u4'), ('x', '<f4'), ('y', '<f4')]))
        return {int(one['id']): (float(319.5 + one['x'] * 1e6 / PIXEL_UM),
                                 float(239.5 - one['y'] * 1e6 / PIXEL_UM)) for one in points}
    return now


def _ringed(page: Any, place: tuple[float, float], within_px: float) -> bool:
    return any(math.dist((x, y), place) < within_px for _, x, y in page.evaluate(_RINGS)[1])


def _until(page: Any, true: Any, seconds: float = 20.0) -> None:
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end, page.inner_text('#messages')
        page.wait_for_timeout(50)


def test_what_is_pointed_at_is_tracked_from_then_on(page, truth, listener) -> None:
    from std_srvs.srv import Trigger

    assert 'swimmer' not in page.inner_html('#overlay .rings')
    try:
        mode(page, 'like')
        page.fill('#teach-kind', 'swimmer')
        page.mouse.click(*on_page(page, *truth()[0]))
        page.wait_for_selector('#messages li.ok:has-text("Teach: this")')
        page.wait_for_selector('#overlay .rings text:has-text("swimmer")', state='attached')
        _until(page, lambda: _ringed(page, truth()[0], 6))
        for _ in range(20):  # truth and picture are not of the same moment
            page.wait_for_timeout(100)
            assert _ringed(page, truth()[0], 6)
        assert page.locator('#kinds option').get_attribute('value') == 'swimmer'
    finally:
        forget = listener.node.create_client(Trigger, 'tracker/forget')
        forget.wait_for_service()
        done = forget.call_async(Trigger.Request())
        assert listener.until(done.done, 10.0)


def test_a_node_that_stands_still_is_lost_and_does_nothing_late(page, virtual, listener) -> None:
    from geometry_msgs.msg import PoseArray

    heard = []
    listener.node.create_subscription(PoseArray, 'goals', heard.append, 10)
    switch(page, 'teleop')
    arm(page)
    _steer(page, virtual, 'ArrowRight')
    mode(page, 'goal')
    virtual.signal('cockpit', signal.SIGSTOP)
    try:
        began = time.monotonic()
        page.focus('#stick')
        page.keyboard.down('ArrowUp')
        page.mouse.click(*on_page(page, 200, 200))
        page.wait_for_selector('body.lost', timeout=5000)
        assert time.monotonic() - began <= 1.0
        assert page.is_disabled('#arm')
        assert page.is_disabled('#stick')
        virtual.until(lambda: virtual.zero)
        page.wait_for_timeout(1000)
    finally:
        virtual.signal('cockpit', signal.SIGCONT)
    woke = time.monotonic()
    page.wait_for_selector('body:not(.lost)', timeout=10_000)
    listener.spin(1.5)
    assert not heard
    assert virtual.zero_since(woke) == 0


_NOTE = """(type) => addEventListener(
  type, (event) => { window.acted = performance.timeOrigin + event.timeStamp; }, true)"""


def _acted_s(page: Any) -> float:
    """When the hand last did what is noted [s, monotonic]: what moves it takes its time before."""
    return page.evaluate('window.acted') / 1e3 - (time.time() - time.monotonic())


_PAD = ('navigator.getGamepads = () => [{ index: 0, connected: true, axes: [0, 0],'
        ' buttons: [{ pressed: true }] }]')
_TYPES = {'click': 'pointerdown', 'escape': 'keydown', 'pad': 'gamepadconnected'}
_WAYS = {'click': lambda page: page.click('#stop'),
         'escape': lambda page: page.keyboard.press('Escape'),
         'pad': lambda page: page.evaluate(_PAD)}


@pytest.mark.parametrize('way', _WAYS)
def test_stop_is_zero(page, virtual, way) -> None:
    switch(page, 'teleop')
    arm(page)
    _steer(page, virtual, 'ArrowRight')
    page.evaluate(_NOTE, _TYPES[way])
    began = time.monotonic()
    _WAYS[way](page)
    virtual.until(lambda: virtual.zero)
    began = began if way == 'pad' else _acted_s(page)
    assert virtual.zero_since(began) <= STOP_S
    page.wait_for_selector('#rig-chip[data-state=disarmed]')


def test_a_viewer_stops_a_rig_whose_controller_hangs(page, visit, virtual) -> None:
    # Opened while disarmed: it takes the processors for more than `feedback_timeout_ms`.
    other = visit()
    take_control(page)
    switch(page, 'teleop')
    arm(page)
    _steer(page, virtual, 'ArrowUp')
    try:
        virtual.signal('controller', signal.SIGSTOP)
        other.evaluate(_NOTE, 'keydown')
        other.keyboard.press('Escape')
        virtual.until(lambda: virtual.zero)
        assert virtual.zero_since(_acted_s(other)) <= STOP_S
    finally:
        virtual.signal('controller', signal.SIGCONT)


@pytest.mark.parametrize(('keys', 'angle'), [(['ArrowRight'], 0), (['KeyW', 'KeyA'], 135)])
def test_keys_steer_and_letting_go_is_zero(page, virtual, keys, angle) -> None:
    switch(page, 'teleop')
    arm(page)
    _steer(page, virtual, *keys)
    angle_told = '#field-table .applied td:last-child'
    # The table is behind another tab; opening that would let go of the keys.
    page.wait_for_selector(f'{angle_told}:not(:text-is("–"))', state='attached')
    told = float(page.text_content(angle_told).replace('−', '-'))
    assert abs(math.remainder(told - angle, 360)) < 5
    page.evaluate(_NOTE, 'keyup')
    for key in keys:
        page.keyboard.up(key)
    virtual.until(lambda: virtual.zero)
    assert virtual.zero_since(_acted_s(page)) <= STOP_S


_HIDE = """Object.defineProperty(document, 'visibilityState', { value: 'hidden' });
document.dispatchEvent(new Event('visibilitychange'))"""


def _renderer(page: Any) -> psutil.Process:
    """The process that runs a page: of all its kind the busiest, having been told to be."""
    every = [one for one in psutil.Process().children(recursive=True)
             if '--type=renderer' in ' '.join(one.cmdline())]
    before = {one: sum(one.cpu_times()[:2]) for one in every}
    page.evaluate('{ const end = performance.now() + 250; while (performance.now() < end); }')
    return max(every, key=lambda one: sum(one.cpu_times()[:2]) - before[one])


@pytest.mark.parametrize('way', ['killed', 'frozen', 'hidden'])
def test_a_page_that_vanishes_steers_no_more(page, virtual, way) -> None:
    switch(page, 'teleop')
    arm(page)
    renderer = _renderer(page)
    _steer(page, virtual, 'ArrowRight')
    began = time.monotonic()
    if way == 'hidden':
        page.evaluate(_HIDE)
    elif way == 'killed':
        renderer.kill()
    else:
        renderer.suspend()
    try:
        virtual.until(lambda: virtual.zero)
        assert virtual.zero_since(began) <= VANISHED_S
    finally:
        if way == 'frozen':
            renderer.resume()
    time.sleep(1.0)
    assert virtual.zero  # also once it has woken up, the key still down
