"""Cut-in and step-out from the plateaus of robots with a gain each."""

import numpy as np
import pytest

from microbot_ros.model.effects.velocity.drive_response import hill
from microbot_ros.response.curve import fit_curve

F = np.arange(1.0, 21.0)


def robots(rng, cut_in=0.0, slip=1.0, step_out=9.0, count=6, scatter=0.04, f=F):
    law = f * hill(f, cut_in, 2.0) * (1 - slip * hill(f, step_out, 4.0))
    gain = rng.uniform(2e-6, 4e-6, count)
    speed = gain[:, None] * law * (1 + scatter * rng.normal(size=(count, len(f))))
    std = 0.02 * np.abs(speed) + 1e-8
    return (np.tile(f, count), speed.ravel(), std.ravel(), np.repeat(np.arange(count), len(f)))


# (seeds, fewest intervals of 95 % that hold the truth)
FITS = [(range(4), 3), pytest.param(range(20), 17, marks=pytest.mark.soak)]


@pytest.mark.parametrize(('seeds', 'fewest'), FITS)
def test_step_out_is_found_with_an_interval_that_holds_it(seeds, fewest):
    inside = 0
    for seed in seeds:
        found = fit_curve(*robots(np.random.default_rng(seed)))
        assert found.steps_out(20.0)
        assert found.step_out.value == pytest.approx(9.0, rel=0.08)
        assert found.step_out.high - found.step_out.low < 2.0
        inside += found.step_out.low < 9.0 < found.step_out.high
    assert inside >= fewest


@pytest.mark.parametrize(('seeds', 'fewest'), FITS)
def test_cut_in_is_found_with_an_interval_that_holds_it(seeds, fewest):
    inside = 0
    for seed in seeds:
        found = fit_curve(*robots(np.random.default_rng(seed), cut_in=3.0, slip=0.0))
        assert not found.steps_out(20.0)
        inside += found.cut_in.low < 3.0 < found.cut_in.high
        assert found.cut_in.low > 0.5
    assert inside >= fewest


def test_proportional_rollers_have_neither():
    found = fit_curve(*robots(np.random.default_rng(3), slip=0.0))
    assert not found.steps_out(20.0)
    assert found.cut_in.low == 0
    assert found.cut_in.high < 1.0
    assert found.scatter < 0.08
    np.testing.assert_allclose(found.speed(F) / F, found.speed(F)[9] / F[9], rtol=0.1)


def test_a_step_out_beyond_what_was_driven_is_not_claimed():
    found = fit_curve(*robots(np.random.default_rng(4), step_out=60.0))
    assert not found.steps_out(20.0)


@pytest.mark.parametrize('few', [0, 1, 3])
def test_too_few_frequencies_have_no_law(few):
    assert fit_curve(*robots(np.random.default_rng(5), f=F[:few])) is None


def test_numbers_that_are_none_are_left_out():
    f, speed, std, robot = robots(np.random.default_rng(6))
    spoiled, unknown = speed.copy(), std.copy()
    spoiled[3] = np.nan
    unknown[5] = np.nan
    found = fit_curve(f, spoiled, unknown, robot)
    assert found.step_out.value == pytest.approx(9.0, rel=0.08)
