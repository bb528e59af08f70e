"""A film and the table of its name as one recording."""

from __future__ import annotations

import csv
import json
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import microbot
from laboratories import write_film

from microbot_ros.archive import batch, recordings
from microbot_ros.archive.films import compare
from microbot_ros.archive.recordings import FileCards, Found, find
from microbot_ros.common.records import Commands, Conditions, Session, Tracks
from microbot_ros.session import read_session

SHARED = Path(__file__).parents[2].parent / 'shared' / 'data' / 'speed_vs_frequency'
PIXEL = 0.5e-6
FRAMES = 30
pytestmark = pytest.mark.usefixtures('serial')
_SETTINGS = {'pixel_size_um': None, 'frame_rate_hz': None, 'tracker': {}}


def _way(frame: np.ndarray) -> np.ndarray:
    """Places (n, 2) [px] in the view of the stage, y down."""
    return np.column_stack([700.3 + 0.11 * frame, 526.8 + 0.3 * np.sin(0.2 * frame)])


def _session(frames: int = FRAMES) -> Session:
    k = np.arange(frames)
    tracks = Tracks(0.04 * k, np.ones(frames, int), _way(k) * PIXEL * (1, -1),
                    *np.full((2, frames), np.nan))
    return Session(tracks, Commands(np.empty(0), np.empty((0, 2))),
                   Conditions('rolling', pixel_size=PIXEL, frame_rate=25.0))


def _tracks(path: Path, places: dict[int, np.ndarray]) -> Path:
    with path.open('w') as stream:
        stream.write('frame,particle,x_px,y_px\n')
        for name, of in places.items():
            stream.writelines(f'{k},{name},{x},{y}\n' for k, (x, y) in enumerate(of))
    return path


@pytest.mark.parametrize('rows', [FRAMES, FRAMES + 7])
def test_the_robot_is_the_particle_that_moves_as_it_does(tmp_path: Path, rows: int) -> None:
    k = np.arange(FRAMES)
    off = np.where(k % 2, 0.3, -0.3)[:, None]
    film = _tracks(tmp_path / 'tracks.csv', {
        4: _way(k)[::-1], 7: _way(k) - (600, 400) + off, 9: _way(k)[:5]})
    [found] = compare(film, _session(rows), FRAMES, PIXEL)
    assert (found.robot, found.particle, found.frames) == (1, 7, FRAMES)
    assert found.rms_px == pytest.approx(0.3)
    assert found.offset_px == pytest.approx((600, 400))
    assert found.window_rms_px is None


def test_a_window_that_follows_in_whole_pixels_is_seen(tmp_path: Path) -> None:
    way = _way(np.arange(FRAMES))
    film = _tracks(tmp_path / 'tracks.csv', {0: way - np.floor(way) + 100})
    [found] = compare(film, _session(), FRAMES, PIXEL)
    assert found.rms_px > 0.3
    assert found.window_rms_px == pytest.approx(0, abs=1e-6)
    assert 'window' in found.sentence('book.xlsx')


def test_a_long_film_beside_a_table_with_a_gap_takes_little_memory(tmp_path: Path) -> None:
    frames = 2000
    film = _tracks(tmp_path / 'tracks.csv', {0: _way(np.arange(frames))})
    whole = _session(frames)
    seen = np.delete(np.arange(frames), np.s_[700:705])
    whole.tracks.t[-1] += 0.01  # a quarter of a frame
    tracemalloc.start()
    try:
        [found] = compare(film, replace(whole, tracks=whole.tracks.rows(seen)), frames, PIXEL)
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert found.frames == len(seen)
    assert found.rms_px == pytest.approx(0, abs=1e-3)
    assert most < frames * frames  # bytes: a matrix of frames and rows has eight times as many


def test_without_tracks_nothing_agrees(tmp_path: Path) -> None:
    assert compare(_tracks(tmp_path / 'tracks.csv', {}), _session(), FRAMES, PIXEL) == []


def _table(path: Path) -> None:
    """A table in pixels, y down, with times that are not the film's."""
    with path.open('w') as stream:
        table = csv.writer(stream)
        table.writerow(['t (s)', 'x (px)', 'y (px)', 'bx (mT)', 'by (mT)'])
        table.writerows([round(0.05 * k, 2), x, y, 5, 0]
                        for k, (x, y) in enumerate(_way(np.arange(FRAMES))))


def test_batch_tracks_the_film_and_compares_it_with_its_table(
        tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    place = tmp_path / 'lab'
    place.mkdir()
    k = np.arange(FRAMES)
    own = np.column_stack([120 - k, np.full(FRAMES, 80)])  # the way of another one
    write_film(place / 'monday.avi', np.stack([_way(k) - (660, 480), own], axis=1))
    _table(place / 'monday.csv')
    (place / 'archive.yaml').write_text('pixel_size_um: 0.5\n')
    assert microbot('batch', 'track', place, '--out', tmp_path / 'out',
                    '--json', tmp_path / 'said.json') == 0
    assert 'robot 0 of monday.csv is particle' in capsys.readouterr().out
    said = json.loads((tmp_path / 'said.json').read_text())
    assert (said['found'], said['done'], said['aside']) == (1, 1, 0)
    [film] = said['films'].values()
    [robot] = film['table']['robots']
    assert robot['rms_px'] < 0.2
    assert robot['offset_px'] == pytest.approx((660, 480), abs=0.2)
    [made] = (tmp_path / 'out' / 'sessions').iterdir()
    session = read_session(made)
    assert film['table']['sentences'][0] in session.assumed
    # The frames are at the times of the table, under its commands.
    np.testing.assert_allclose(np.unique(session.tracks.t), 0.05 * np.arange(FRAMES), atol=1e-6)
    assert session.commands.field[0] == pytest.approx((5e-3, 0))
    assert 'beside its table' in (tmp_path / 'out' / 'archive.html').read_text()
    assert 'RMS difference' in (tmp_path / 'out' / 'archive.html').read_text()


def test_only_a_single_table_of_the_name_is_a_films(tmp_path: Path) -> None:
    def found(name: str, kind: str) -> Found:
        return Found(tmp_path / name, kind, tmp_path, (tmp_path / name,))  # type: ignore[arg-type]

    film, other = found('a.mp4', 'film'), found('b.mp4', 'film')
    table, second = found('a.csv', 'table'), found('a.xlsx', 'table')
    assert recordings.pairs([film, other, table]) == {film.path: table}
    assert recordings.pairs([film, table, second]) == {}
    assert recordings.pairs([film, found('a.avi', 'film'), table]) == {}


@pytest.mark.skipif(not SHARED.is_dir(), reason='the shared recordings are not here')
def test_a_dimer_of_a_laboratory_is_where_its_workbook_says(tmp_path: Path) -> None:
    place = tmp_path / 'lab'
    place.mkdir()
    [film] = [one for one in find([SHARED], FileCards({}))
              if isinstance(one, Found) and one.kind == 'film']
    for ending in ('.mp4', '.xlsx'):
        (place / f'dimer{ending}').symlink_to(film.path.with_name(film.path.stem + ending))
    _, found = batch.run_batch('track', [place], tmp_path / 'out', _SETTINGS)
    [told] = found['films'].values()
    assert (told['frames'], told['particles'], told['positions']) == (90, 1, 90)
    [robot] = told['table']['robots']
    assert robot['rms_px'] < 0.7
    assert robot['window_rms_px'] < 0.25
