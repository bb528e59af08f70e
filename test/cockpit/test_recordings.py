"""The recordings that a page lists, downloads and replays."""

from __future__ import annotations

import http.client
import json
import threading
import time
from pathlib import Path
from typing import Any
from unittest import mock

import pytest

pytest.importorskip('uvicorn', reason='the extra `cockpit` is not installed')
pytest.importorskip('av', reason='the extra `video` is not installed')
pytest.importorskip('mcap', reason='the extra `mcap` is not installed')

from click.testing import CliRunner
from cockpit.conftest import get
from session.recordings import IMAGE, encode, header, image, record, small_session

from microbot_ros import cli
from microbot_ros.cockpit.connections import BriefConnection
from microbot_ros.cockpit.recordings import Recordings
from microbot_ros.common.errors import InputError
from microbot_ros.session.mcap.recorder import RecordingWriter
from microbot_ros.tracking.overlay import OverlayVideo

FRAMES = 40


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A recording with title and notes, one without frames, one that runs, and no recording."""
    with RecordingWriter(tmp_path / 'batch') as writer:
        writer.describe('recording', {'title': 'batch 7', 'notes': '10:00:00 a bubble'})
        writer.attach('parameters/tracker.yaml', json.dumps({'tracker': {'ros__parameters': {
            'pixel_size_um': 0.5, 'rotation_deg': 0.0, 'mirrored': False}}}))
        for k in range(FRAMES):
            stamp = 10**15 + k * 40_000_000
            writer.write('/camera/image_raw', IMAGE, stamp, image(stamp))
            writer.write('/particles', 'sensor_msgs/msg/PointCloud2', stamp + 10**6,
                         _cloud(stamp))
    record(tmp_path / 'tracks only', small_session())
    running = tmp_path / 'running'
    running.mkdir()
    (running / 'running_0.mcap').write_bytes(b'\x89MCAP0\r\n')
    (tmp_path / 'notes').mkdir()
    (tmp_path / 'notes' / 'plan.txt').write_text('no')
    return tmp_path


def _cloud(stamp: int) -> bytes:
    import numpy as np

    from microbot_ros.loop.points import PARTICLE
    from microbot_ros.session.mcap.bag import typestore

    types = typestore().types
    points = np.array([(3, 4e-6, -2e-6, 0.0, 0.0, 0.0, 1e-8)], PARTICLE)
    fields = [types['sensor_msgs/msg/PointField'](name, 4 * k, 6 if name == 'id' else 7, 1)
              for k, name in enumerate(PARTICLE.names)]
    return encode('sensor_msgs/msg/PointCloud2', header(stamp), 1, 1, fields, False,
                  points.itemsize, points.itemsize, points.view(np.uint8).reshape(-1), True)


def _film(path: Path) -> list[Any]:
    """The pictures of a film, RGB."""
    import av

    with av.open(str(path)) as opened:
        return [frame.to_ndarray(format='rgb24') for frame in opened.decode(video=0)]


def test_finished_recordings_are_described_and_others_are_named(folder: Path) -> None:
    found = {one['name']: one for one in Recordings(folder).listed()}
    assert set(found) == {'batch', 'tracks only', 'running'}
    batch = found['batch']
    assert (batch['title'], batch['notes']) == ('batch 7', '10:00:00 a bubble')
    assert batch['seconds'] == pytest.approx((FRAMES - 1) * 0.04 + 0.001)
    assert batch['bytes'] == (folder / 'batch' / 'batch_0.mcap').stat().st_size
    assert batch['files'] == ['batch_0.mcap']
    assert found['running']['seconds'] is None


def test_the_newest_comes_first_and_what_ended_meanwhile_is_read_anew(folder: Path) -> None:
    recordings = Recordings(folder)
    recordings.listed()
    with RecordingWriter(folder / 'later') as writer:
        writer.write('/x', 'std_msgs/msg/Bool', 1, b'\x00\x01\x00\x00\x01')
        time.sleep(0.01)
    newest = recordings.listed()[0]
    assert (newest['name'], newest['seconds']) == ('later', 0.0)


def test_no_other_file_is_served(folder: Path) -> None:
    recordings = Recordings(folder / 'batch' / '..')
    (folder.parent / 'outside.mcap').write_bytes(b'no')
    (folder / 'inside.mcap').write_bytes(b'no')
    assert recordings.file('batch', 'batch_0.mcap')
    for name, file in [('..', 'outside.mcap'), ('.', 'inside.mcap'), ('batch', 'metadata.yaml'),
                       ('notes', 'plan.txt'), ('batch', 'other.mcap'), ('nothing', 'x.mcap')]:
        assert recordings.file(name, file) is None, (name, file)


def test_a_film_shows_each_frame_with_its_particle(folder: Path, tmp_path: Path) -> None:
    path = tmp_path / 'film.mp4'
    result = CliRunner().invoke(cli.microbot, [
        'replay', str(folder / 'batch'), '--film', str(path)], catch_exceptions=False)
    assert result.exit_code == 0
    pictures = _film(path)
    assert len(pictures) == FRAMES
    # The frames are grey noise: what is coloured is the ring, around pixel (39.5, 35.5).
    colour = pictures[-1].astype(int).max(2) - pictures[-1].astype(int).min(2) > 60
    rows, columns = colour.nonzero()
    assert 10 < columns.mean() - 30 < 20
    assert 25 < rows.mean() < 45


def test_a_film_that_fails_leaves_the_earlier_one(
        folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / 'new' / 'film.mp4'
    path.parent.mkdir()
    path.write_bytes(b'an earlier film')
    monkeypatch.setattr(OverlayVideo, 'write', mock.Mock(side_effect=KeyboardInterrupt))
    CliRunner().invoke(cli.microbot, ['replay', str(folder / 'batch'), '--film', str(path)])
    assert [one.name for one in path.parent.iterdir()] == ['film.mp4']
    assert path.read_bytes() == b'an earlier film'


def test_without_frames_the_particles_are_drawn_and_without_both_nothing(
        folder: Path, tmp_path: Path) -> None:
    path = tmp_path / 'film.mp4'
    CliRunner().invoke(cli.microbot, ['replay', str(folder / 'tracks only'), '--film', str(path)],
                       catch_exceptions=False)
    assert len(_film(path)) > 100
    with RecordingWriter(tmp_path / 'bare') as writer:
        writer.write('/x', 'std_msgs/msg/Bool', 1, b'\x00\x01\x00\x00\x01')
    with pytest.raises(InputError, match='frames or particles'):
        CliRunner().invoke(cli.microbot, ['replay', str(tmp_path / 'bare'), '--film', '-'],
                           catch_exceptions=False, standalone_mode=False)


def test_pages_get_list_and_files(folder: Path, served: Any) -> None:
    assert {one['name'] for one in json.loads(get(served.port, '/recordings').content)} == {
        'batch', 'tracks only', 'running'}
    answer = get(served.port, '/recordings/batch/batch_0.mcap')
    assert answer.status == 200
    assert answer.content == (folder / 'batch' / 'batch_0.mcap').read_bytes()
    for path in ('/recordings/nothing/film.mp4', '/recordings/%2e%2e/film.mp4',
                 '/recordings/batch/metadata.yaml', '/recordings/%2e%2e/x.mcap'):
        assert get(served.port, path).status == 404, path


@pytest.mark.rig  # a process of the lowest priority draws it: beside others it may take minutes
@pytest.mark.usefixtures('folder')
def test_pages_get_a_film(served: Any, tmp_path: Path) -> None:
    answer = get(served.port, '/recordings/batch/film.mp4')
    (tmp_path / 'got.mp4').write_bytes(answer.content)
    assert (answer.status, len(_film(tmp_path / 'got.mp4'))) == (200, FRAMES)


def test_an_answer_that_takes_long_is_not_cut(folder: Path, served: Any) -> None:
    large = folder / 'running' / 'large.mcap'
    large.write_bytes(bytes(30_000_000))
    connection = http.client.HTTPConnection('127.0.0.1', served.port, timeout=30)
    connection.request('GET', '/recordings/running/large.mcap')
    answer = connection.getresponse()
    [sending] = [one for one in served.server._uvicorn.server_state.connections
                 if isinstance(one, BriefConnection)]
    expired = threading.Event()
    sending.loop.call_soon_threadsafe(lambda: (sending._expire(), expired.set()))
    assert expired.wait(30)
    assert len(answer.read()) == 30_000_000
    connection.close()


@pytest.mark.parametrize('parameters', [
    'tracker: [', '{}', '{tracker: {ros__parameters: {pixel_size_um: wide}}}',
    '{tracker: {ros__parameters: {pixel_size_um: .nan, rotation_deg: 0, mirrored: false}}}'])
def test_a_film_without_a_calibration_is_refused_and_not_begun(
        tmp_path: Path, parameters: str) -> None:
    with RecordingWriter(tmp_path / 'run') as writer:
        writer.attach('parameters/tracker.yaml', parameters)
        for stamp in (10**15, 10**15 + 40_000_000):
            writer.write('/camera/image_raw', IMAGE, stamp, image(stamp))
    out = tmp_path / 'film.mp4'
    with pytest.raises(InputError, match='the parameters of'):
        CliRunner().invoke(cli.microbot, ['replay', str(tmp_path / 'run'), '--film', str(out)],
                           catch_exceptions=False, standalone_mode=False)
    assert not out.exists()
