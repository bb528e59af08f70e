"""Dose and response: speed, turning and slip at each plateau of a commanded quantity.

Examples
--------
>>> import numpy as np
>>> from microbot_ros.common.records import Commands
>>> from microbot_ros.response.plateaus import levels
>>> commands = Commands(np.arange(3.0), np.full((3, 2), 5e-3), np.array([1.0, 2.0, 4.0]))
>>> levels(commands, 'frequency').tolist()
[1.0, 2.0, 4.0]
"""
