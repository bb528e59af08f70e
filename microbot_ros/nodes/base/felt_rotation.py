"""Rotation that rollers feel, from the topics of commands and fields."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from geometry_msgs.msg import TwistStamped, Vector3Stamped
from sensor_msgs.msg import MagneticField

from microbot_ros.loop.felt_rotation import FeltRotation
from microbot_ros.nodes.base import messages
from microbot_ros.nodes.base.core import Core


def follow_rotation(node: Core, tell: Callable[[float, np.ndarray], None],
                    read_back: bool = True) -> None:
    """Make a node follow the rotation that rollers feel.

    Parameters
    ----------
    node : Core
        Node that subscribes to `field/rotating` and to `field/command`, which ends a rotation.
    tell : callable
        Function that is called with each change: time [s], angular velocity (2,) [rad/s].
    read_back : bool
        Whether rollers stand still while `field/applied` shows no field.
    """
    felt = FeltRotation()

    def on_rotating(message: TwistStamped) -> None:
        _, angular_velocity = messages.rotating_field(message)
        if changed := felt.command(
                messages.to_seconds(message.header.stamp), angular_velocity[:2]):
            tell(*changed)

    def on_command(message: Vector3Stamped) -> None:
        t, _ = messages.vector_at(message)
        if changed := felt.command(t, np.zeros(2)):
            tell(*changed)

    def on_applied(message: MagneticField) -> None:
        if changed := felt.applied(*messages.whole_field_at(message)):
            tell(*changed)

    node.subscribe(Vector3Stamped, 'field/command', on_command)
    node.subscribe(TwistStamped, 'field/rotating', on_rotating)
    if read_back:
        node.subscribe(MagneticField, 'field/applied', on_applied)
