"""The nodes by name."""

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
"""Node name → class in the module of the same name; imported only where it runs."""

LOOP_NODES = ('camera', 'tracker', 'model', 'controller', 'coil_driver')
"""Nodes that run in real time."""
