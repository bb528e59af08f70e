"""The closed loop as a function of a frame: tracker, model, controller, allocation and gate.

Examples
--------
>>> from microbot_ros.loop.loop import Loop, LoopParameters
>>> loop = Loop(LoopParameters())
>>> len(loop.allocation.coils.names), loop.gate.armed
(4, False)
"""
