"""Tracks of films, frame by frame, and their comparison with the table of the same name."""

from __future__ import annotations

import csv
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from microbot_ros.cameras.source import ImageSource, Source, VideoSource, natural_order
from microbot_ros.common.records import Session
from microbot_ros.tracking import FrameError, Tracker, TrackerSettings
from microbot_ros.tracking.locate.kinds_detector import stand_in
from microbot_ros.tracking.rows import Remarks, Rows
from microbot_ros.tracking.teach.learn import learn_first
from microbot_ros.tracking.teach.unprompted import evenly, without_prompt

_LEAST_SHARE = 0.5
"""Least number of frames of a compared track, as a part of the longest. Choice: a shorter track
may agree by chance."""

_CLEARER = 0.75
"""RMS with steps of the window over that without, up to which the window is said to follow.
Choice: a window that follows a resting dimer reaches 0.3, steps of chance 1."""


@dataclass(frozen=True)
class Agreement:
    """Agreement of a particle of a film with a robot of its table.

    Attributes
    ----------
    robot : int
        Number of the robot.
    particle : int
        Number of the particle.
    frames : int
        Number of compared frames.
    rms_px : float
        Root mean square of the difference per coordinate [px], after the offset.
    offset_px : tuple[float, float]
        Constant offset, table minus film [px]; x, y down.
    window_rms_px : float or None
        The same RMS if the film shows a window that follows the robot in whole pixels; None if
        that explains nothing.
    """

    robot: int
    particle: int
    frames: int
    rms_px: float
    offset_px: tuple[float, float]
    window_rms_px: float | None

    def sentence(self, table: str) -> str:
        """Return the agreement as text.

        Parameters
        ----------
        table : str
            Name of the table.

        Returns
        -------
        str
            The sentence.
        """
        x, y = self.offset_px
        said = (f'robot {self.robot} of {table} is particle {self.particle}: RMS difference '
                f'{self.rms_px:.2f} px per coordinate in {self.frames} frames after a constant '
                f'offset of {x:.1f}, {y:.1f} px')
        if self.window_rms_px is not None:
            said += (f'; {self.window_rms_px:.2f} px where the film is a window that follows the '
                     'robot in whole pixels')
        return said

    def as_json(self) -> dict[str, Any]:
        """Return the numbers by the names of the fields.

        Returns
        -------
        dict of str to object
            The numbers.
        """
        return asdict(self)


def track_film(files: Sequence[Path], tracks: Path, pixel_size: float | None,
               frame_rate: float | None, settings: TrackerSettings,
               table: Session | None = None) -> dict[str, Any]:
    """Track a film into a file, whose rows are those of `microbot track`.

    Parameters
    ----------
    files : sequence of Path
        File of the film, or its pictures.
    tracks : Path
        File to write.
    pixel_size : float or None
        Size of a pixel [m]; None for unknown, without columns in metres.
    frame_rate : float or None
        Frame rate [Hz] in place of the film's own; None for that.
    settings : TrackerSettings
        Settings of the tracker.
    table : Session or None
        Session of the table of the same name. Its times are those of the frames if it has as many,
        and its positions are compared with the tracks. None for no table.

    Returns
    -------
    dict of str to object
        Frames, particles, positions, remarks, and with a table `beside_table`, a list of
        `Agreement`.

    Raises
    ------
    InputError
        If no frame can be decoded.
    """
    remarks: list[str] = []
    film: Source = VideoSource(files[0], remarks.append, frame_rate) if len(files) == 1 else (
        ImageSource(files[0].parent.name, sorted(files, key=natural_order), remarks.append,
                    frame_rate))
    if film.frame_rate is None and pixel_size is not None:
        remarks.append('no frame rate known; t_s counts frames')
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
            remarks.append('nothing stands out of the noise; no tracks')
        else:
            remarks += _track(film, Tracker(settings, appearance), rows, times)
        rows.close()
    told = {'frames': rows.frames, 'particles': len(rows.seen),
            'positions': rows.seen.total(), 'remarks': list(dict.fromkeys(remarks))}
    if table is not None and pixel_size is not None:
        told['beside_table'] = compare(tracks, table, count, pixel_size)
    return told


