"""The page before a virtual rig of real nodes and a serial line, judged by the amplifier's log."""

from __future__ import annotations

import math
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from typing import Any

import psutil
import pytest
from cockpit.virtual import VirtualRig

pytestmark = [pytest.mark.graph, pytest.mark.timeout(240)]
STOP_S, VANISHED_S, TOPIC_S = 0.1, 0.4, 0.2
"""Asked for: from STOP, or from letting go, to zero; from a page's end while it steers to zero;
from a click to its topic."""
PIXEL_UM, WIDTH, HEIGHT = 0.45, 640, 480

# Where the rings are, in pixels of the camera, and of which picture.
_RINGS = """() => {
  const scale = document.querySelector('#frame').getBoundingClientRect().width / 640;
  return [document.querySelector('#picture').dataset.stamp,
    [...document.querySelectorAll('#overlay .rings > g')].map((node) => {
      const { e, f } = node.getCTM();
      return [Number(node.dataset.id), e / scale - 0.5, f / scale - 0.5];
    })];
}"""


@pytest.fixture(scope='module')
def virtual(browser: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[VirtualRig]:
    """One rig for all stories; none without a `browser`."""
    assert browser.is_connected()
    with VirtualRig(tmp_path_factory.mktemp('rig'), coil_driver={
            'command_timeout_ms': 250.0, 'max_command_age_ms': 250.0}) as made:
        yield made


@pytest.fixture
def listener() -> Iterator[Any]:
    """A node of the tests' own."""
    from microbot_ros.nodes.graph_client import GraphClient
    with GraphClient('listener') as client:
        yield client


@pytest.fixture(autouse=True)
def _at_rest(virtual: VirtualRig) -> Iterator[None]:
    """Nothing flows after a story, whatever became of its page."""
    yield
    from microbot_ros.nodes.graph_client import GraphClient
    assert virtual.address
    with GraphClient() as client:
        client.set('controller', controller='hold')
        client.arm(False)


@pytest.fixture
def visit(browser: Any, virtual: VirtualRig) -> Iterator[Any]:
    """Opens a page in a window of its own, and gives it control."""
    contexts = []

    def one() -> Any:
        contexts.append(browser.new_context(viewport={'width': 1440, 'height': 900}))
        page = contexts[-1].new_page()
        page.goto(virtual.address)
        page.wait_for_selector('#overlay .rings g', state='attached', timeout=60_000)
        return _in_control(page)

    yield one
    for context in contexts:
        context.close()


def _in_control(page: Any) -> Any:
    page.wait_for_selector('#fact-control:not(:text-is("–"))')
    if page.is_visible('#take-control'):
        page.click('#take-control')
    page.wait_for_selector('#arm:enabled')
    return page


@pytest.fixture
def page(visit: Any) -> Any:
    """A page in control."""
    return visit()


def _arm(page: Any) -> None:
    """By holding the button; a busy machine may need a second try."""
    for _ in range(3):
        page.hover('#arm')
        page.mouse.down()
        page.wait_for_selector('#messages li:first-child:has-text("Arm:")', timeout=20_000)
        page.mouse.up()
        try:
            page.wait_for_selector('#rig-chip[data-state=armed]', timeout=2000)
        except Exception:
            continue
        return
    raise AssertionError(page.inner_text('#messages'))


def _switch(page: Any, name: str) -> None:
    page.select_option('#controller', name)
    page.click('#controller-form button')
    page.wait_for_selector(f'#controller-now:has-text("At work: {name}.")')


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


def test_rings_are_where_the_tracker_has_particles_at_the_stamp_shown(page, listener) -> None:
    from sensor_msgs.msg import PointCloud2

    from microbot_ros.loop.points import PARTICLE
    from microbot_ros.nodes import messages

    heard = {}

    def hear(message: Any) -> None:
        stamp = message.header.stamp
        found = messages.points(message, PARTICLE)
        heard[stamp.sec * 10**9 + stamp.nanosec] = {
            int(one['id']): (319.5 + one['x'] * 1e6 / PIXEL_UM, 239.5 - one['y'] * 1e6 / PIXEL_UM)
            for one in found}

    listener.node.create_subscription(PointCloud2, 'particles', hear, 10)
    compared = 0
    for _ in range(40):
        listener.spin(0.05)
        stamp, rings = page.evaluate(_RINGS)
        listener.spin(0.05)
        for number, x, y in rings if int(stamp) in heard else []:
            assert math.dist((x, y), heard[int(stamp)][number]) < 2
            compared += 1
    assert compared > 20


@pytest.mark.clocked
def test_a_goal_arrives_in_time_and_is_marked_once_it_was_taken(page, listener) -> None:
    from geometry_msgs.msg import PoseArray

    heard = []
    listener.node.create_subscription(
        PoseArray, 'goals',
        lambda message: heard.append((time.monotonic(), message.poses[0].position)), 10)
    listener.spin(1.0)
    page.click('#modes label:has(input[value=goal])')
    box = page.locator('#frame').bounding_box()
    scale = box['width'] / WIDTH
    began = time.monotonic()
    page.mouse.click(box['x'] + 400.5 * scale, box['y'] + 150.5 * scale)
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


@pytest.mark.clocked
@pytest.mark.parametrize('way', _WAYS)
def test_stop_is_zero(page, virtual, way) -> None:
    _switch(page, 'teleop')
    _arm(page)
    _steer(page, virtual, 'ArrowRight')
    page.evaluate(_NOTE, _TYPES[way])
    began = time.monotonic()
    _WAYS[way](page)
    virtual.until(lambda: virtual.zero)
    began = began if way == 'pad' else _acted_s(page)
    assert virtual.zero_since(began) <= STOP_S
    page.wait_for_selector('#rig-chip[data-state=disarmed]')


@pytest.mark.clocked
def test_a_viewer_stops_a_rig_whose_controller_hangs(page, visit, virtual) -> None:
    _switch(page, 'teleop')
    _arm(page)
    other = visit()
    _in_control(page)
    _steer(page, virtual, 'ArrowUp')
    try:
        virtual.signal('controller', signal.SIGSTOP)
        other.evaluate(_NOTE, 'keydown')
        other.keyboard.press('Escape')
        virtual.until(lambda: virtual.zero)
        assert virtual.zero_since(_acted_s(other)) <= STOP_S
    finally:
        virtual.signal('controller', signal.SIGCONT)


@pytest.mark.clocked
@pytest.mark.parametrize(('keys', 'angle'), [(['ArrowRight'], 0), (['KeyW', 'KeyA'], 135)])
def test_keys_steer_and_letting_go_is_zero(page, virtual, keys, angle) -> None:
    _switch(page, 'teleop')
    _arm(page)
    _steer(page, virtual, *keys)
    angle_told = '#field-table .applied td:last-child'
    page.wait_for_selector(f'{angle_told}:not(:text-is("–"))')
    told = float(page.inner_text(angle_told).replace('−', '-'))
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


@pytest.mark.clocked
@pytest.mark.parametrize('way', ['killed', 'frozen', 'hidden'])
def test_a_page_that_vanishes_steers_no_more(page, virtual, way) -> None:
    _switch(page, 'teleop')
    _arm(page)
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


def test_notes_are_in_the_recording(page, virtual) -> None:
    page.fill('#title', 'batch 7')
    page.click('#record')
    page.wait_for_selector('#recording-now:has-text("“batch 7”")')
    page.fill('#note', 'a bubble at the left')
    page.press('#note', 'Enter')
    page.wait_for_function('() => document.querySelector("#note").value === ""')
    page.reload()
    page.wait_for_selector('#recording-now:has-text("“batch 7”")')
    _in_control(page).click('#record')
    page.wait_for_selector('#recording-now:has-text("Not recording")')
    said = subprocess.run([sys.executable, '-m', 'microbot_ros.cli', 'info',
                           str(virtual.folder / 'recording')], capture_output=True, text=True)
    assert 'a bubble at the left' in said.stdout
    assert 'batch 7' in said.stdout


def test_a_refused_swap_leaves_the_old_one_and_says_why(page) -> None:
    _switch(page, 'teleop')
    _arm(page)
    page.locator('.parameter:has(label[title="teleop.particle"]) input').fill('77')
    page.locator('.parameter:has(label[title="teleop.particle"]) button').click()
    page.wait_for_selector('#messages li:has-text("Set teleop.particle")')
    _switch(page, 'hold')
    page.select_option('#controller', 'teleop')
    page.click('#controller-form button')
    page.wait_for_selector('#messages li.refused:has-text("77")')
    assert 'At work: hold.' in page.inner_text('#controller-now')
