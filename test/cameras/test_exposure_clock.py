"""Stamps of two clocks become moments on one, whatever frames do on their way."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from microbot_ros.cameras.exposure_clock import ExposureClock

DRIFT = 2e-4
ROUNDING = 1e-5
"""Of seconds since 1970 in a double, with what a drift makes of them."""

steps = st.floats(1e-4, 20.0)
delays = st.floats(0.0, 3.0)


@st.composite
def journeys(draw):
    """True moments of exposure, arrivals in order, and what a clock that drifts said of them."""
    pairs = draw(st.lists(st.tuples(steps, delays), min_size=1, max_size=40))
    least = draw(st.floats(0.0, 0.1))
    drift = draw(st.floats(-0.9 * DRIFT, 0.9 * DRIFT))
    offset = draw(st.floats(-2e9, 2e9))
    exposed = np.cumsum([step for step, _ in pairs]) + 1000.0
    arrived = np.maximum.accumulate(exposed + least + [delay for _, delay in pairs])
    return exposed, arrived, offset + exposed * (1 + drift), least


@given(journeys())
def test_after_the_exposure_before_the_arrival_and_in_order(journey):
    exposed, arrived, stamps, least = journey
    clock = ExposureClock(least)
    moments = np.array([clock.moment(*pair) for pair in zip(stamps, arrived, strict=True)])
    assert np.all(moments <= arrived - least + ROUNDING)
    assert np.all(moments >= exposed - ROUNDING)
    assert np.all(np.diff(moments) >= 0)
    assert clock.restarts == 0


@given(journeys())
def test_late_by_no_more_than_the_fastest_frame_was(journey):
    """The bound grows by both drifts with the age of that frame."""
    exposed, arrived, stamps, least = journey
    clock = ExposureClock(least)
    moments = [clock.moment(*pair) for pair in zip(stamps, arrived, strict=True)]
    for k, moment in enumerate(moments):
        way = arrived[:k + 1] - least - exposed[:k + 1]
        age = exposed[k] - exposed[:k + 1]
        assert moment - exposed[k] <= np.min(way + 2.0 * DRIFT * age * 1.01) + ROUNDING


@given(st.lists(st.tuples(
    st.one_of(st.floats(), st.sampled_from([math.nan, math.inf, -math.inf, 0.0, -1.0, 1e300])),
    steps), min_size=1, max_size=40), st.booleans())
def test_whatever_a_clock_says_nothing_is_in_the_future_or_goes_back(told, same_clock):
    clock = ExposureClock(0.01, same_clock)
    arrived, before = 50.0, -math.inf
    for stamp, step in told:
        arrived += step
        moment = clock.moment(stamp, arrived)
        assert math.isfinite(moment)
        assert before <= moment <= arrived
        before = moment


def test_a_clock_that_is_set_back_is_learned_anew():
    clock = ExposureClock()
    assert clock.moment(500.0, 10.0) == 10.0
    assert clock.moment(501.0, 11.5) == pytest.approx(11.0, abs=2.5 * DRIFT)
    assert clock.moment(3.0, 12.25) == 12.25
    assert clock.restarts == 1
    assert clock.moment(4.0, 13.9) == pytest.approx(13.25, abs=2.5 * DRIFT)


def test_a_stamp_without_sense_spoils_none_that_follow():
    clock = ExposureClock()
    clock.moment(500.0, 10.0)
    assert clock.moment(math.nan, 10.9) == 10.9
    assert clock.moment(501.5, 12.0) == pytest.approx(11.5, abs=2.5 * DRIFT)


def test_a_clock_set_forward_and_a_glitch_of_it():
    clock = ExposureClock()
    clock.moment(500.0, 10.0)
    assert clock.moment(9000.0, 11.0) == 11.0
    assert clock.moment(502.0, 12.0) == 12.0
    assert clock.moment(503.0, 13.6) == pytest.approx(13.0, abs=2.5 * DRIFT)


def test_a_stamp_of_our_own_clock_is_the_moment():
    clock = ExposureClock(0.02, same_clock=True)
    assert clock.moment(9.97, 10.0) == 9.97
    assert clock.moment(11.0, 10.5) == 10.48, 'the future is no moment of exposure'
    assert clock.moment(0.0, 100.0) == 99.98, 'nor is long ago'


def test_the_exposure_is_not_taken_for_the_way():
    """A frame arrives no earlier than its exposure ends: known, it is not in the error."""
    exposed = np.arange(1.0, 100.0, 0.02)
    way = 0.008 + 0.0003 + np.random.default_rng(1).exponential(2e-3, len(exposed))
    clock = ExposureClock(0.008)
    late = [clock.moment(7e5 + t, t + w) - t for t, w in zip(exposed, way, strict=True)]
    assert min(late[50:]) >= 0.0003 - ROUNDING
    assert max(late[50:]) < 0.0008