def _track(film: Source, tracker: Tracker, rows: Rows, times: np.ndarray | None) -> list[str]:
    """Track the frames into rows; return a sentence on each kind of unusual frame.

    `times` [s] replace the film's own times; None for those.
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


def times_of_frames(session: Session, frames: int) -> np.ndarray | None:
    """Return the times of a film's frames according to its table.

    Parameters
    ----------
    session : Session
        Session of the table.
    frames : int
        Number of frames.

    Returns
    -------
    ndarray, shape (frames,), or None
        Times [s]; None if the table has another number of rows, as their frames are then unknown.
    """
    t = np.unique(session.tracks.t)
    return t if len(t) == frames else None


def compare(tracks: Path, session: Session, frames: int, pixel_size: float) -> list[Agreement]:
    """Compare the tracks of a film with the positions of its table.

    Each robot of the table is compared with the particle of the nearest motion: row by row if the
    table has as many times as the film has frames, else by the time since the first.

    Parameters
    ----------
    tracks : Path
        File of the tracks, a `tracks.csv`.
    session : Session
        Session of the table.
    frames : int
        Number of frames of the film.
    pixel_size : float
        Size of a pixel of the film [m].

    Returns
    -------
    list of Agreement
        Best agreement of each robot.
    """
    seen = _particles(tracks)
    longest = max((len(frame) for frame, _ in seen.values()), default=0)
    rate = session.conditions.frame_rate
    times = times_of_frames(session, frames)
    if times is None and rate is not None:
        times = session.tracks.t.min() + np.arange(frames) / rate
    if times is None:
        return []
    free = {name for name, (frame, _) in seen.items() if len(frame) >= _LEAST_SHARE * longest}
    found = []
    for robot in session.tracks.particles.tolist():
        own = session.tracks.of(robot)
        place = np.column_stack([np.interp(times, own.t, sign * axis / pixel_size)
                                 for sign, axis in zip((1, -1), own.position.T, strict=True)])
        later = np.clip(np.searchsorted(own.t, times), 1, max(len(own.t) - 1, 1)) - 1
        near = np.minimum(*(np.abs(times - own.t[np.minimum(later + one, len(own.t) - 1)])
                            for one in (0, 1)))
        place[near > np.median(np.diff(times)) / 2] = np.nan
        agreed = [one for name in sorted(free)
                  if (one := _agreement(robot, name, *seen[name], place)) is not None]
        if agreed:
            found.append(min(agreed, key=lambda one: one.rms_px))
            free.discard(found[-1].particle)
    return found


def _particles(tracks: Path) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """Return frames (n,) and places (n, 2) [px] of each particle in a `tracks.csv`."""
    rows: dict[int, list[tuple[float, float, float]]] = defaultdict(list)
    with tracks.open(encoding='utf-8') as stream:
        for row in csv.DictReader(stream):
            rows[int(row['particle'])].append(
                (float(row['frame']), float(row['x_px']), float(row['y_px'])))
    return {name: (np.array(of)[:, 0].astype(int), np.array(of)[:, 1:])
            for name, of in rows.items()}


def _agreement(robot: int, particle: int, frame: np.ndarray, seen: np.ndarray,
               place: np.ndarray) -> Agreement | None:
    """Return how places `seen` (n, 2) [px] in frames (n,) agree with the table's `place`.

    `place` (frames, 2) [px] is NaN where the table has none; None if they share fewer than two
    frames.
    """
    both = np.isfinite(place[frame]).all(axis=1)
    if both.sum() < 2:
        return None
    told, off = place[frame][both], place[frame][both] - seen[both]
    plain = _rms(off)
    window = min(_rms(off - whole(told)) for whole in (np.floor, np.rint))
    x, y = off.mean(axis=0).tolist()
    return Agreement(robot, particle, int(both.sum()), plain, (x, y),
                     window if window < _CLEARER * plain else None)


def _rms(off: np.ndarray) -> float:
    """Return the root mean square of differences (n, 2) about their mean, per coordinate."""
    return float(np.sqrt(np.mean((off - off.mean(axis=0)) ** 2)))
