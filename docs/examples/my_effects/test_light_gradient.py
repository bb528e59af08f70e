"""The kit tries an effect on whatever a recording may hold, and has discovery find it."""

from my_effects.light_gradient import LightGradient

from microbot_ros.conformance import exercise, exercise_discovery


def test_light_gradient_keeps_the_contract():
    exercise(LightGradient)


def test_light_gradient_is_found_where_it_is():
    exercise_discovery(LightGradient(east=0.9, north=-0.4))
