"""What rollers feel of a commanded rotation, from the topics."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from geometry_msgs.msg import Vector3Stamped
from sensor_msgs.msg import MagneticField

from microbot_ros.loop.felt_rotation import FeltRotation
from microbot_ros.nodes.base import messages
from microbot_ros.nodes.base.core import Core


def follow_rotation(node: Core, tell: Callable[[float, np.ndarray], None],
                    read_back: bool = True) -> None:
    """Let a `node` hear what is commanded on `field/rotation` and, with `read_back`, what flows by
    `field/applied`, and `tell` what rollers feel of it: (time [s], angular velocity (2,) [rad/s]).
    """
    felt = FeltRotation()

    def on_rotation(message: Vector3Stamped) -> None:
        tell(*felt.command(*messages.vector_at(message)))

    def on_applied(message: MagneticField) -> None:
        if changed := felt.applied(*messages.whole_field_at(message)):
            tell(*changed)

    node.subscribe(Vector3Stamped, 'field/rotation', on_rotation)
    if read_back:
        node.subscribe(MagneticField, 'field/applied', on_applied)
