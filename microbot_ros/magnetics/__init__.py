"""Coil geometry, Biot–Savart fields, field maps, and coil currents for a wanted field.

Examples
--------
Currents of the default rig for a field of 3 mT to the right:

>>> from microbot_ros.magnetics import Allocator, CoilSet
>>> coils = CoilSet()
>>> found = Allocator(coils).allocate([3e-3, 0.0])
>>> [field] = coils.field(found.currents, [[0.0, 0.0, 0.0]])
>>> print(f'{field[0] * 1e3:.3f} mT')
3.000 mT
"""

from microbot_ros.magnetics.allocation import Allocation, Allocator
from microbot_ros.magnetics.coils import CoilSet
from microbot_ros.magnetics.settings import CoilSettings, Winding
from microbot_ros.magnetics.sources import Loop, Polyline

__all__ = ['Allocation', 'Allocator', 'CoilSet', 'CoilSettings', 'Loop', 'Polyline', 'Winding']
