"""Nodes that share a process: who hears what, in which order, and what a hang does."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from typing import Any, cast

import pytest
from rclpy.publisher import Publisher

from microbot_ros.nodes.rig import HangingError, Outlet, Rig

FRAMES, PARTICLES = 'camera/image_raw', 'particles'
STATE, COMMAND, APPLIED = 'model/state', 'field/command', 'field/applied'
LOOP = ('camera', 'tracker', 'model', 'controller', 'coil_driver')


class Wire:
    """Stands for the middleware: notes what goes over it, for as many as listen."""

    def __init__(self, topic: str, log: list[Any], listeners: int = 1) -> None:
        self._topic, self._log, self.listeners = topic, log, listeners

    def get_subscription_count(self) -> int:
        return self.listeners

    def publish(self, message: Any) -> None:
        self._log.append(('published', self._topic, message))


@pytest.fixture
def rig() -> Iterator[Rig]:
    made = Rig(LOOP)
    yield made
    made.stop()


def outlet(rig: Rig, topic: str, log: list[Any], listeners: int = 1) -> Outlet:
    return Outlet(rig, topic, cast(Publisher, Wire(topic, log, listeners)))


def chain(rig: Rig, log: list[Any], done: Callable[[], None] = lambda: None) -> None:
    """The loop: each stage takes what the one before says, the last one drives."""
    ways = {a: outlet(rig, b, log) for a, b in (
        (FRAMES, PARTICLES), (PARTICLES, STATE), (STATE, COMMAND))}
    for topic, way in ways.items():
        rig.listen(topic, way.publish)

    def drive(message: Any) -> None:
        log.append(('driven', message))
        done()
    rig.listen(COMMAND, drive)


def test_the_command_is_on_its_way_before_anything_is_published(rig: Rig) -> None:
    log: list[Any] = []
    chain(rig, log)
    with rig.turn():
        outlet(rig, FRAMES, log).publish(7)
    assert log == [('driven', 7), *(('published', topic, 7)
                                    for topic in (FRAMES, PARTICLES, STATE, COMMAND))]


def test_what_takes_long_and_drives_nothing_comes_after_the_command(rig: Rig) -> None:
    log: list[Any] = []
    rig.listen(FRAMES, lambda _: rig.afterwards(lambda: log.append('drawn')))
    chain(rig, log)
    with rig.turn():
        outlet(rig, FRAMES, log).publish(7)
    assert log[0] == ('driven', 7)
    assert 'drawn' in log


def test_nothing_is_published_that_nobody_hears(rig: Rig) -> None:
    log: list[Any] = []
    quiet = outlet(rig, PARTICLES, log, listeners=0)
    with rig.turn():
        quiet.publish(1)
    quiet.publish(2)
    assert not log


def test_who_commands_hears_its_command_too_once_the_frame_is_done(rig: Rig) -> None:
    """As over the middleware: what a node is at is never cut into by what comes of it."""
    log: list[Any] = []
    said = outlet(rig, COMMAND, log, listeners=0)

    def track(message: Any) -> None:
        said.publish(message)
        log.append('tracked')
    rig.listen(FRAMES, track)
    rig.listen(COMMAND, lambda _: log.append('heard'))
    with rig.turn():
        outlet(rig, FRAMES, log, listeners=0).publish(7)
    assert log == ['tracked', 'heard']


def test_the_newest_frame_is_taken_and_those_it_overtook_are_published(rig: Rig) -> None:
    log: list[Any] = []
    done = threading.Event()
    chain(rig, log, done.set)
    camera = outlet(rig, FRAMES, log)
    for frame in (1, 2, 3):
        camera.publish(frame)
    assert not log  # the camera's thread is not kept
    rig.start()
    assert done.wait(10)
    rig.stop()
    assert [entry for entry in log if entry[0] == 'driven'] == [('driven', 3)]
    assert [message for what, topic, message in log[1:] if topic == FRAMES] == [1, 2, 3]


def test_what_the_drivers_thread_read_back_is_heard_in_order_and_before_the_frame(
        rig: Rig) -> None:
    log: list[Any] = []
    done = threading.Event()
    rig.listen(APPLIED, lambda message: log.append(('read', message)))
    chain(rig, log, done.set)
    outlet(rig, FRAMES, log, 0).publish(0)
    readings = outlet(rig, APPLIED, log)
    readings.publish(1)
    readings.publish(2)
    rig.start()
    assert done.wait(10)
    rig.stop()
    assert log[:5] == [('published', APPLIED, 1), ('published', APPLIED, 2), ('read', 1),
                       ('read', 2), ('driven', 0)]


def test_a_loop_that_hangs_keeps_nobody_for_long(rig: Rig) -> None:
    hangs, begun = threading.Event(), threading.Event()

    def hang(_: Any) -> None:
        begun.set()
        hangs.wait(20)
    log: list[Any] = []
    rig.listen(FRAMES, hang)
    outlet(rig, FRAMES, log).publish(1)
    rig.start()
    assert begun.wait(10)
    with pytest.raises(HangingError, match=r'more than 1 s'), rig.turn():
        pytest.fail('two had their turn at once')
    outlet(rig, APPLIED, log).publish(2)  # as the driver's thread: at once
    assert log == [('published', APPLIED, 2)]
    hangs.set()
    with rig.turn(20):
        log.append('on')


def test_the_loop_outlives_what_fails_in_publishing(rig: Rig) -> None:
    log: list[Any] = []
    done = threading.Event()
    chain(rig, log, done.set)
    rig.listen(APPLIED, lambda _: rig.afterwards(lambda: 1 / 0))  # type: ignore[arg-type]
    rig.start()
    outlet(rig, APPLIED, log).publish(1)
    with rig.turn(20):
        pass
    outlet(rig, FRAMES, log).publish(2)
    assert done.wait(10)


def test_a_process_joins_only_what_its_own_nodes_say() -> None:
    rig = Rig(('tracker', 'model'))
    assert {topic for topic in (FRAMES, PARTICLES, STATE, COMMAND, APPLIED)
            if rig.joins(topic)} == {PARTICLES, STATE}


def test_who_has_left_hears_nothing(rig: Rig) -> None:
    heard: list[Any] = []
    leave = rig.listen(PARTICLES, heard.append)
    leave()
    with rig.turn():
        outlet(rig, PARTICLES, heard, 0).publish(1)
    assert not heard
