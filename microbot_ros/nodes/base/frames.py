"""Where the picture lies in the workspace, for RViz: `workspace` → `camera` on /tf_static."""

from __future__ import annotations

import math

from builtin_interfaces.msg import Time
from geometry_msgs.msg import TransformStamped
from std_msgs.msg import Header

from microbot_ros.nodes.base.lifecycle import LATCHED, RigNode
from microbot_ros.nodes.base.messages import CAMERA, WORKSPACE

try:
    from tf2_msgs.msg import TFMessage
except ImportError:  # an installation of ROS has it, the wheels on PyPI don't
    TFMessage = None


def camera_transform(rotation: float, mirrored: bool, stamp: Time) -> TransformStamped:
    """Of points in the camera's frame to those in the workspace, with a `stamp`.

    The camera's frame is REP 103's optical one: x right and y down in the picture, z the way it
    looks; its origin is the centre of the picture, in focus. `rotation` [rad] and `mirrored` are
    `ImageToWorkspace`'s: x of the picture lies at that angle, y at −90° from it; or at +90° where
    the picture is mirrored, which is how a camera from below sees the workspace. So from above
    the frames differ by half a turn about the line between their x axes, from below by the
    rotation about z.
    """
    result = TransformStamped(header=Header(stamp=stamp, frame_id=WORKSPACE),
                              child_frame_id=CAMERA)
    c, s = math.cos(rotation / 2), math.sin(rotation / 2)
    turn = result.transform.rotation
    turn.x, turn.y, turn.z, turn.w = (0.0, 0.0, s, c) if mirrored else (c, s, 0.0, 0.0)
    return result


def publish_camera_transform(node: RigNode, rotation: float, mirrored: bool) -> None:
    """Say on /tf_static, latched, by a `node`, what `camera_transform` makes of `rotation` [rad]
    and `mirrored`; nothing where there is no tf2."""
    if TFMessage is None:
        node.get_logger().info('no tf2_msgs here (PyPI has none): nothing on /tf_static')
        return
    outlet = node.publisher(TFMessage, '/tf_static', LATCHED)
    now = node.get_clock().now().to_msg()
    outlet.publish(TFMessage(transforms=[camera_transform(rotation, mirrored, now)]))
