"""The camera node with cameras that lose, repeat, shrink and vanish: a film of each kind."""

from __future__ import annotations

import importlib.metadata
import math
import threading
import time
from collections import deque
from typing import Any, ClassVar

import numpy as np
import pytest
from rclpy.parameter import Parameter
from sensor_msgs.msg import CameraInfo, Image

from microbot_ros.cameras.camera import (
    CameraDriver,
    CameraFormat,
    CameraFrame,
    Clock,
    camera_class,
)
from microbot_ros.common.errors import InputError
from microbot_ros.nodes import camera as camera_node
from microbot_ros.nodes.base import messages
from microbot_ros.nodes.base.lifecycle import ERROR, IMAGES_IN, OK, WARN


class Bench(CameraDriver):
    """A camera in the hands of a test."""

    frames: ClassVar[deque[CameraFrame]] = deque()
    news = threading.Event()
    opened = 0
    exposure_ms = 0.0
    gone = False
    form = CameraFormat(4, 6, 'mono8', 'Mono8', Clock.HOST, sensor=(8, 10), offset=(2, 1),
                        patience=math.inf)

    def open(self) -> CameraFormat:
        if Bench.gone:
            raise InputError('bench', 'is not there')
        Bench.opened += 1
        Bench.exposure_ms = self.within('exposure_ms', 0.0, 100.0)
        return self.form

    def read(self, timeout: float) -> CameraFrame | None:
        if Bench.gone:
            raise InputError('bench', 'stopped delivering frames')
        Bench.news.wait(timeout)
        Bench.news.clear()
        return Bench.frames.popleft() if Bench.frames else None

    def close(self) -> None:
        pass


def show(number: int, image: np.ndarray | None = None, late: float = 0.0) -> None:
    """Let the camera give a frame that was exposed a while ago."""
    now = time.monotonic()
    image = np.full((4, 6), number, np.uint8) if image is None else image
    Bench.frames.append(CameraFrame(number, image, now, now - late))
    Bench.news.set()


@pytest.fixture
def bench(ros: Any, monkeypatch: Any, patience: Any) -> Any:
    """A graph with a camera node on a camera of the test's own."""
    monkeypatch.setattr(camera_node, 'camera_class', lambda _: Bench)
    patience(reopen_s=0.01)
    Bench.frames, Bench.opened, Bench.gone = deque(), 0, False
    Bench.news = threading.Event()
    graph = ros({'camera': {'source': 'bench', 'camera': 'bench'}})
    graph.images = graph.hear(Image, 'camera/image_raw', IMAGES_IN)
    graph.infos = graph.hear(CameraInfo, 'camera/camera_info', IMAGES_IN)
    graph.camera = graph.add('camera')
    assert graph.camera.active, graph.camera.fault
    graph.until(lambda: graph.camera._images.get_subscription_count()
                and graph.camera._info.get_subscription_count())
    return graph


def give(graph: Any, *numbers: int, **how: Any) -> None:
    for number in numbers:
        show(number, **how)
        graph.until(lambda: not Bench.frames)


def test_frames_come_with_their_moment_their_size_and_their_region(bench: Any) -> None:
    before = bench.camera.seconds()
    give(bench, 5, late=0.25)
    bench.until(lambda: bench.images and bench.infos)
    image, info = bench.images[0], bench.infos[0]
    assert messages.gray(image).tolist() == [[5] * 6] * 4
    stamp = messages.to_seconds(image.header.stamp)
    assert before - 0.26 < stamp < bench.camera.seconds() - 0.25
    assert info.header == image.header
    assert info.header.frame_id == 'camera'
    assert (info.width, info.height) == (10, 8)
    roi = info.roi
    assert (roi.x_offset, roi.y_offset, roi.width, roi.height) == (2, 1, 6, 4)
    assert not any(info.k), 'uncalibrated'


def test_lost_and_repeated_frames_are_counted_and_said(bench: Any) -> None:
    give(bench, 1, 2, 6, 6, 7)
    bench.until(lambda: len(bench.images) == 4)
    level, sentence, values = bench.camera.health()
    assert (values['frames_published'], values['frames_lost'], values['frames_repeated']) == (
        4, 3, 1)
    assert (level, sentence) == (WARN, '3 frames lost since the last report')
    assert bench.camera.health()[0] == OK


