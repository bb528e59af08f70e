"""Random effects: against published numbers, against chance, and at the limits."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from microbot_ros.archive.conclusions.random_effects import spread, trend, unlike

# Colditz et al. 1994, BCG vaccine against tuberculosis: cases and others, vaccinated and not. What
# metafor makes of it is in every textbook (Viechtbauer 2010).
BCG = np.array([
    (4, 119, 11, 128), (6, 300, 29, 274), (3, 228, 11, 209), (62, 13536, 248, 12619),
    (33, 5036, 47, 5761), (180, 1361, 372, 1079), (8, 2537, 10, 619), (505, 87886, 499, 87892),
    (29, 7470, 45, 7232), (17, 1699, 65, 1600), (186, 50448, 141, 27197), (5, 2493, 3, 2338),
    (27, 16886, 29, 17825)], float)


def bcg():
    a, b, c, d = BCG.T
    return (np.log(a / (a + b) / (c / (c + d))),
            np.sqrt(1 / a - 1 / (a + b) + 1 / c - 1 / (c + d)))


def draw(rng, count=15, between=0.5):
    stds = rng.uniform(0.2, 0.6, count)
    return 3 + between * rng.standard_normal(count) + stds * rng.standard_normal(count), stds


def test_published_numbers():
    found = spread(*bcg())
    assert found.between**2 == pytest.approx(0.3180, abs=2e-4)
    assert found.between_low**2 == pytest.approx(0.1197, abs=2e-4)
    assert found.between_high**2 == pytest.approx(1.1115, abs=2e-4)
    assert found.mean == pytest.approx(-0.7150, abs=5e-4)
    assert found.p_value == pytest.approx(0.0, abs=1e-4)


@pytest.mark.parametrize('between', [0.0, 0.3, 1.0])
def test_intervals_hold_the_truth(between):
    rng = np.random.default_rng(5)
    found = [spread(*draw(rng, between=between)) for _ in range(400)]
    spreads = np.mean([one.between_low <= between <= one.between_high for one in found])
    means = np.mean([one.mean_low <= 3 <= one.mean_high for one in found])
    # With no spread at all only the upper tail can miss.
    assert 0.92 <= spreads <= (1.0 if between == 0 else 0.98)
    assert 0.92 <= means <= 0.99


@given(st.floats(1e-9, 1e9), st.floats(-1e3, 1e3))
def test_units_and_origin_do_not_matter(unit, origin):
    y, s = draw(np.random.default_rng(3))
    one, other = spread(y, s), spread(unit * (y + origin), unit * s)
    assert other.mean == pytest.approx(unit * (one.mean + origin), rel=1e-6, abs=1e-6 * unit)
    for part in ('between', 'between_low', 'between_high', 'mean_std'):
        assert getattr(other, part) == pytest.approx(unit * getattr(one, part), rel=1e-4)


@pytest.mark.parametrize('bad', [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_is_left_out(bad):
    y, s = draw(np.random.default_rng(4))
    assert spread(np.append(y, bad), np.append(s, 1.0)) == spread(y, s)
    assert spread(np.append(y, 3.0), np.append(s, bad)) == spread(y, s)
    assert spread(np.array([bad]), np.array([1.0])) is None


def test_one_session_knows_no_spread():
    found = spread(np.array([2.0]), np.array([0.1]))
    assert np.isnan(found.between)
    assert (found.between_low, found.between_high) == (0.0, np.inf)
    assert found.mean_high == pytest.approx(2.196)


def test_a_drift_is_found_and_none_is_not():
    rng = np.random.default_rng(6)
    weeks = np.arange(30.0)
    y, s = draw(rng, 30)
    line = trend(weeks, y + 0.2 * weeks, s)
    assert abs(line.slope - 0.2) < 3 * line.std
    assert line.p_value < 1e-6
    chances = [trend(weeks, *draw(rng, 30)).p_value for _ in range(200)]
    assert 0.01 <= np.mean(np.array(chances) < 0.05) <= 0.1
    assert trend(weeks[:4], y[:4], s[:4]) is None
    assert trend(np.full(30, 7.0), y, s) is None
    assert trend(np.full(30, np.nan), y, s) is None


def test_who_is_unlike_the_others_is_told_and_nobody_else():
    y, s = draw(np.random.default_rng(7), 40)
    y[11] += 6.0
    chances = unlike(y, s)
    assert chances[11] < 1e-5
    assert np.delete(chances, 11).min() > 1e-3
    assert np.isnan(unlike(y[:4], s[:4])).all()
    y[3] = np.nan
    assert np.isnan(unlike(y, s)[3])
