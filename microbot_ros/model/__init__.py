"""Model of particle motion in four stages (field, heading, velocity, observation).

Examples
--------
One particle swims for a second along a field to the right:

>>> import numpy as np
>>> from microbot_ros.common.records import Commands
>>> from microbot_ros.model.first_order import simulate
>>> from microbot_ros.model.model import Model, ParticleParameters
>>> particle = ParticleParameters(np.array([0]), np.array([4e-6]), np.array([0.0]))
>>> commands = Commands(np.array([0.0]), np.array([[5e-3, 0.0]]))
>>> path = simulate(Model(5e-3), particle, commands, np.array([0.0, 1.0]), np.zeros((1, 2)))
>>> print((path[-1, 0] * 1e6).round(3))
[4. 0.]
"""
