"""The topics of the graph that are worth keeping, with what it takes to hear them."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseArray, PoseStamped, Vector3Stamped
from nav_msgs.msg import Path
from rcl_interfaces.msg import ParameterEvent
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from sensor_msgs.msg import Image, JointState, Joy, MagneticField, PointCloud2, TimeReference
from visualization_msgs.msg import MarkerArray

from microbot_ros.nodes.lifecycle import RELIABLE

_IMAGES = QoSProfile(depth=50, reliability=QoSReliabilityPolicy.BEST_EFFORT)
"""Half a second of frames at 100 Hz may wait; a node that must act on the newest takes fewer."""

CHANGES = '/parameter_events'
"""Every change of a parameter of a node, made by rclpy itself."""

TOPICS: dict[str, tuple[type, QoSProfile]] = {
    'camera/image_raw': (Image, _IMAGES),
    'overlay/image_raw': (Image, _IMAGES),
    'particles': (PointCloud2, RELIABLE),
    'particles/poses': (PoseArray, RELIABLE),
    'model/state': (PointCloud2, RELIABLE),
    'goal_pose': (PoseStamped, RELIABLE),
    'goals': (PoseArray, RELIABLE),
    'particle_goals': (PointCloud2, RELIABLE),
    'path': (Path, RELIABLE),
    'joy': (Joy, RELIABLE),
    'field/command': (Vector3Stamped, RELIABLE),
    'field/rotation': (Vector3Stamped, RELIABLE),
    'field/applied': (MagneticField, RELIABLE),
    'coils/command': (JointState, RELIABLE),
    'coils/applied': (JointState, RELIABLE),
    'coils/measured': (JointState, RELIABLE),
    'coil_driver/latency': (TimeReference, RELIABLE),
    'virtual_rig/truth': (PointCloud2, RELIABLE),
    'markers': (MarkerArray, RELIABLE),
    '/diagnostics': (DiagnosticArray, RELIABLE),
    CHANGES: (ParameterEvent, RELIABLE),
}
"""Topic → its type, and the quality of service to subscribe with."""
