"""Topic `camera/preview`: small pictures for screens, made beside the loop only on demand."""

from __future__ import annotations

import array
import os
import threading
from typing import Any

import cv2
import numpy as np
from sensor_msgs.msg import CompressedImage, Image

from microbot_ros.nodes.base import messages
from microbot_ros.nodes.base.lifecycle import IMAGES_OUT, RigNode

_RATE_HZ = 30.0
"""Highest rate [Hz]. Choice: smooth to the eye; the frames of a camera may be ten times as
many."""
_WIDEST_PX = 640
"""Largest width [px]. Choice: a page shows it sharp enough; twice costs four times the line."""
_QUALITY = 80
"""Quality of the JPEG, 0 to 100. Choice: higher enlarges the pictures, lower shows blocks."""
_FORMAT = 'mono8; jpeg compressed mono8'
"""Format as image_transport writes it."""


class Preview:
    """Publisher of small JPEG pictures of a node's frames, at most 30 times a second.

    A picture wider than 640 px is reduced by a whole number. A thread of ordinary priority does
    it; while it works, the newest offered frame waits and others are left out.

    Parameters
    ----------
    node : RigNode
        Node with frames.
    """

    def __init__(self, node: RigNode) -> None:
        self._node = node
        self._publisher = node.publisher(CompressedImage, 'camera/preview', IMAGES_OUT)
        self._due = 0.0
        self._news = threading.Condition()
        self._waiting: Image | None = None
        self._ending = False
        self._thread = threading.Thread(target=self._run, name='preview', daemon=True)
        self._thread.start()

    def offer(self, image: Image) -> None:
        """Offer a frame; it is used if a picture is due and there is a listener.

        Parameters
        ----------
        image : Image
            Frame that was published.
        """
        if not self._publisher.get_subscription_count():
            return
        t = messages.to_seconds(image.header.stamp)
        if 0 < self._due - t < 1.0:
            return
        self._due = max(self._due, t - 1 / _RATE_HZ) + 1 / _RATE_HZ if self._due <= t else t
        with self._news:
            self._waiting = image
            self._news.notify()

    def close(self) -> None:
        """End the thread."""
        with self._news:
            self._ending = True
            self._news.notify()
        self._thread.join()

    def _run(self) -> None:
        while True:
            with self._news:
                self._news.wait_for(lambda: self._waiting or self._ending)
                image, self._waiting = self._waiting, None
            if image is None:
                return
            # All threads of a process of the loop have real-time priority, this one too.
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
            try:
                self._publisher.publish(preview(image))
            except messages.MessageError as error:
                self._node.complain(f'camera/preview: {error}')
            except Exception as error:  # the node is being closed
                self._node.get_logger().debug(f'camera/preview: {error}')


def preview(image: Image) -> CompressedImage:
    """Return a picture as a small grey JPEG, with its header.

    Parameters
    ----------
    image : Image
        The picture.

    Returns
    -------
    CompressedImage
        The JPEG.

    Raises
    ------
    MessageError
        If the picture cannot be read.
    """
    pixels = messages.gray(image)
    factor = -(-pixels.shape[1] // _WIDEST_PX)
    if factor > 1:
        size = (pixels.shape[1] // factor, max(1, pixels.shape[0] // factor))
        pixels = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
    _, jpeg = cv2.imencode('.jpg', in_8_bits(pixels), (cv2.IMWRITE_JPEG_QUALITY, _QUALITY))
    data = array.array('B')
    data.frombytes(jpeg.tobytes())
    return CompressedImage(header=image.header, format=_FORMAT, data=data)


def in_8_bits(pixels: np.ndarray) -> Any:
    """Return pixels as uint8; the brightest of 16 bits becomes white.

    Parameters
    ----------
    pixels : ndarray, shape (H, W)
        Uint8 or uint16.

    Returns
    -------
    object
        Uint8 of the same shape.
    """
    if pixels.dtype == np.uint8:
        return pixels
    return cv2.convertScaleAbs(pixels, alpha=255.0 / max(int(pixels.max()), 1))
