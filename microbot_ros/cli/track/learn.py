"""Particles that `microbot track` follows: those pointed at, or chosen from the whole film."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from microbot_ros.common.errors import InputError

if TYPE_CHECKING:
    from microbot_ros.cameras.source import Source
    from microbot_ros.tracking import TrackerSettings
    from microbot_ros.tracking.locate.colour import Weights


@dataclass(frozen=True)
class Point:
    """A point given as an example.

    Attributes
    ----------
    frame : int
        Number of the frame.
    x : float
        Column [px].
    y : float
        Row [px].
    kind : str or None
        Name of its kind; None for none.
    """

    frame: int
    x: float
    y: float
    kind: str | None = None


class PointType(click.ParamType):
    """Type of an option FRAME,X,Y or FRAME,X,Y,KIND.

    Parameters
    ----------
    named : bool
        Whether it has a KIND.
    """

    def __init__(self, named: bool) -> None:
        self.name = 'FRAME,X,Y[,KIND]' if named else 'FRAME,X,Y'
        self._most = 4 if named else 3

    def convert(self, value: Any, param: Any, ctx: Any) -> Point:
        """Convert a value, or fail as click does.

        Parameters
        ----------
        value : object
            Value on the command line.
        param : object
            Parameter, as click gives it.
        ctx : object
            Context, as click gives it.

        Returns
        -------
        Point
            The point.
        """
        parts = str(value).split(',')
        try:
            frame, x, y = int(parts[0]), float(parts[1]), float(parts[2])
            good = 3 <= len(parts) <= self._most and frame >= 0 and math.isfinite(x + y)
        except (ValueError, IndexError):
            good = False
        if not good or (len(parts) == 4 and not parts[3]):
            self.fail(f'expected {self.name}, numbers from 0; received {value!r}')
        return Point(frame, x, y, parts[3] if len(parts) == 4 else None)


def pictures(recording: Source, points: Sequence[Point]) -> tuple[dict[int, np.ndarray],
                                                                  list[np.ndarray]]:
    """Return the frames with points, and some frames distributed over the recording.

    Parameters
    ----------
    recording : Source
        The recording.
    points : sequence of Point
        The points.

    Returns
    -------
    tuple[dict of int to ndarray, list of ndarray]
        Frames with points by number, and grey frames (H, W).

    Raises
    ------
    InputError
        If a frame does not exist.
    """
    from microbot_ros.cameras.source import grey
    from microbot_ros.tracking.teach.unprompted import evenly

    wanted = {point.frame for point in points}
    named: dict[int, np.ndarray] = {}
    last = -1

    def seen() -> Iterator[np.ndarray]:
        nonlocal last
        for frame in recording.frames():
            last = frame.index
            if frame.index in wanted:
                named[frame.index] = frame.image
            yield np.asarray(grey(frame.image))

    samples = evenly(seen(), recording.length)
    if missing := sorted(wanted - set(named)):
        raise InputError(f'frame {missing[0]}', f'expected one of the frames 0 to {last} of '
                                                f'{recording.name}')
    return named, samples


def pointed(
    settings: TrackerSettings, like: Sequence[Point], unlike: Sequence[Point],
    named: dict[int, np.ndarray], samples: list[np.ndarray],
) -> tuple[TrackerSettings, list[str]]:
    """Return the settings after all examples, and a sentence about each.

    Parameters
    ----------
    settings : TrackerSettings
        Settings of the tracker.
    like : sequence of Point
        Examples of particles.
    unlike : sequence of Point
        Examples of other objects.
    named : dict of int to ndarray
        Pictures of the frames with points, by number.
    samples : list of ndarray
        Pictures of frames distributed over the film.

    Returns
    -------
    tuple[TrackerSettings, list of str]
        The settings and the sentences.
    """
    from microbot_ros.tracking.teach import teacher
    from microbot_ros.tracking.teach.unprompted import without_creeping, without_standing

    meant = np.array([(point.x, point.y) for point in like]).reshape(-1, 2)
    said = []
    for point in like:
        settings, sentence = teacher.like(
            settings, named[point.frame], point.x, point.y, point.kind)
        said.append(sentence)
    for point in unlike:
        if any(place.holds(point.x, point.y) for place in settings.standing):
            said.append(f'unlike: {point.x:g},{point.y:g} is left out already')
            continue
        if len(samples) >= 3:
            settings, count = without_creeping(settings, samples, meant, point.x, point.y)
            if count:
                said.append(f'unlike: the object at {point.x:g},{point.y:g} resembles its '
                            f'surroundings, as {count - 1} others do; all are left out')
                continue
        try:
            settings, sentence = teacher.unlike(settings, named[point.frame], point.x, point.y)
        except (teacher.NothingError, teacher.TwoError):
            if settings.colour is None:
                raise
            sentence = f'unlike: at {point.x:g},{point.y:g} nothing like it is left, by colour'
        said.append(sentence)
    if len(samples) >= 3:
        settings = without_standing(settings, samples, meant)
    return settings, said


@dataclass(frozen=True)
class Look:
    """A film as it is tracked.

    Attributes
    ----------
    recording : Source
        The film with the view applied.
    settings : TrackerSettings
        Settings of the tracker.
    said : list of str
        Sentences on the examples.
    """

    recording: Source
    settings: TrackerSettings
    said: list[str]


def look(
    source: str | Path, report: Callable[[str], None], frame_rate_hz: float | None,
    settings: TrackerSettings, like: Sequence[Point] = (), unlike: Sequence[Point] = (),
) -> Look:
    """Examine a film and learn what to follow: by points, or by its own choice.

    Parameters
    ----------
    source : str or Path
        The film.
    report : callable
        Function that is called with each remark.
    frame_rate_hz : float or None
        Frame rate [Hz]; None for that of the film.
    settings : TrackerSettings
        Settings that are known before.
    like : sequence of Point
        Examples of particles.
    unlike : sequence of Point
        Examples of other objects.

    Returns
    -------
    Look
        The film and the settings.

    Raises
    ------
    InputError
        If a point shows nothing to learn.
    """
    from microbot_ros.cameras.interlaced import interlaced, one_field
    from microbot_ros.cameras.source import decoded, grey, open_source
    from microbot_ros.tracking.locate.colour import weighted
    from microbot_ros.tracking.teach.unprompted import without_prompt

    film = open_source(source, report, frame_rate_hz, decoded)
    named, samples = pictures(film, (*like, *unlike))
    colour = settings.colour
    said: list[str] = []
    if like and colour is None and not settings.kinds:
        colour, said = _telling_colour(like, unlike, named)
        settings = settings.replaced(colour=colour)
    half = interlaced(samples)

    def view(picture: np.ndarray) -> np.ndarray | None:
        if decoded(picture) is None:
            return None
        picture = one_field(picture) if half else picture
        return grey(picture) if colour is None else weighted(picture, colour)

    if half:
        report(f'{source}: its images are interlaced (every other row shows another moment); only '
               'the even rows are used')
        samples = [one_field(sample) for sample in samples]
    recording = open_source(source, report, frame_rate_hz, view)
    if colour is not None:
        samples = pictures(recording, ())[1]
    if like or unlike:
        seen = {frame: np.asarray(view(picture)) for frame, picture in named.items()}
        settings, more = pointed(settings, like, unlike, seen, samples)
        return Look(recording, settings, said + more)
    settings, doubts = without_prompt(settings, samples, recording.length or 0)
    for doubt in doubts:
        report(f'{source}: {doubt}')
    return Look(recording, settings, said)


def write_learned(folder: Path, settings: TrackerSettings, image: np.ndarray) -> None:
    """Write `learned.yaml`, for `--settings`, and `learned.png`, a picture of what is detected.

    Parameters
    ----------
    folder : Path
        Folder of the files.
    settings : TrackerSettings
        Settings of the tracker.
    image : ndarray
        Picture in which detections and excluded places are drawn.
    """
    import yaml

    from microbot_ros.common.files import write_text
    from microbot_ros.tracking.teach.kinds_figure import write_kinds_figure

    content = settings.content('changed')
    write_text(folder / 'learned.yaml',
               yaml.safe_dump(content, sort_keys=False, allow_unicode=True,
                              default_flow_style=None))
    write_kinds_figure(folder / 'learned.png', image, settings)


def _telling_colour(
    like: Sequence[Point], unlike: Sequence[Point], named: dict[int, np.ndarray]
) -> tuple[Weights | None, list[str]]:
    """Return the weights of colours that best distinguish the examples, and a sentence.

    None, and no sentence, if brightness is as good.
    """
    from microbot_ros.tracking.locate.colour import Spot, telling_weights

    found = telling_weights([
        *(Spot(named[point.frame], point.x, point.y, point.kind or '') for point in like),
        *(Spot(named[point.frame], point.x, point.y, None) for point in unlike)])
    if found is None:
        return None, []
    weights, gain = found
    return weights, ['detected by colour, {:.1f} times better than by brightness: {:+g} red {:+g} '
                     'green {:+g} blue'.format(gain, *weights)]
