"""The kit tries a controller in whatever happens on a rig."""

from my_lab.northwards import Northwards

from microbot_ros.control.testkit import exercise


def test_northwards_keeps_the_contract():
    exercise(Northwards)
