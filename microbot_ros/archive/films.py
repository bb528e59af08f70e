"""Tracking a film of any length: frames in, rows of `tracks.csv` out, neither kept."""

from __future__ import annotations

import itertools
from collections import Counter, deque
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from microbot_ros.cameras.source import ImageSource, Source, VideoSource, natural_order
from microbot_ros.tracking import (
    Appearance,
    FrameError,
    ImageToWorkspace,
    Poses,
    Tracker,
    TrackerSettings,
    learn,
)
from microbot_ros.units import from_si


def track_film(files: Sequence[Path], tracks: Path, pixel_size: float | None,
               frame_rate: float | None, settings: TrackerSettings) -> dict[str, Any]:
    """Track a film, one file or its pictures in `files`, into the file `tracks`.

    Rows are those of `microbot track`; those in metres are there where `pixel_size` [m] is known.
    `frame_rate` [Hz] overrules the film's own, `settings` are the tracker's. Returns what is to be
    told: frames, particles, positions, remarks. InputError where no frame can be decoded.
    """
    remarks: list[str] = []
    film: Source = VideoSource(files[0], remarks.append, frame_rate) if len(files) == 1 else (
        ImageSource(files[0].parent.name, sorted(files, key=natural_order), remarks.append,
                    frame_rate))
    if film.frame_rate is None and pixel_size is not None:
        remarks.append('no frame rate is known; t_s counts frames')
    appearance = _first_appearance(film, settings)
    with tracks.open('w', encoding='utf-8') as file:
        rows = Rows(file, film.size, pixel_size)
        if appearance is None:
            remarks.append('nothing in it stands out of the noise; no tracks')
        else:
            remarks += _track(film, Tracker(settings, appearance), rows)
        rows.close()
    return {'frames': rows.frames, 'particles': len(rows.seen),
            'positions': rows.seen.total(), 'remarks': list(dict.fromkeys(remarks))}


def _first_appearance(film: Source, settings: TrackerSettings) -> Appearance | None:
    """From the first frames in which anything shows."""
    frames = film.frames()
    while batch := [frame.image for frame in itertools.islice(frames, settings.learning_frames)]:
        if (appearance := learn(batch, settings)) is not None:
            return appearance
    return None


def _track(film: Source, tracker: Tracker, rows: Rows) -> list[str]:
    """Fill the `rows`; returns a sentence on each kind of frame that was odd."""
    odd: dict[str, tuple[int, str]] = {}
    count: Counter[str] = Counter()
    for frame in film.frames():
        try:
            poses = tracker.update(frame.image, frame.t)
        except FrameError as error:
            said = {'refused': f'{error.expected}; left out'}
        else:
            rows.add(frame.index, poses, *tracker.before_named)
            said = tracker.remarks
        for kind, sentence in said.items():
            odd.setdefault(kind, (frame.index, sentence))
            count[kind] += 1
    return [f'frame {index}: {sentence}' + (f'; {count[kind]} frames like it'
                                            if count[kind] > 1 else '')
            for kind, (index, sentence) in odd.items()]


class Rows:
    """Writes rows frame by frame to a `file`, as late as a particle may still be named in them.

    Frames have the `size` (height, width); with a `pixel_size` [m] rows are in metres, too.
    `frames` were tracked; `seen` counts the rows of each particle.
    """

    def __init__(self, file: TextIO, size: tuple[int, int], pixel_size: float | None) -> None:
        self.frames = 0
        self.seen: Counter[int] = Counter()
        self._file = file
        height, width = size
        self._camera = pixel_size and ImageToWorkspace(pixel_size, width, height)
        self._open: deque[tuple[int, float, list[tuple[int, np.ndarray]]]] = deque()
        file.write('frame,particle,x_px,y_px' + (',t_s,x_um,y_um\n' if self._camera else '\n'))

    def add(self, frame: int, poses: Poses, names: np.ndarray, before: np.ndarray) -> None:
        """What was seen in a `frame`: `poses`, and the `names` (n,) of whom it gave names.

        They were at `before` (n, K, 2) [px] in the K frames that came before it.
        """
        self.frames += 1
        self._open.append((frame, poses.t, list(zip(
            poses.id[poses.seen].tolist(), poses.xy[poses.seen], strict=True))))
        early = before.shape[1]
        for k in range(early if len(names) else 0):
            self._open[k - early - 1][2].extend(zip(names.tolist(), before[:, k], strict=True))
        while len(self._open) > early + 1:
            self._write(*self._open.popleft())

    def close(self) -> None:
        """Write what is left; the file stays open."""
        while self._open:
            self._write(*self._open.popleft())

    def _write(self, frame: int, t: float, rows: list[tuple[int, np.ndarray]]) -> None:
        for name, place in sorted(rows, key=lambda row: row[0]):
            line = f'{frame},{name},{place[0]:.4f},{place[1]:.4f}'
            if self._camera:
                x, y = from_si('_um', self._camera.position(place[None]))[0]
                line += f',{t:.6f},{x:.5f},{y:.5f}'
            self._file.write(line + '\n')
            self.seen[name] += 1
