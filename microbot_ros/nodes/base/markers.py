"""Markers for RViz: particles with their speed, and goals."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from microbot_ros.nodes.base.messages import WORKSPACE

_BLUE, _ORANGE = ColorRGBA(r=0.0, g=0.45, b=0.7, a=1.0), ColorRGBA(r=0.9, g=0.6, b=0.0, a=1.0)
"""Colours of particles and goals: two of the palette for colour-blind readers of Okabe and Ito
(2008)."""
_SIZE = 5e-6
"""Size of markers and labels [m]. Choice: about the diameter of a particle."""


def markers(particles: np.ndarray, goals: np.ndarray, stamp: Time) -> MarkerArray:
    """Return spheres and labels of particles, and cubes at goals.

    Parameters
    ----------
    particles : ndarray, shape (N,)
        ESTIMATE of each particle.
    goals : ndarray, shape (G, 2)
        Goals [m]; those that are not finite are left out.
    stamp : Time
        Stamp of the message.

    Returns
    -------
    MarkerArray
        The markers.
    """
    finite = goals[np.isfinite(goals).all(axis=1)]
    made = [
        _points(Marker.SPHERE_LIST, 'particles', zip(particles['x'], particles['y'], strict=True),
                _BLUE, stamp),
        _points(Marker.CUBE_LIST, 'goals', finite, _ORANGE, stamp),
    ]
    made += [_label(particle, stamp) for particle in particles]
    return MarkerArray(markers=[Marker(action=Marker.DELETEALL), *made])


def _points(kind: int, name: str, places: Iterable[Any], colour: ColorRGBA, stamp: Time) -> Marker:
    marker = Marker(type=kind, ns=name, color=colour)
    marker.header.frame_id, marker.header.stamp = WORKSPACE, stamp
    marker.scale.x = marker.scale.y = marker.scale.z = _SIZE
    marker.pose.orientation.w = 1.0
    marker.points = [Point(x=float(x), y=float(y)) for x, y in places]
    return marker


def _label(particle: np.void, stamp: Time) -> Marker:
    marker = Marker(type=Marker.TEXT_VIEW_FACING, ns='labels', id=int(particle['id']), color=_BLUE)
    marker.header.frame_id, marker.header.stamp = WORKSPACE, stamp
    marker.scale.z = _SIZE
    marker.pose.orientation.w = 1.0
    marker.pose.position.x = float(particle['x'])
    marker.pose.position.y = float(particle['y']) + 1.5 * _SIZE
    known = np.isfinite(particle['speed_std'])
    speed = f': {particle["speed"] * 1e6:.1f} µm/s' if known else ''
    marker.text = f'{particle["id"]}{speed}'
    return marker
