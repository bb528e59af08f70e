"""Tracking a film of any length: frames in, rows of `tracks.csv` out, neither kept."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from microbot_ros.archive.film_and_table import compare, times_of_frames
from microbot_ros.cameras.source import ImageSource, Source, VideoSource, natural_order
from microbot_ros.common.records import Session
from microbot_ros.tracking import FrameError, Tracker, TrackerSettings
from microbot_ros.tracking.locate.kinds_detector import stand_in
from microbot_ros.tracking.rows import Remarks, Rows
from microbot_ros.tracking.teach.learn import learn_first
from microbot_ros.tracking.teach.unprompted import evenly, without_prompt


def track_film(files: Sequence[Path], tracks: Path, pixel_size: float | None,
               frame_rate: float | None, settings: TrackerSettings,
               table: Session | None = None) -> dict[str, Any]:
    """Track a film, one file or its pictures in `files`, into the file `tracks`.

    Rows are those of `microbot track`; those in metres are there where `pixel_size` [m] is known.
    `frame_rate` [Hz] overrules the film's own, `settings` are the tracker's. `table` is the
    session of the table of the same name: its times are those of the frames where it has as many,
    and its positions are compared with the tracks. Returns what is to be told: frames, particles,
    positions, remarks, and `beside_table`, a list of `Agreement`, with a table. InputError where
    no frame can be decoded.
    """
    remarks: list[str] = []
    film: Source = VideoSource(files[0], remarks.append, frame_rate) if len(files) == 1 else (
        ImageSource(files[0].parent.name, sorted(files, key=natural_order), remarks.append,
                    frame_rate))
    if film.frame_rate is None and pixel_size is not None:
        remarks.append('no frame rate is known; t_s counts frames')
    count = 0

    def images() -> Iterator[np.ndarray]:
        nonlocal count
        for count, frame in enumerate(film.frames(), 1):  # noqa: B007
            yield frame.image

    settings, doubts = without_prompt(settings, evenly(images(), film.length), film.length or 0)
    remarks += doubts
    appearance = stand_in(settings.kinds) if settings.kinds else learn_first(
        (frame.image for frame in film.frames()), settings)
    times = None if table is None else times_of_frames(table, count)
    with tracks.open('w', encoding='utf-8') as file:
        rows = Rows(file, film.size, pixel_size, [kind.name for kind in settings.kinds])
        if appearance is None:
            remarks.append('nothing in it stands out of the noise; no tracks')
        else:
            remarks += _track(film, Tracker(settings, appearance), rows, times)
        rows.close()
    told = {'frames': rows.frames, 'particles': len(rows.seen),
            'positions': rows.seen.total(), 'remarks': list(dict.fromkeys(remarks))}
    if table is not None and pixel_size is not None:
        told['beside_table'] = compare(tracks, table, count, pixel_size)
    return told


def _track(film: Source, tracker: Tracker, rows: Rows, times: np.ndarray | None) -> list[str]:
    """Fill the `rows`; returns a sentence on each kind of frame that was odd.

    `times` [s] of the frames in order are used instead of the film's own where they are known.
    """
    odd = Remarks()
    for place, frame in enumerate(film.frames()):
        t = frame.t if times is None else float(times[place])
        try:
            poses = tracker.update(frame.image, t)
        except FrameError as error:
            said = {'refused': f'{error.expected}; left out'}
        else:
            rows.add(frame.index, poses, *tracker.before_named)
            said = tracker.remarks
        odd.add(frame.index, said)
    return odd.sentences()
