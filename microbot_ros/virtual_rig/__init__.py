"""Simulated rig: particles with hidden effects, microscope, camera and coils.

Examples
--------
>>> from microbot_ros.virtual_rig.injected_effects import INJECTABLE
>>> 'uniform_drift' in INJECTABLE
True
"""
