"""A rig that is not ours: particles of the fine physics, moved by the field that is applied."""

from __future__ import annotations

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import MagneticField, PointCloud2

from microbot_ros.loop.points import PARTICLE
from microbot_ros.model.physics.particle import Fluid
from microbot_ros.nodes.base import messages
from microbot_ros.virtual_rig.injected_effects import inject_effect
from microbot_ros.virtual_rig.record_session import draw_swarm
from microbot_ros.virtual_rig.world import FieldHistory, World

FIELD, RATE = 5e-3, 30.0
FLUID = Fluid(1.245e-3)


class ForeignRig:
    """A node of somebody else: 30 times a second where its particles are, moved by the field that
    is applied. `stuck`, `gone` and `dark` are what may go wrong in it.
    """

    def __init__(self, node: Node, effect: str, parameters: dict[str, float]) -> None:
        rng = np.random.default_rng(4)
        swarm = draw_swarm(rng, 4, FLUID, FIELD, radius=2.3e-6, half_extent=50e-6, spacing=20e-6,
                           aligns_in=5e-5)
        inject_effect(swarm, effect, parameters, FIELD)
        self._node, self._world, self._rng = node, World(swarm, rng), rng
        self._changes = [(-1.0, np.zeros(2))]
        self._begun, self._lived = node.get_clock().now().nanoseconds, 0.0
        self.gone = self.dark = False
        self._out = node.create_publisher(PointCloud2, 'particles', 10)
        node.create_subscription(MagneticField, 'field/applied', self._on_field, 50)
        node.create_timer(1 / RATE, self._expose)

    def _on_field(self, message: MagneticField) -> None:
        field = np.array([message.magnetic_field.x, message.magnetic_field.y])
        if not np.allclose(field, self._changes[-1][1], atol=1e-7):
            # When it changed, not when this process had a moment to hear of it.
            t = messages.to_seconds(message.header.stamp) - 1e-9 * self._begun
            self._changes = [*self._changes[-500:], (max(t, self._lived), field)]

    @property
    def field(self) -> float:
        """The strength that is applied now [T]."""
        return float(np.hypot(*self._changes[-1][1]))

    def _expose(self) -> None:
        t = np.array([t for t, _ in self._changes])
        field = np.array([f for _, f in self._changes])[:, None]
        now = self._node.get_clock().now()
        self._lived = 1e-9 * (now.nanoseconds - self._begun)
        self._world.advance(self._lived, FieldHistory(t, field))
        if self.dark:
            return
        seen = self._world.position + self._rng.normal(0.0, 5e-8, (4, 2))
        points = np.zeros(0 if self.gone else 4, PARTICLE)
        if not self.gone:
            points['id'], points['x'], points['y'] = np.arange(4), *seen.T
            points['theta'], points['sigma'] = np.nan, 5e-8
        self._out.publish(messages.cloud(points, now.to_msg()))
