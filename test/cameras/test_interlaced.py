"""Interlaced pictures are known by the comb of what moves, and one of their moments is used."""

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
from hypothesis.extra import numpy as hnp

from microbot_ros.cameras.interlaced import interlaced, one_field

_V, _U = np.mgrid[:180, :300]
_SPEED = 6.0
"""Pixels from frame to frame."""


def _place(t: float) -> tuple[float, float]:
    return 30 + _SPEED * t, 80 + 20 * math.sin(t / 5)


def _moment(t: float, seed: int, noise: float = 2.0) -> np.ndarray:
    """A dark disc that moves, one that rests and fine stripes, at the time `t` of a frame."""
    picture = 150.0 + 20 * ((_U > 250) & (_V % 4 < 2))
    for x, y in (_place(t), (200.0, 150.0)):
        picture -= 80 / (1 + np.exp((np.hypot(_U - x, _V - y) - 7) / 0.8))
    picture += np.random.default_rng(seed).normal(0, noise, picture.shape)
    return np.clip(np.rint(picture), 0, 255).astype(np.uint8)


def _woven(t: int) -> np.ndarray:
    picture = _moment(t, t)
    picture[1::2] = _moment(t + 0.5, 1000 + t)[1::2]
    return picture


def test_what_moves_is_combed() -> None:
    assert interlaced([_woven(t) for t in range(0, 30, 5)])
    assert not interlaced([_moment(t, t) for t in range(0, 30, 5)])
    assert not interlaced([one_field(_woven(t)) for t in range(0, 30, 5)])
    assert interlaced([_woven(t).astype(np.uint16) * 257 for t in range(0, 30, 5)])


def test_noise_stripes_and_rows_that_always_differ_are_no_comb() -> None:
    assert not interlaced([_moment(t, t, noise=30.0) for t in range(0, 30, 5)])
    rows = np.where(_V % 2 == 0, 0.7, 1.0)
    assert not interlaced([(_moment(0, t) * rows).astype(np.uint8) for t in range(8)])
    assert not interlaced([_woven(3)] * 5)
    assert not interlaced([np.zeros((3, 9), np.uint8)] * 3)


@given(hnp.arrays(st.sampled_from([np.uint8, np.uint16]),
                  hnp.array_shapes(min_dims=2, max_dims=3, min_side=1, max_side=9)))
def test_the_even_rows_stay_and_the_odd_ones_are_their_mean(picture: np.ndarray) -> None:
    field = one_field(picture)
    assert field.dtype == picture.dtype
    np.testing.assert_array_equal(field[::2], picture[::2])
    for y in range(1, len(picture), 2):
        below = picture[y + 1] if y + 1 < len(picture) else picture[y - 1]
        between = (picture[y - 1].astype(float) + below) / 2
        assert np.abs(field[y] - between).max() <= 0.5


def _off(folder: Path) -> np.ndarray:
    """How far [px] the moving disc was from its place at the time of the even rows: (frames, 2).
    """
    with (folder / 'tracks.csv').open() as stream:
        rows = list(csv.DictReader(stream))
    first = min(rows, key=lambda row: math.dist(
        _place(int(row['frame'])), (float(row['x_px']), float(row['y_px']))))['particle']
    return np.array([np.subtract((float(row['x_px']), float(row['y_px'])),
                                 _place(int(row['frame'])))
                     for row in rows if row['particle'] == first])


def test_an_interlaced_film_is_tracked_by_one_moment_and_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    film = tmp_path / 'film'
    film.mkdir()
    for t in range(30):
        cv2.imwrite(str(film / f'{t}.png'), _woven(t))
    out = tmp_path / 'out'
    assert microbot('track', film, '--out', out, '--like', '0,30,80', '--no-overlay') == 0
    assert 'its images are interlaced' in capsys.readouterr().err
    off = _off(out)
    assert len(off) == 30
    assert np.sqrt(np.mean(off**2)) < 0.05  # by both moments together it is 1.2 px
