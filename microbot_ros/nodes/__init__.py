"""ROS 2 nodes around the other rooms; the only room that imports ROS.

Examples
--------
>>> from microbot_ros.nodes.base.topics import TOPICS
>>> TOPICS['field/command'][0].__name__
'Vector3Stamped'
"""
