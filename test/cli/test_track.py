"""`microbot track`: its files, its numbers, and what it says of bad input."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import microbot

from bench._tracker_scenes import KINDS, draw, expose, light, scene
from microbot_ros.virtual_rig.microscope import Microscope, MicroscopeSettings


def _run(*arguments: object) -> int:
    return microbot('track', *arguments)


@pytest.fixture(scope='module')
def images(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp('images')
    for k, frame in enumerate(scene('disc', -60, 15, seed=9, frames=8).frames):
        cv2.imwrite(str(folder / f'{k}.png'), frame[:240, :320])
    return folder


def test_tracks_in_pixels_and_micrometres(images: Path, tmp_path: Path) -> None:
    result = tmp_path / 'result.json'
    assert _run(images, '--out', tmp_path / 'out', '--pixel-size-um', 0.5,
                '--frame-rate-hz', 20, '--json', result) == 0
    with (tmp_path / 'out' / 'tracks.csv').open() as stream:
        rows = list(csv.DictReader(stream))
    assert list(rows[0]) == ['frame', 'particle', 'x_px', 'y_px', 't_s', 'x_um', 'y_um',
                             'theta_rad', 'sigma_um']
    for row in rows:
        assert float(row['t_s']) == pytest.approx(int(row['frame']) / 20, abs=1e-6)
        assert float(row['x_um']) == pytest.approx(0.5 * (float(row['x_px']) - 159.5), abs=1e-3)
        assert float(row['y_um']) == pytest.approx(0.5 * (119.5 - float(row['y_px'])), abs=1e-3)
    truth = scene('disc', -60, 15, seed=9, frames=1).truth
    places = np.array([[float(row['x_px']), float(row['y_px'])] for row in rows])
    assert np.linalg.norm(places[:, None] - truth, axis=2).min(axis=1).max() < 1
    summary = json.loads(result.read_text())
    assert summary['frames'] == 8
    assert summary['positions'] == len(rows)
    assert sorted(p.name for p in (tmp_path / 'out').iterdir()) == [
        'overlay.mp4', 'settings.png', 'tracks.csv']
    film = cv2.VideoCapture(str(tmp_path / 'out' / 'overlay.mp4'))
    assert sum(1 for _ in iter(lambda: film.read()[0], False)) == 8


def test_headings_and_sigma_are_the_particles_in_the_workspace(tmp_path: Path) -> None:
    scope = Microscope(MicroscopeSettings(width_px=320, height_px=240, pixel_size_um=0.45), seed=5)
    place = 1e-6 * np.array([[-40.0, 20.0], [35.0, 25.0], [0.0, -30.0]])
    heading = np.array([0.4, 2.2, -1.5])
    rng = np.random.default_rng(5)
    there = [place + 1e-7 * rng.standard_normal(place.shape) for _ in range(40)]
    for k, now in enumerate(there):
        cv2.imwrite(str(tmp_path / f'{k:02}.png'), scope.render(now, heading, k / 20))
    assert _run(tmp_path / '*.png', '--out', tmp_path / 'out', '--pixel-size-um', 0.45,
                '--frame-rate-hz', 20, '--no-overlay') == 0
    with (tmp_path / 'out' / 'tracks.csv').open() as stream:
        rows = list(csv.DictReader(stream))
    known = [row for row in rows if row['sigma_um']]
    assert len(known) > 0.9 * 40 * len(place)
    errors, turned = [], []
    for row in known:
        off = there[int(row['frame'])] * 1e6 - [float(row['x_um']), float(row['y_um'])]
        nearest = np.hypot(*off.T).argmin()
        errors.append(off[nearest] / float(row['sigma_um']))
        turned.append(np.exp(1j * (float(row['theta_rad']) - heading[nearest])))
    assert abs(np.angle(np.mean(turned))) < 0.05
    assert np.abs(np.angle(turned)).max() < 0.5
    assert 0.5 < np.sqrt(np.mean(np.square(errors))) < 2


def test_frames_before_an_identity_are_not_lost(images: Path, tmp_path: Path) -> None:
    """A particle has its identity from the third frame on; its rows start with the first."""
    assert _run(images, '--out', tmp_path, '--no-overlay', '--json', tmp_path / 'r.json') == 0
    with (tmp_path / 'tracks.csv').open() as stream:
        rows = [(int(r['frame']), int(r['particle'])) for r in csv.DictReader(stream)]
    assert rows == sorted(rows)
    assert len(set(rows)) == len(rows)
    particles = {particle for _, particle in rows}
    assert {(frame, particle) for frame in range(8) for particle in particles} == set(rows)
    assert json.loads((tmp_path / 'r.json').read_text())['whole_clip'] == len(particles)


@pytest.mark.parametrize('depth', [np.uint8, np.uint16])
def test_pictures_of_another_depth_are_left_out_and_said(
    images: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], depth: type
) -> None:
    """Eight frames of one depth, the sixth of the other; sixteen bits are as good as eight."""
    folder = tmp_path / 'mixed'
    folder.mkdir()
    for k in range(8):
        image = cv2.imread(str(images / f'{k}.png'), cv2.IMREAD_UNCHANGED)
        deep = (depth == np.uint16) != (k == 5)
        cv2.imwrite(str(folder / f'{k}.png'), image.astype(np.uint16) * 257 if deep else image)
    assert _run(folder, '--out', tmp_path / 'out', '--no-overlay') == 0
    said = capsys.readouterr().err
    assert 'frame 5: expected 320×240' in said
    frames = {line.split(',')[0] for line in (
        tmp_path / 'out' / 'tracks.csv').read_text().splitlines()[1:]}
    assert frames == {str(k) for k in range(8) if k != 5}


def test_what_is_wrong_with_the_pictures_is_told_once(
    images: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for k in range(16):
        image = cv2.imread(str(images / f'{k % 8}.png'), cv2.IMREAD_UNCHANGED)
        dim = 0.7 if k in (9, 12) else 1.0
        cv2.imwrite(str(tmp_path / f'{k:02d}.png'), (image * dim).astype(np.uint8))
    assert _run(f'{tmp_path}/*.png', '--out', tmp_path / 'out', '--no-overlay') == 0
    said = capsys.readouterr().err
    assert 'frame 9: the light jumped by -' in said
    assert '2 frames like it' in said


def test_without_a_pixel_size_there_are_pixels_only(images: Path, tmp_path: Path) -> None:
    assert _run(f'{images}/*.png', '--out', tmp_path / 'out', '--no-overlay') == 0
    lines = (tmp_path / 'out' / 'tracks.csv').read_text().splitlines()
    assert lines[0] == 'frame,particle,x_px,y_px'
    assert len(lines) > 100
    assert not (tmp_path / 'out' / 'overlay.mp4').exists()


@pytest.mark.parametrize(('arguments', 'expected'), [
    (['missing.mp4'], 'not found'),
    (['{images}', '--pixel-size-um', 'nan'], 'nan is no number'),
    (['{images}', '--pixel-size-um', '0'], 'not in the range'),
    (['{images}', '--pixel-size-um', 'inf'], 'not in the range'),
    (['{images}', '--frame-rate-hz', '-3'], 'not in the range'),
    (['{images}', '--settings', '{tmp}/typo.yaml'], "typo.yaml:1: unknown key 'diametre_px'"),
    (['{images}', '--settings', '{tmp}/nan.yaml'], 'nan.yaml:1:'),
    (['{tmp}/empty.mp4'], 'no frame of it can be decoded'),
    (['{images}', '--commands', '{tmp}/nan.csv'], 'nan.csv:2'),
    (['{images}', '--commands', '{tmp}/back.csv'], 'back.csv:3: expected ascending times'),
])
def test_bad_input_is_one_line_and_leaves_nothing(
    images: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str],
    expected: str,
) -> None:
    (tmp_path / 'typo.yaml').write_text('diametre_px: 9\n')
    (tmp_path / 'nan.yaml').write_text('diameter_px: .nan\n')
    (tmp_path / 'empty.mp4').write_bytes(b'')
    (tmp_path / 'nan.csv').write_text('t_s,bx_mT,by_mT\n0,1,nan\n')
    (tmp_path / 'back.csv').write_text('t_s,bx_mT,by_mT\n1,1,0\n0,1,0\n')
    before = sorted(tmp_path.iterdir())
    filled = [part.format(images=images, tmp=tmp_path) for part in arguments]
    assert _run(*filled, '--out', tmp_path / 'out') == 2
    said = capsys.readouterr().err
    assert expected in said
    assert said.count('\n') == 1
    assert sorted(tmp_path.iterdir()) == before


def test_a_broken_image_is_named_and_the_rest_tracked(
    images: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / 'images'
    folder.mkdir()
    for path in images.iterdir():
        (folder / path.name).write_bytes(path.read_bytes() if path.name != '3.png' else b'')
    assert _run(folder, '--out', tmp_path / 'out', '--no-overlay') == 0
    assert 'frame 3 cannot be decoded' in capsys.readouterr().err
    frames = {line.split(',')[0] for line in (
        tmp_path / 'out' / 'tracks.csv').read_text().splitlines()[1:]}
    assert '3' not in frames
    assert '7' in frames


def test_too_few_frames_are_said(
    images: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _run(f'{images}/[01].png', '--out', tmp_path, '--no-overlay') == 0
    assert 'needs 3 frames, the film has 2' in capsys.readouterr().err


def test_nothing_to_track_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rng = np.random.default_rng(0)
    for k in range(3):
        cv2.imwrite(str(tmp_path / f'{k}.png'), rng.normal(120, 5, (96, 128)).astype(np.uint8))
    assert _run(tmp_path, '--out', tmp_path / 'out') == 0
    assert 'nothing stands out' in capsys.readouterr().err
    assert (tmp_path / 'out' / 'tracks.csv').read_text() == 'frame,particle,x_px,y_px\n'


def test_commands_tell_of_turns(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    place = np.array([60 + 70j, 150 + 60j, 240 + 80j, 80 + 180j, 170 + 200j, 250 + 170j])
    response = 35 * np.exp(1j * rng.uniform(-np.pi, np.pi, 6))
    commands, angle = ['t_s,bx_mT,by_mT'], 0.0
    (tmp_path / 'film').mkdir()
    for frame in range(70):
        if frame % 5 == 0:
            angle += np.pi + rng.uniform(-0.3, 0.3)
            commands.append(f'{frame / 5},{np.cos(angle)},{np.sin(angle)}')
        picture = light(260, 320)
        for at in place:
            draw(picture, np.array([at.real, 260 - at.imag]), KINDS['disc'], -60)
        cv2.imwrite(str(tmp_path / 'film' / f'{frame:02d}.png'), expose(picture, 3.0, rng))
        place = place + response * np.exp(1j * angle) / 5
    (tmp_path / 'commands.csv').write_text('\n'.join(commands))
    tracks = {}
    for name, extra in (('told', ['--commands', tmp_path / 'commands.csv']), ('untold', [])):
        assert _run(tmp_path / 'film', '--out', tmp_path / name, '--frame-rate-hz', 5,
                    '--no-overlay', '--json', tmp_path / f'{name}.json', *extra) == 0
        tracks[name] = json.loads((tmp_path / f'{name}.json').read_text())['tracks']
    assert tracks['told'] <= 8 < 12 < tracks['untold']


def test_what_an_earlier_run_learned_goes_with_its_tracks(images: Path, tmp_path: Path) -> None:
    for name in ('tracks.csv', 'learned.yaml', 'notes.txt'):
        (tmp_path / name).write_text('earlier')
    assert _run(f'{images}/[01].png', '--out', tmp_path, '--no-overlay') == 2
    assert (tmp_path / 'tracks.csv').read_text() == 'earlier'
    assert _run(f'{images}/[01].png', '--out', tmp_path, '--no-overlay', '--force') == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        'notes.txt', 'settings.png', 'tracks.csv']
