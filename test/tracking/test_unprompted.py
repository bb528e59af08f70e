"""What `microbot track` follows without being told: by a kind where that is better."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path

import cv2
import numpy as np
from command_line import microbot

_V, _U = np.mgrid[:240, :320]
_FRAMES = 40


def _rim(x: float, y: float, angle: float, length: float, width: float) -> np.ndarray:
    """Distance from the rim of a rod with round ends, or of a disc, at an `angle`."""
    half = (length - width) / 2
    along = np.clip((_U - x) * math.cos(angle) + (_V - y) * math.sin(angle), -half, half)
    return np.asarray(np.hypot(
        _U - x - along * math.cos(angle), _V - y - along * math.sin(angle)) - width / 2)


def _places(t: int) -> list[tuple[float, float, float]]:
    """Of four that swim in circles, x, y and the angle of the way, in frame `t`."""
    found = []
    for k in range(4):
        turn = 0.08 * t + 1.3 * k
        x, y = 80 + 160 * (k % 2), 65 + 110 * (k // 2)
        found.append((x + 25 * math.cos(turn), y + 25 * math.sin(turn), turn + math.pi / 2))
    return found


def _film(folder: Path, length: float, width: float) -> Path:
    folder.mkdir()
    for t in range(_FRAMES):
        picture = 150 + np.random.default_rng(t).normal(0, 2, _U.shape)
        for place in _places(t):
            picture -= 80 / (1 + np.exp(_rim(*place, length, width)))
        cv2.imwrite(str(folder / f'{t}.png'), np.clip(np.rint(picture), 0, 255).astype(np.uint8))
    return folder


def _off(out: Path) -> tuple[float, int, int]:
    """The largest distance [px] from the truth, how many rows there are, and how many names."""
    with (out / 'tracks.csv').open() as stream:
        rows = list(csv.DictReader(stream))
    off = max(min(math.dist(place[:2], (float(row['x_px']), float(row['y_px'])))
                  for place in _places(int(row['frame']))) for row in rows)
    return off, len(rows), len({row['particle'] for row in rows})


def test_what_is_fitted_anyway_needs_no_kind(tmp_path: Path) -> None:
    film = _film(tmp_path / 'film', 14, 14)
    assert microbot('track', film, '--out', tmp_path / 'out', '--no-overlay') == 0
    assert not (tmp_path / 'out' / 'learned.yaml').exists()
    off, rows, names = _off(tmp_path / 'out')
    assert off < 0.2
    assert (rows, names) == (4 * _FRAMES, 4)


def test_what_has_an_outline_only_is_followed_as_a_kind(tmp_path: Path) -> None:
    film = _film(tmp_path / 'film', 34, 10)
    assert microbot('track', film, '--out', tmp_path / 'out', '--no-overlay') == 0
    assert 'name: particle' in (tmp_path / 'out' / 'learned.yaml').read_text()
    off, rows, names = _off(tmp_path / 'out')
    assert off < 1.0
    assert (rows, names) == (4 * _FRAMES, 4)


def _specks(t: int) -> np.ndarray:
    """A grey frame (200, 200) with what a codec leaves of noise: specks of both signs."""
    noise = np.random.default_rng(t).normal(0, 1, (200, 200))
    rough: np.ndarray = cv2.GaussianBlur(noise, (0, 0), 1.6)
    rough /= rough.std()
    return 150 + 2.5 * rough + 0.3 * rough**5


def _noisy_film(folder: Path, dimer: float) -> Path:
    """A film of specks, around a dimer that rests where `dimer` [grey] is its contrast."""
    folder.mkdir()
    v, u = np.mgrid[:200, :200]
    body = sum(1 / (1 + np.exp(np.hypot(u - x, v - y) - 29)) for x, y in ((111, 70), (96, 125)))
    for t in range(26):
        picture = _specks(t) - dimer * np.minimum(body, 1)
        cv2.imwrite(str(folder / f'{t}.png'), np.clip(np.rint(picture), 0, 255).astype(np.uint8))
    return folder


def test_a_large_body_that_rests_beats_the_specks_around_it(tmp_path: Path) -> None:
    film = _noisy_film(tmp_path / 'film', 95)
    assert microbot('track', film, '--out', tmp_path / 'out', '--no-overlay',
                    '--json', tmp_path / 'said.json') == 0
    with (tmp_path / 'out' / 'tracks.csv').open() as stream:
        rows = list(csv.DictReader(stream))
    assert [int(row['frame']) for row in rows] == list(range(26))
    assert len({row['particle'] for row in rows}) == 1
    off = [math.dist((103.5, 97.5), (float(row['x_px']), float(row['y_px']))) for row in rows]
    assert max(off) < 1.0
    assert json.loads((tmp_path / 'said.json').read_text())['warnings'] == []


def test_specks_alone_are_named_and_an_example_is_requested(tmp_path: Path) -> None:
    film = _noisy_film(tmp_path / 'film', 0)
    assert microbot('track', film, '--out', tmp_path / 'out', '--no-overlay',
                    '--json', tmp_path / 'said.json') == 0
    [*_, said] = [one for one in json.loads((tmp_path / 'said.json').read_text())['warnings']
                  if 'specks' in one]
    assert '--like FRAME,X,Y' in said
