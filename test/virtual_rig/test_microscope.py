"""The picture tells the truth: where, which way round, how noisy."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from microbot_ros.common.checked import SettingsError
from microbot_ros.virtual_rig.microscope import Microscope, MicroscopeSettings

CLEAN = {'vignette': 0, 'slope': 0, 'specks': 0, 'smudges': 0, 'drifting': 0}
PLAIN = MicroscopeSettings(width_px=96, height_px=80, cap_absorption=0, **CLEAN)
CAPPED = MicroscopeSettings(width_px=96, height_px=80, **CLEAN)


def centroid(light, brightness):
    """Centre (x, y) [px] of the missing light, every pixel counted."""
    y, x = np.indices(light.shape)
    dark = brightness - light.astype(float)
    return np.array([(dark * x).sum(), (dark * y).sum()]) / dark.sum()


def where(position, scope):
    """The picture's coordinates worked out by hand from the definition."""
    s, (x, y) = scope.settings, position
    size = s.pixel_size_um * 1e-6
    return np.array([(s.width_px - 1) / 2 + x / size, (s.height_px - 1) / 2 - y / size])


@settings(max_examples=25)
@given(st.floats(-5e-6, 5e-6), st.floats(-5e-6, 5e-6), st.floats(0, 17))
def test_bare_sphere_is_drawn_exactly_where_it_is(x, y, t):
    scope = Microscope(PLAIN, 0)
    light = scope.expose(np.array([[x, y]]), np.zeros(1), t)
    error = centroid(light, PLAIN.brightness) - where((x, y), scope)
    assert np.abs(error).max() < 2e-3


def test_cap_pulls_the_centroid_only_backwards():
    scope = Microscope(CAPPED, 0)
    place = np.array([[1.23e-6, -2.34e-6]])
    headings = np.linspace(-np.pi, np.pi, 16, endpoint=False)
    pulls = np.array([
        centroid(scope.expose(place, np.array([heading]), 0), CAPPED.brightness)
        - where(place[0], scope) for heading in headings
    ])
    backwards = -np.column_stack((np.cos(headings), -np.sin(headings)))
    along = (pulls * backwards).sum(1)
    assert np.abs(pulls - along[:, None] * backwards).max() < 0.02
    assert along.min() > 0.3
    assert np.abs(pulls.mean(0)).max() < 0.02


def test_y_points_up_and_the_cap_trails():
    scope = Microscope(CAPPED, 0)
    light = scope.expose(np.array([[0, 10e-6]]), np.array([np.pi / 2]), 0)
    row = (80 - 1) / 2 - 10 / CAPPED.pixel_size_um
    assert light[round(row - 3), 47] > light[round(row + 3), 47] + 30
    assert light[60, 47] == CAPPED.brightness


def test_noise_is_shot_plus_read_noise():
    chosen = MicroscopeSettings(read_noise=1.0, electrons_per_level=25, **CLEAN)
    scope = Microscope(chosen, 3)
    empty = np.empty((0, 2)), np.empty(0)
    first, second = (scope.render(*empty, 0).astype(float) for _ in range(2))
    expected = chosen.brightness / 25 + 1.0 + 1 / 12  # and the rounding to whole levels
    assert np.var(first - second) / 2 == pytest.approx(expected, rel=0.02)
    assert first.mean() == pytest.approx(chosen.brightness, abs=0.02)
    assert abs(np.corrcoef(first[:-1].ravel(), first[1:].ravel())[0, 1]) < 0.01


def test_seed_fixes_the_frames():
    position, theta = np.zeros((1, 2)), np.zeros(1)
    frames = [Microscope(MicroscopeSettings(), seed).render(position, theta, 1.5)
              for seed in (1, 1, 2)]
    assert frames[0].shape == (480, 640)
    assert frames[0].dtype == np.uint8
    assert np.array_equal(frames[0], frames[1])
    assert not np.array_equal(frames[0], frames[2])


@pytest.mark.parametrize('place', [
    (np.nan, 0), (0, np.inf), (-np.inf, 0), (1, 0), (0, -1), (0, 1e300)])
def test_what_is_nowhere_or_out_of_view_is_not_drawn(place):
    scope = Microscope(CAPPED, 0)
    assert (scope.expose(np.array([place]), np.zeros(1), 0) == CAPPED.brightness).all()


def test_a_sphere_at_the_border_is_cut_off():
    scope = Microscope(PLAIN, 0)
    corner = np.array([[-47.5, 39.5]]) * PLAIN.pixel_size_um * 1e-6
    whole = PLAIN.brightness - scope.expose(np.zeros((1, 2)), np.zeros(1), 0).astype(float)
    quarter = PLAIN.brightness - scope.expose(corner, np.zeros(1), 0).astype(float)
    assert 0.25 < quarter.sum() / whole.sum() < 0.4


def test_drifting_debris_moves_and_the_rest_stays():
    still = MicroscopeSettings(drifting=0)
    moving = MicroscopeSettings(drifting=6, drift_um_s=2.0)
    empty = np.empty((0, 2)), np.empty(0)
    for chosen, same in ((still, True), (moving, False)):
        scope = Microscope(chosen, 5)
        assert np.array_equal(scope.expose(*empty, 0), scope.expose(*empty, 10)) is same


def test_no_setting_may_be_nan_or_out_of_range():
    for name in MicroscopeSettings.names():
        for bad in (np.nan, np.inf, -np.inf, -1):
            with pytest.raises(SettingsError, match=name):
                MicroscopeSettings(**{name: bad})
