"""What the figure and the sentences of a fit say."""

from __future__ import annotations

import numpy as np
import pytest

from microbot_ros.common.records import Conditions
from microbot_ros.estimation.likelihood.noise import Noise, implausible_diffusion
from microbot_ros.estimation.report import beside


@pytest.mark.parametrize(('angle', 'other', 'drawn'), [
    (-3.1, 3.1, 2 * np.pi - 3.1), (3.1, -3.1, 3.1 - 2 * np.pi), (1.0, 1.2, 1.0),
    (7.0, 0.0, 7.0 - 2 * np.pi), (-179 * np.pi / 180, np.pi, 181 * np.pi / 180)])
def test_an_angle_is_drawn_beside_the_one_that_it_is_compared_with(angle, other, drawn):
    assert beside(np.array([angle]), np.array([other]))[0] == pytest.approx(drawn)


@pytest.mark.parametrize(('factor', 'said', 'unsaid'), [
    (8.0, 'microbot discover', None), (0.2, 'viscosity', 'discover')])
def test_more_motion_than_diffusion_points_to_what_is_missing(factor, said, unsaid):
    conditions = Conditions('catalytic', radius=4.6e-6, viscosity=1.245e-3, temperature=298.15)
    (sentence,) = implausible_diffusion(
        conditions, Noise(3.81e-14 * factor, 1e-7, diffusion_std=1e-16))
    assert said in sentence
    assert not unsaid or unsaid not in sentence
