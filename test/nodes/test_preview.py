"""Pictures for screens: small, not too many, and none that nobody looks at."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import pytest
from sensor_msgs.msg import CompressedImage

from microbot_ros.nodes.base import messages
from microbot_ros.nodes.base.preview import Preview, preview


def decoded(message: CompressedImage) -> np.ndarray:
    """The pixels of a preview, as any viewer has them."""
    return np.asarray(cv2.imdecode(np.frombuffer(message.data, np.uint8), cv2.IMREAD_UNCHANGED))


@pytest.mark.parametrize(('width', 'height', 'small'), [
    (640, 480, (480, 640)), (641, 480, (240, 320)), (1280, 1024, (512, 640)),
    (1920, 1080, (360, 640)), (4000, 1, (1, 571)), (1, 1, (1, 1)), (3, 500, (500, 3))])
def test_a_preview_is_no_wider_than_640(
        width: int, height: int, small: tuple[int, int]) -> None:
    image = messages.image(np.full((height, width), 90, np.uint8), messages.to_stamp(12.5))
    found = preview(image)
    assert decoded(found).shape == small
    assert abs(int(decoded(found).mean()) - 90) <= 1
    assert found.header == image.header
    assert found.format == 'mono8; jpeg compressed mono8'


def test_what_is_in_the_picture_lies_where_it_did() -> None:
    """A bright square's centre, in the pixels of the full picture, within half a pixel of it."""
    pixels = np.zeros((1024, 1280), np.uint8)
    pixels[300:340, 900:960] = 255
    small = decoded(preview(messages.image(pixels, messages.to_stamp(0.0)))).astype(float)
    rows, columns = np.indices(small.shape)
    factor = 1280 / small.shape[1]
    centre = [(float((axis * small).sum() / small.sum()) + 0.5) * factor - 0.5
              for axis in (columns, rows)]
    assert centre == pytest.approx([929.5, 319.5], abs=0.5)


@pytest.mark.parametrize('encoding', ['mono16', 'bgr8', 'rgba8', 'bayer_rggb8'])
def test_every_encoding_that_a_camera_has_is_shown(encoding: str) -> None:
    depth = np.uint16 if encoding == 'mono16' else np.uint8
    shape = (48, 64) if encoding.startswith(('mono', 'bayer')) else (48, 64, len(encoding) - 1)
    pixels = np.full(shape, 4095 if depth is np.uint16 else 120, depth)
    found = decoded(preview(messages.image(pixels, messages.to_stamp(0.0), encoding=encoding)))
    assert found.shape == (48, 64)
    assert abs(int(found.mean()) - (255 if depth is np.uint16 else 120)) <= 1


def test_a_dark_sensor_is_black() -> None:
    found = preview(messages.image(np.zeros((4, 4), np.uint16), messages.to_stamp(0.0),
                                   encoding='mono16'))
    assert not decoded(found).any()


def test_thirty_a_second_and_only_while_somebody_looks(
        ros: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
    graph = ros({})
    node = graph.add('model')
    made: list[float] = []
    monkeypatch.setattr('microbot_ros.nodes.base.preview.preview', lambda image: made.append(
        messages.to_seconds(image.header.stamp)) or CompressedImage(header=image.header))
    shown = Preview(node)

    def offer(begin: float, count: int, rate: float) -> None:
        for k in range(count):
            shown.offer(messages.image(np.zeros((4, 4), np.uint8),
                                       messages.to_stamp(begin + k / rate)))
            graph.until(lambda: shown._waiting is None)

    offer(100.0, 20, 100.0)
    assert made == []
    heard = graph.hear(CompressedImage, 'camera/preview')
    graph.until(lambda: shown._publisher.get_subscription_count())
    offer(200.0, 100, 100.0)
    graph.until(lambda: len(made) >= 29)
    assert len(made) <= 31
    assert np.diff(made).max() <= 0.0401
    made.clear()
    offer(50.0, 10, 10.0)  # the clock was set back, and the camera is slow
    graph.until(lambda: len(made) >= 9)
    graph.until(lambda: len(heard) >= 30)
    shown.close()
