"""Shared basis of all rooms: units, records, settings, errors, files, plug-ins, compiled code.

Examples
--------
Names end in their unit at the edge of the package; inside, all numbers are SI:

>>> from microbot_ros.common.units import from_si, to_si
>>> to_si('field_mT', 5.0), from_si('x_um', 2e-6)
(0.005, 2.0)
"""