def test_a_frame_of_another_size_is_said_and_the_camera_opened_again(bench: Any) -> None:
    give(bench, 1)
    give(bench, 2, image=np.zeros((6, 4), np.uint8))
    bench.until(lambda: Bench.opened == 2)
    give(bench, 8)
    bench.until(lambda: len(bench.images) == 2)
    assert {(image.width, image.height) for image in bench.images} == {(6, 4)}
    assert 'frame 2 is 4×6 uint8, expected 6×4 mono8' in bench.camera._complaint


def test_a_camera_that_vanishes_is_said_until_it_is_back(bench: Any) -> None:
    give(bench, 1, 4)
    Bench.gone = True
    bench.until(lambda: bench.camera.health()[0] == ERROR)
    bench.until(lambda: bench.camera.health()[1]
                == 'bench: is not there; reopening the same device')
    Bench.gone = False
    bench.until(lambda: Bench.opened == 2)
    give(bench, 1)
    bench.until(lambda: len(bench.images) == 3)
    values = bench.camera.health()[2]
    assert values['frames_lost'] == 2, 'what was lost before it vanished is still told'
    bench.until(lambda: bench.camera.health()[0] == OK)


def test_what_was_gathered_before_it_is_wanted_is_let_go(bench: Any, monkeypatch: Any) -> None:
    monkeypatch.setattr(camera_node, '_FRESH_SECONDS', -1.0)
    for state in ('deactivate', 'cleanup', 'configure'):
        getattr(bench.camera, f'trigger_{state}')()
    assert Bench.opened == 2
    bench.camera.trigger_activate()
    bench.until(lambda: Bench.opened == 3)


def test_exposure_is_set_while_running_and_one_that_cannot_be_is_said(bench: Any) -> None:
    give(bench, 1)
    bench.camera.set_parameters([Parameter('exposure_ms', value=20.0)])
    bench.until(lambda: Bench.exposure_ms == 20.0)
    bench.camera.set_parameters([Parameter('exposure_ms', value=200.0)])
    bench.until(lambda: bench.camera.health()[0] == ERROR)
    assert 'exposure_ms must be 0 to 100 ms here; received 200' in bench.camera.health()[1]
    bench.camera.set_parameters([Parameter('exposure_ms', value=5.0)])
    bench.until(lambda: Bench.exposure_ms == 5.0)
    give(bench, 1)
    bench.until(lambda: len(bench.images) == 2)


def test_depth_and_bayer_pattern_are_handed_on(bench: Any, monkeypatch: Any) -> None:
    for encoding, depth in (('mono16', np.uint16), ('bayer_rggb8', np.uint8)):
        monkeypatch.setattr(Bench, 'form', CameraFormat(
            4, 6, encoding, 'its', Clock.HOST, patience=math.inf))
        bench.camera.trigger_deactivate()
        bench.camera.trigger_activate()
        picture = np.arange(24, dtype=depth).reshape(4, 6) * (2000 if depth is np.uint16 else 1)
        seen = len(bench.images)
        give(bench, 1, image=picture)
        bench.until(lambda seen=seen: len(bench.images) > seen)
        assert bench.images[-1].encoding == encoding
        assert np.frombuffer(bench.images[-1].data, depth).tolist() == picture.ravel().tolist()


def test_a_package_that_is_missing_is_named(monkeypatch: Any) -> None:
    def missing(name: str) -> None:
        raise ImportError(f'No module named {name!r}')

    for kind in ('pylon', 'micromanager'):
        driver = camera_class(kind)(camera_node.CameraParameters(source='x'), pytest.fail)
        with monkeypatch.context() as patched:
            patched.setattr('importlib.import_module', missing)
            with pytest.raises(InputError, match=r"pip install 'microbot_ros\[cameras\]'"):
                driver.open()


def test_every_kind_of_ours_is_registered_and_loads() -> None:
    ours = [point for point in importlib.metadata.entry_points(group='microbot_ros.cameras')
            if point.value.startswith('microbot_ros.')]
    assert {point.name for point in ours} == {'aravis', 'file', 'micromanager', 'pylon', 'v4l2'}
    for point in ours:
        assert issubclass(camera_class(point.name), CameraDriver)
