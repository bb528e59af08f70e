"""Whom a player sends to: whether all are there, and whether they keep up."""

from __future__ import annotations

from rclpy.duration import Duration
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Image

from microbot_ros.nodes.base.lifecycle import RELIABLE, RigNode
from microbot_ros.nodes.base.messages import stamp_at
from microbot_ros.nodes.base.topics import KEPT


class PlaybackPublishers:
    """Publishers, for a `node`, of topics by name, of these `kinds`, and of `/clock`."""

    def __init__(self, node: RigNode, kinds: dict[str, type]) -> None:
        self._node = node
        self._clock = node.publisher(Clock, '/clock')
        # A listener who takes no frames would cost a gigabyte in ten seconds.
        self._outlets = {name: node.publisher(kind, name, RELIABLE if kind is Image else KEPT)
                         for name, kind in kinds.items()}

    @property
    def count(self) -> int:
        """Listeners that what is sent now will reach."""
        return sum(outlet.get_subscription_count() for outlet in self._all.values())

    def missing(self) -> list[str]:
        """Topics that do not reach all their listeners yet."""
        return [name for name, outlet in self._all.items()
                if outlet.get_subscription_count() < self._node.count_subscribers(name)]

    def send(self, topic: str, data: bytes) -> bool:
        """Publish serialised `data` on a `topic`; False where who keeps every message has no room
        for it yet.

        It then waits 0.1 s for that room, which is how long Fast DDS lets a publisher wait.
        """
        try:
            self._outlets[topic].publish(data)
        except rclpy_implementation.RCLError:
            return False
        return True

    def tell_time(self, t_ns: int) -> None:
        """Publish the time `t_ns` on `/clock`."""
        self._clock.publish(Clock(clock=stamp_at(t_ns)))

    def has_all(self) -> bool:
        """Whether every reliable listener has what was sent."""
        return all(outlet.wait_for_all_acked(Duration()) for outlet in self._outlets.values())

    @property
    def _all(self) -> dict[str, Publisher]:
        return {'/clock': self._clock, **self._outlets}
