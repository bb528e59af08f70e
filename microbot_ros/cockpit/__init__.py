"""The operator's page and its server: pictures, state and verbs over one socket, without ROS.

Examples
--------
Pages send verbs as JSON; anything else is refused with a reason:

>>> from microbot_ros.cockpit.verbs import read_verb
>>> read_verb('{"verb": "stick", "x": 0.5, "y": 0}').x
0.5
"""
