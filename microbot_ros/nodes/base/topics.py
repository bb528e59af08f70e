"""Topics of the graph that are recorded, with the quality of service to receive them."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseArray, PoseStamped, TwistStamped, Vector3Stamped
from nav_msgs.msg import Path
from rcl_interfaces.msg import ParameterEvent
from rclpy.qos import (
    QoSDurabilityPolicy,
    QoSHistoryPolicy,
    QoSProfile,
    QoSReliabilityPolicy,
)
from sensor_msgs.msg import Image, JointState, Joy, MagneticField, PointCloud2, TimeReference
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import MarkerArray

_IMAGES = QoSProfile(depth=50, reliability=QoSReliabilityPolicy.BEST_EFFORT)
"""Choice: half a second of frames at 100 Hz may wait; a node that must act on the newest keeps
fewer."""

KEPT = QoSProfile(history=QoSHistoryPolicy.KEEP_ALL)
"""Keep every message: to record and to play."""

_LATCHED = QoSProfile(history=QoSHistoryPolicy.KEEP_ALL,
                      durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
"""Receive also the last message from before the recording began."""

CHANGES = '/parameter_events'
"""Topic with every change of a parameter of a node, published by rclpy itself."""

TOPICS: dict[str, tuple[type, QoSProfile]] = {
    'camera/image_raw': (Image, _IMAGES),
    'overlay/image_raw': (Image, _IMAGES),
    'particles': (PointCloud2, KEPT),
    'particles/poses': (PoseArray, KEPT),
    'model/state': (PointCloud2, KEPT),
    'goal_pose': (PoseStamped, KEPT),
    'goals': (PoseArray, KEPT),
    'particle_goals': (PointCloud2, KEPT),
    'path': (Path, KEPT),
    'field/plan': (JointTrajectory, KEPT),
    'joy': (Joy, KEPT),
    'field/command': (Vector3Stamped, KEPT),
    'field/rotating': (TwistStamped, KEPT),
    'field/applied': (MagneticField, KEPT),
    'coils/command': (JointState, KEPT),
    'coils/applied': (JointState, KEPT),
    'coils/measured': (JointState, KEPT),
    'coil_driver/latency': (TimeReference, KEPT),
    'virtual_rig/truth': (PointCloud2, KEPT),
    'markers': (MarkerArray, KEPT),
    'tracker/kinds': (String, _LATCHED),
    'loop/log': (String, KEPT),
    '/diagnostics': (DiagnosticArray, KEPT),
    CHANGES: (ParameterEvent, KEPT),
}
"""Type of each topic, and the quality of service to subscribe with."""


def type_name(kind: type) -> str:
    """Return the name of a message type as recordings contain it: 'sensor_msgs/msg/Image'.

    Parameters
    ----------
    kind : type
        Class of the messages.

    Returns
    -------
    str
        Name of the type.
    """
    return f'{kind.__module__.partition(".")[0]}/msg/{kind.__name__}'
