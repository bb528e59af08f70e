"""Videos, folders and globs as frames; what can't be decoded is said, never made up."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from microbot_ros.cameras.source import grey, open_source
from microbot_ros.common.errors import InputError


def _picture(level: int, size: tuple[int, int] = (48, 64)) -> np.ndarray:
    return np.full(size, level, np.uint8)


def _video(path: Path, frames: int, rate: float = 25.0) -> Path:
    writer = cv2.VideoWriter(
        str(path), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*'MJPG'), rate, (64, 48))
    noise = np.random.default_rng(0).integers(0, 255, (48, 64, 3)).astype(np.uint8)
    for _ in range(frames):
        writer.write(noise)
    writer.release()
    return path


def _fail(line: str) -> None:
    raise AssertionError(line)


def test_a_video_gives_all_frames_with_their_times(tmp_path: Path) -> None:
    source = open_source(_video(tmp_path / 'a.avi', 12), _fail)
    frames = list(source.frames())
    assert (source.size, source.length, source.frame_rate) == ((48, 64), 12, 25.0)
    assert [frame.index for frame in frames] == list(range(12))
    np.testing.assert_allclose([frame.t for frame in frames], np.arange(12) / 25, atol=1e-3)
    assert len(list(source.frames())) == 12


def test_a_stated_frame_rate_wins(tmp_path: Path) -> None:
    source = open_source(_video(tmp_path / 'a.avi', 5), _fail, frame_rate=10.0)
    assert [frame.t for frame in source.frames()] == pytest.approx([0, 0.1, 0.2, 0.3, 0.4])


def test_a_video_that_breaks_off_gives_what_is_there_and_says_so(tmp_path: Path) -> None:
    whole = _video(tmp_path / 'whole.avi', 40).read_bytes()
    cut = tmp_path / 'cut.avi'
    cut.write_bytes(whole[:len(whole) // 2])
    said: list[str] = []
    frames = list(open_source(cut, said.append).frames())
    assert 10 < len(frames) < 25
    assert len(said) == 1
    assert said[0].startswith(f'{cut}: ends after {len(frames)} of 40')


@pytest.mark.parametrize('content', [b'', b'not a video', bytes(range(256)) * 40])
def test_what_is_no_video_is_bad_input(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / 'x.mp4'
    path.write_bytes(content)
    with pytest.raises(InputError, match='no frame of it can be decoded'):
        open_source(path, _fail)


def test_images_come_in_natural_order(tmp_path: Path) -> None:
    for number in (10, 9, 1):
        cv2.imwrite(str(tmp_path / f'f{number}.png'), _picture(number))
    (tmp_path / 'notes.txt').write_text('not an image')
    source = open_source(tmp_path, _fail, frame_rate=20.0)
    assert [(frame.t, frame.image[0, 0]) for frame in source.frames()] == [
        (0.0, 1), (0.05, 9), (0.1, 10)]
    assert open_source(str(tmp_path / 'f1*.png'), _fail).length == 2


def test_bad_images_are_left_out_and_named(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / '0.png'), _picture(5))
    (tmp_path / '1.png').write_bytes(b'')
    cv2.imwrite(str(tmp_path / '2.png'), _picture(5, (48, 32)))
    cv2.imwrite(str(tmp_path / '3.png'), _picture(6))
    said: list[str] = []
    frames = list(open_source(tmp_path, said.append).frames())
    assert [frame.index for frame in frames] == [0, 3]
    assert said == [
        f'{tmp_path / "1.png"}: frame 1 cannot be decoded; left out',
        f'{tmp_path / "2.png"}: frame 2 is 32×48, expected 64×48; left out',
    ]


def test_nothing_there_is_bad_input(tmp_path: Path) -> None:
    with pytest.raises(InputError, match='not found'):
        open_source(tmp_path / 'missing.mp4', _fail)
    with pytest.raises(InputError, match='in this folder'):
        open_source(tmp_path, _fail)
    with pytest.raises(InputError, match='matches no file'):
        open_source(str(tmp_path / '*.png'), _fail)
    (tmp_path / 'a.png').write_bytes(b'broken')
    with pytest.raises(InputError, match='none of the 1 can be decoded'):
        open_source(tmp_path, _fail)


@pytest.mark.parametrize('rate', [0.0, -1.0, float('nan'), float('inf')])
def test_a_frame_rate_is_positive(tmp_path: Path, rate: float) -> None:
    with pytest.raises(InputError, match='positive number of hertz'):
        open_source(tmp_path, _fail, rate)


def test_depth_is_kept_and_colour_is_not() -> None:
    deep = np.full((2, 2), 40_000, np.uint16)
    assert grey(deep) is deep
    coloured = grey(np.full((2, 2, 4), 9, np.uint8))
    assert coloured is not None
    assert coloured.shape == (2, 2)
    assert grey(np.zeros((2, 2))) is None
    assert grey(np.zeros((2, 2, 2), np.uint8)) is None
