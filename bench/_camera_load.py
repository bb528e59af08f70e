"""A camera for benchmarks: `python -m bench._camera_load WIDTH HEIGHT RATE_HZ`.

Waits for a listener, then publishes pictures of four particles on `camera/image_raw` until it is
stopped. They were made beforehand, so that what is measured is the others, and are stamped with
the moment at which they were due, so that a camera that is late is seen.
"""

from __future__ import annotations

import itertools
import sys
import time

import numpy as np
import rclpy
from rclpy.time import Time
from sensor_msgs.msg import Image

from microbot_ros.common.real_time import LOOP, set_realtime_priority_of_all
from microbot_ros.nodes.base import messages
from microbot_ros.nodes.base.lifecycle import IMAGES_OUT
from microbot_ros.nodes.base.transport import BY_PROFILE, NODE, transport
from microbot_ros.nodes.client.graph import READY
from microbot_ros.virtual_rig.microscope import Microscope, MicroscopeSettings

PIXEL_SIZE_UM = 0.45


def pictures(width: int, height: int, rate: float, count: int = 40) -> list[Image]:
    """Four particles that swim at 4 µm/s, to and fro."""
    scope = Microscope(MicroscopeSettings(
        width_px=width, height_px=height, pixel_size_um=PIXEL_SIZE_UM), seed=3)
    heading = np.array([0.3, 1.9, 3.5, 5.1])
    start = 1e-6 * np.array([[-80, 40], [70, 50], [-60, -70], [90, -60]])
    way = 4e-6 / rate * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    there = [messages.image(scope.render(start + k * way, heading, k / rate), messages.to_stamp(0))
             for k in range(count)]
    return there + there[-2:0:-1]


def main() -> None:
    """Publish until a signal."""
    width, height, rate = int(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3])
    film = pictures(width, height, rate)
    with transport(BY_PROFILE, NODE):
        rclpy.init(args=[])
        node = rclpy.create_node('camera')
    outlet = node.create_publisher(Image, 'camera/image_raw', IMAGES_OUT)
    while not outlet.get_subscription_count():
        time.sleep(0.05)
    time.sleep(0.5)
    print(READY, flush=True)
    set_realtime_priority_of_all(LOOP)
    begin, begin_ns = time.monotonic(), node.get_clock().now().nanoseconds
    for frame in itertools.count():
        time.sleep(max(0.0, begin + frame / rate - time.monotonic()))
        image = film[frame % len(film)]
        image.header.stamp = Time(nanoseconds=begin_ns + round(frame * 1e9 / rate)).to_msg()
        outlet.publish(image)


if __name__ == '__main__':
    main()
