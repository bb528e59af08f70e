"""Place of the picture in the workspace, for RViz: `workspace` → `camera` on /tf_static."""

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
    """Return the transform of points in the camera's frame to the workspace.

    The camera's frame is the optical one of REP 103: x right and y down in the picture, z in
    viewing direction; its origin is the centre of the picture, in focus. `rotation` and `mirrored`
    are those of `ImageToWorkspace`: x of the picture lies at that angle, y at −90° from it, or at
    +90° if the picture is mirrored, which is how a camera from below sees the workspace. So from
    above the frames differ by half a turn about the line between their x axes, from below by the
    rotation about z.

    Parameters
    ----------
    rotation : float
        Angle of the picture [rad].
    mirrored : bool
        Whether the picture is mirrored.
    stamp : Time
        Stamp of the message.

    Returns
    -------
    TransformStamped
        The transform.
    """
    result = TransformStamped(header=Header(stamp=stamp, frame_id=WORKSPACE),
                              child_frame_id=CAMERA)
    c, s = math.cos(rotation / 2), math.sin(rotation / 2)
    turn = result.transform.rotation
    turn.x, turn.y, turn.z, turn.w = (0.0, 0.0, s, c) if mirrored else (c, s, 0.0, 0.0)
    return result


def publish_camera_transform(node: RigNode, rotation: float, mirrored: bool) -> None:
    """Publish `camera_transform` on /tf_static, latched; do nothing without tf2.

    Parameters
    ----------
    node : RigNode
        The node.
    rotation : float
        Angle of the picture [rad].
    mirrored : bool
        Whether the picture is mirrored.
    """
    if TFMessage is None:
        node.get_logger().info('no tf2_msgs here (PyPI has none): nothing on /tf_static')
        return
    outlet = node.publisher(TFMessage, '/tf_static', LATCHED)
    now = node.get_clock().now().to_msg()
    outlet.publish(TFMessage(transforms=[camera_transform(rotation, mirrored, now)]))
