"""Places of soft discs: at the Cramér–Rao bound where there is one, else left alone."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from microbot_ros.tracking.refine.disc_fit import refine


def disc(x, y, height=-60.0, light=120.0, radius=7.0, soft=0.9, size=40):
    v, u = np.mgrid[:size, :size]
    r = np.hypot(u - x, v - y)
    return light + height / (1 + np.exp((r - radius) / soft))


def refined(image, x, y, height=-50.0, radius=6.0, edge=2.0, length=1.0, cut=False, noise=3.0):
    places, sigma, fitted = refine(
        image, np.array([[x, y]]), np.array([radius]), np.array([edge]), np.array([height]),
        np.array([length]), np.array([cut]), noise)
    return places[0], sigma[0], fitted[0]


def bound(noise, **parts):
    """Of x and y together, from differences of pictures: nothing of the fit is used."""
    values = {'x': 20.3, 'y': 19.6, 'height': -60.0, 'light': 120.0, 'radius': 7.0, 'soft': 0.9}
    values |= parts
    v, u = np.mgrid[:40, :40]
    seen = np.hypot(u - values['x'], v - values['y']) < values['radius'] + 3 * values['soft'] + 2
    slopes = []
    for name in values:
        up, down = ({**values, name: values[name] + step} for step in (1e-5, -1e-5))
        slopes.append((disc(**up) - disc(**down))[seen] / 2e-5)
    inverse = np.linalg.inv(np.array(slopes) @ np.array(slopes).T)
    return noise * np.sqrt((inverse[0, 0] + inverse[1, 1]) / 2)


def test_places_reach_the_bound_and_know_it():
    rng, noise, off, told = np.random.default_rng(4), 3.0, [], []
    for _ in range(300):
        x, y = 20 + rng.uniform(-0.5, 0.5, 2)
        image = disc(x, y) + rng.normal(0, noise, (40, 40))
        place, sigma, fitted = refined(image, x + rng.normal(0, 0.4), y + rng.normal(0, 0.4))
        assert fitted
        off.append(place - (x, y))
        told.append(sigma)
    reached = np.sqrt(np.mean(np.square(off)))
    assert reached == pytest.approx(bound(noise), rel=0.1)
    assert np.mean(told) == pytest.approx(reached, rel=0.1)
    assert abs(np.mean(off)) < 3 * reached / np.sqrt(600)


def test_what_is_no_disc_keeps_its_place():
    rng = np.random.default_rng(5)
    pictures = {
        'noise': rng.normal(120, 3, (40, 40)), 'even': np.full((40, 40), 120.0),
        'ring': disc(20, 20) - disc(20, 20, radius=4.0) + 120,
        'dark on a bright one': 240 - disc(20, 20)}
    for name, picture in pictures.items():
        place, sigma, fitted = refined(picture, 20.4, 19.7)
        assert not fitted, name
        assert np.isnan(sigma), name
        assert place.tolist() == [20.4, 19.7], name
    assert not refined(disc(20, 20), 20.0, 20.0, length=2.0)[2]


@given(arrays.arrays(np.float64, (24, 24), elements=st.sampled_from(
           [0.0, 1.0, 120.0, 255.0, 65535.0, -1e9, 1e300, np.nan, np.inf])),
       st.floats(-5, 30), st.floats(-5, 30), st.floats(0.1, 40), st.floats(0.0, 20),
       st.sampled_from([-1e12, -50.0, 0.0, 50.0]), st.booleans())
def test_no_picture_breaks_it(image, x, y, radius, edge, height, cut):
    place, sigma, fitted = refined(image, x, y, height=height, radius=radius, edge=edge, cut=cut)
    assert np.isfinite(place).all()
    assert fitted == np.isfinite(sigma)
