"""Controllers, their shared parts, and the manager that runs and switches them.

Examples
--------
>>> from microbot_ros.control.registry import controller_class
>>> controller_class('waypoint').summary
'Drive one particle to a goal or through a list of goals.'
"""
