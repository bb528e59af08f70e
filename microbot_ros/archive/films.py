"""Tracking a film of any length: frames in, rows of `tracks.csv` out, neither kept."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from microbot_ros.cameras.source import ImageSource, Source, VideoSource, natural_order
from microbot_ros.tracking import FrameError, Tracker, TrackerSettings
from microbot_ros.tracking.learn import learn_first
from microbot_ros.tracking.rows import Remarks, Rows


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
    appearance = learn_first((frame.image for frame in film.frames()), settings)
    with tracks.open('w', encoding='utf-8') as file:
        rows = Rows(file, film.size, pixel_size)
        if appearance is None:
            remarks.append('nothing in it stands out of the noise; no tracks')
        else:
            remarks += _track(film, Tracker(settings, appearance), rows)
        rows.close()
    return {'frames': rows.frames, 'particles': len(rows.seen),
            'positions': rows.seen.total(), 'remarks': list(dict.fromkeys(remarks))}


def _track(film: Source, tracker: Tracker, rows: Rows) -> list[str]:
    """Fill the `rows`; returns a sentence on each kind of frame that was odd."""
    odd = Remarks()
    for frame in film.frames():
        try:
            poses = tracker.update(frame.image, frame.t)
        except FrameError as error:
            said = {'refused': f'{error.expected}; left out'}
        else:
            rows.add(frame.index, poses, *tracker.before_named)
            said = tracker.remarks
        odd.add(frame.index, said)
    return odd.sentences()
