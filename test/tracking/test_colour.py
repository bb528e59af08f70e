"""Kinds that differ by their colour alone are told by the sum of colours that shows them."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import microbot
from hypothesis import given
from hypothesis import strategies as st

from microbot_ros.common.errors import InputError
from microbot_ros.tracking.locate.colour import Spot, telling_weights, weighted

_BRIGHTNESS = (0.299, 0.587, 0.114)
_LIGHT = np.array([140.0, 150.0, 145.0])
_V, _U = np.mgrid[:200, :320]


def _as_bright_as_the_light(blue: float, green: float, red: float) -> np.ndarray:
    colour = np.array([blue, green, red])
    return np.asarray(colour + np.dot(_LIGHT - colour, _BRIGHTNESS[::-1]))


_RED, _GREEN = _as_bright_as_the_light(110, 133, 200), _as_bright_as_the_light(110, 170, 92)


def _picture(*beads: tuple[tuple[float, float], np.ndarray], seed: int = 1) -> np.ndarray:
    """Discs 14 px wide at places, of colours, blue first, in noise."""
    picture = np.tile(_LIGHT, (*_U.shape, 1))
    for (x, y), colour in beads:
        covered = 1 / (1 + np.exp((np.hypot(_U - x, _V - y) - 7) / 0.8))
        picture += covered[..., None] * (colour - picture)
    noisy = picture + np.random.default_rng(seed).normal(0, 2, picture.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


_REDS, _GREENS = ((60.0, 50.0), (250.0, 150.0)), ((60.0, 150.0), (250.0, 50.0))


def _both(seed: int = 1) -> np.ndarray:
    return _picture(*((at, _RED) for at in _REDS), *((at, _GREEN) for at in _GREENS), seed=seed)


def _stands_out(grey: np.ndarray, places: tuple[tuple[float, float], ...]) -> float:
    """Mean contrast of discs at `places` over the noise of the light."""
    inside = [grey[np.hypot(_U - x, _V - y) < 4].mean() for x, y in places]
    light = grey[90:110].astype(float)
    return float((np.mean(inside) - light.mean()) / light.std())


def test_the_colour_pointed_at_shows_and_the_other_does_not() -> None:
    picture = _both()
    found = telling_weights([Spot(picture, *_REDS[0], 'red')])
    assert found is not None
    grey = weighted(picture, found[0])
    assert found[1] > 3
    assert abs(_stands_out(grey, _REDS)) > 20
    # A kind begins at 0.45 of the contrast of its example.
    assert abs(_stands_out(grey, _GREENS)) < 0.25 * abs(_stands_out(grey, _REDS))
    assert abs(_stands_out(weighted(picture, _BRIGHTNESS), _REDS)) < 1


def test_of_two_kinds_one_is_darker_and_the_other_brighter() -> None:
    picture = _both()
    found = telling_weights([Spot(picture, *_REDS[0], 'red'), Spot(picture, *_GREENS[0], 'green')])
    assert found is not None
    shown = [_stands_out(weighted(picture, found[0]), places) for places in (_REDS, _GREENS)]
    assert min(np.abs(shown)) > 6
    assert shown[0] * shown[1] < 0


def test_brightness_stays_where_it_does_as_well_or_there_is_nothing_else() -> None:
    dark = _picture(((60.0, 50.0), np.array([60.0, 60.0, 60.0])))
    assert telling_weights([Spot(dark, 60.0, 50.0, 'dark')]) is None
    grey = cv2.cvtColor(_both(), cv2.COLOR_BGR2GRAY)
    assert telling_weights([Spot(grey, *_REDS[0], 'red')]) is None
    equal = cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)
    assert telling_weights([Spot(equal, *_REDS[0], 'red')]) is None
    assert telling_weights([Spot(_both(), 320.0, 50.0, 'red')]) is None


def test_a_counter_example_of_the_same_colour_does_not_hide_the_example() -> None:
    picture = _both()
    spots = [Spot(picture, *_REDS[0], 'red'), Spot(picture, *_REDS[1], None)]
    found = telling_weights(spots)
    assert found is not None
    assert abs(_stands_out(weighted(picture, found[0]), _REDS)) > 8


@given(st.tuples(*[st.floats(-1, 1)] * 3).filter(any), st.sampled_from([np.uint8, np.uint16]),
       st.integers(3, 4))
def test_no_colour_leaves_the_scale_and_its_middle_stays(
    weights: tuple[float, float, float], depth: type, channels: int
) -> None:
    most = np.iinfo(depth).max
    corners = np.array(np.meshgrid(*[[0, most]] * 3)).reshape(3, 1, 8).transpose(1, 2, 0)
    picture = np.concatenate([corners, np.full((1, 8, channels - 3), 7)], axis=2).astype(depth)
    grey = weighted(picture, weights)
    share = np.array(weights) / np.sum(np.abs(weights))
    truth = most / 2 + (corners[..., ::-1] - most / 2) @ share
    assert grey.dtype == depth
    np.testing.assert_allclose(grey, truth, atol=0.51)


def test_brightness_is_that_of_the_usual_grey() -> None:
    picture = _both()
    usual = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY).astype(int)
    assert np.abs(weighted(picture, _BRIGHTNESS) - usual).max() <= 1


def test_a_grey_picture_has_no_colours() -> None:
    with pytest.raises(InputError, match='expected colour images'):
        weighted(np.zeros((4, 4), np.uint8), (1.0, 0.0, 0.0))


_FRAMES = 30


def _places(t: int) -> tuple[list[tuple[float, float]], list[tuple[float, float]]]:
    """Of red and green ones in frame `t`: they go past each other."""
    reds = [(40 + 6.0 * t, 40.0 + 40 * k) for k in range(4)]
    greens = [(280 - 6.0 * t, 60.0 + 40 * k) for k in range(3)]
    return reds, greens


@pytest.fixture(scope='module')
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp('beads')
    for t in range(_FRAMES):
        reds, greens = _places(t)
        picture = _picture(*((at, _RED) for at in reds), *((at, _GREEN) for at in greens), seed=t)
        cv2.imwrite(str(folder / f'{t}.png'), picture)
    return folder


def _of(folder: Path) -> list[dict[str, str]]:
    with (folder / 'tracks.csv').open() as stream:
        return list(csv.DictReader(stream))


def _count(rows: list[dict[str, str]], kind: str, which: int) -> int:
    """How many rows of a `kind` are within a pixel of red, 0, or green ones, 1."""
    return sum(row['kind'] == kind and min(
        math.dist(at, (float(row['x_px']), float(row['y_px'])))
        for at in _places(int(row['frame']))[which]) < 1 for row in rows)


def test_two_kinds_of_equal_brightness_are_followed_each_under_its_name(
    film: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / 'out'
    assert microbot('track', film, '--out', out, '--like', '0,40,40,red',
                    '--like', '0,280,60,green') == 0
    assert 'detected by colour' in capsys.readouterr().err
    rows = _of(out)
    assert (_count(rows, 'red', 0), _count(rows, 'green', 1)) == (4 * _FRAMES, 3 * _FRAMES)
    assert len(rows) == 7 * _FRAMES
    assert len({row['particle'] for row in rows}) == 7
    again = tmp_path / 'again'
    assert microbot('track', film, '--out', again, '--settings', out / 'learned.yaml') == 0
    assert _of(again) == rows


def test_one_kind_leaves_the_other_colour_out_and_a_counter_example_may_vanish(
    film: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert microbot('track', film, '--out', tmp_path / 'out', '--like', '0,40,40',
                    '--unlike', '0,280,60') == 0
    assert 'at 280,60 nothing like it is left, by colour' in capsys.readouterr().err
    rows = _of(tmp_path / 'out')
    assert _count(rows, 'robot', 0) == len(rows) == 4 * _FRAMES
