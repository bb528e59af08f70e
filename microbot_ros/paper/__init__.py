"""Repetition of the paper's experiment, in simulation.

Examples
--------
>>> from microbot_ros.paper.repetition import record
>>> session = record(seed=1)
>>> session.tracks.particles.tolist(), round(float(session.tracks.t[-1]))
([0, 1, 2], 15)
"""
