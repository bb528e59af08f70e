"""Coil geometry, Biot–Savart fields, field maps, and coil currents for a wanted field."""

from microbot_ros.magnetics.allocation import Allocation, Allocator
from microbot_ros.magnetics.coils import CoilSet
from microbot_ros.magnetics.settings import CoilSettings, Winding
from microbot_ros.magnetics.sources import Loop, Polyline

__all__ = ['Allocation', 'Allocator', 'CoilSet', 'CoilSettings', 'Loop', 'Polyline', 'Winding']
