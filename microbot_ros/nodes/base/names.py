"""Names of the nodes."""

from __future__ import annotations

NODES = {
    'camera': 'CameraNode',
    'tracker': 'TrackerNode',
    'model': 'ModelNode',
    'controller': 'ControllerNode',
    'coil_driver': 'CoilDriverNode',
    'virtual_rig': 'VirtualRigNode',
    'recorder': 'RecorderNode',
    'player': 'PlayerNode',
    'cockpit': 'CockpitNode',
}
"""Class of each node in the module of the same name; imported only where it runs."""

LOOP_NODES = ('camera', 'tracker', 'model', 'controller', 'coil_driver')
"""Nodes that run with real-time priority."""
