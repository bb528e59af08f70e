"""Command `microbot track`: particles and their identities from a recording."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from microbot_ros.cli.options import (
    NEW_FOLDER,
    PATH,
    force_option,
    json_option,
    plausible_number,
)
from microbot_ros.cli.track.learn import Point, PointType, look, write_learned
from microbot_ros.common.units import to_si

if TYPE_CHECKING:
    from microbot_ros.cameras.source import Source
    from microbot_ros.tracking import Appearance, Tracker, TrackerSettings
    from microbot_ros.tracking.overlay import OverlayVideo
    from microbot_ros.tracking.rows import Rows

_OUTPUTS = ('tracks.csv', 'overlay.mp4', 'settings.png', 'learned.yaml', 'learned.png')

_WHOLE = 0.95
"""Share of the frames in which a particle that lives from start to end is seen. Choice: it may be
missed now and then; one that leaves for longer is not counted."""


@click.command()
@click.argument('source')
@click.option('--out', type=NEW_FOLDER, required=True, metavar='DIR',
              help='Folder for tracks.csv, overlay.mp4 and settings.png.')
@click.option('--pixel-size-um', type=plausible_number('pixel_size_um'),
              help='Width of a pixel in the sample; adds t_s, x_um, y_um (y up, origin at the '
              'centre of the image).')
@click.option('--frame-rate-hz', type=plausible_number('frame_rate_hz'),
              help="Frames per second, of images or in place of a video's own rate.")
@click.option('--settings', 'settings_path', type=PATH, metavar='YAML',
              help='Settings of detection and linking; missing ones are chosen automatically.')
@click.option('--commands', 'commands_path', type=PATH, metavar='CSV',
              help='Commands that drove the particles, on the clock of the frames (the first '
                   'is at 0): commands.csv of a session. Turns of the field are then '
                   'predicted.')
@click.option('--like', multiple=True, type=PointType(named=True),
              help='Point at a particle to follow, in this frame at these pixels; KIND names it. '
                   'A point between two near parts means both, as one body. Repeat for more '
                   'examples.')
@click.option('--unlike', multiple=True, type=PointType(named=False),
              help='Point at something that is not to be followed.')
@click.option('--overlay/--no-overlay', default=True, help='Write overlay.mp4.')
@force_option
@json_option('Write the result as JSON to this file.')
def command(
    source: str, out: Path, pixel_size_um: float | None, frame_rate_hz: float | None,
    settings_path: Path | None, commands_path: Path | None, like: tuple[Point, ...],
    unlike: tuple[Point, ...], overlay: bool, force: bool, json_path: Path | None,
) -> None:
    """Track the particles of SOURCE: a video, a folder of images, or a glob (quoted).

    The appearance of the particles is learned from the first frames; settings.png shows the
    choice. If that misses moving objects, or if you point at one (--like), the kinds that are
    followed are written to learned.yaml, for --settings, and learned.png. tracks.csv has one row
    for every particle in every frame in which it was seen: with --pixel-size-um also in
    micrometres, with its heading and σ.

    \b
    Examples:
      microbot track recording.mp4 --out out/tracks --pixel-size-um 0.33
      microbot track frames/ --out out/tracks --frame-rate-hz 24
      microbot track 'frames/img_*.png' --out out/tracks --settings tracker.yaml
      microbot track recording.mp4 --out out/tracks --commands session/commands.csv
      microbot track recording.mp4 --out out/tracks --like 0,435,326,helix --unlike 0,923,570
    """
    from rich.console import Console

    from microbot_ros.common.files import (
        output_folder,
        read_yaml,
        refuse_to_overwrite,
        write_json,
    )
    from microbot_ros.tracking import TrackerSettings

    refuse_to_overwrite(out, _OUTPUTS, force)
    settings = read_yaml(settings_path, TrackerSettings) if settings_path else TrackerSettings()
    commanded = _Commanded(commands_path) if commands_path else None
    console = Console(stderr=True, highlight=False, soft_wrap=True, markup=False)
    problems: list[str] = []
    with console.status('reading the film'):
        film = look(source, problems.append, frame_rate_hz, settings, like, unlike)
    recording, settings = film.recording, film.settings
    for sentence in film.said:
        console.print(f'microbot track: {sentence}', markup=False)
    if recording.frame_rate is None and pixel_size_um is not None:
        problems.append(f'{source}: no frame rate is known (--frame-rate-hz); t_s counts frames')
    with output_folder(out, _OUTPUTS) as folder:
        if settings.kinds:
            write_learned(folder, settings, next(recording.frames()).image)
        result = _track(recording, settings, folder, pixel_size_um, commanded, overlay, console,
                        problems)
    if result['frames'] < settings.confirm_frames and result['appearance']:
        problems.append(f'{source}: a particle needs {settings.confirm_frames} frames, the film '
                        f'has {result["frames"]}; no tracks')
    if not result['appearance']:
        problems.append(f'{source}: nothing stands out of the noise; no tracks')
    for problem in dict.fromkeys(problems):
        console.print(f'microbot track: {problem}', markup=False)
    result['warnings'] = list(dict.fromkeys(problems))
    write_json(json_path, result)
    console.print(
        f'{out}: {result["frames"]} frames, {result["tracks"]} particles, '
        f'{result["whole_clip"]} of them from start to end')


def _track(
    recording: Source, settings: TrackerSettings, folder: Path, pixel_size_um: float | None,
    commanded: _Commanded | None, overlay: bool, console: Any, problems: list[str],
) -> dict[str, Any]:
    """Write the files of the folder; return the result for JSON, and extend `problems`."""
    from microbot_ros.tracking import Tracker
    from microbot_ros.tracking.locate.kinds_detector import stand_in
    from microbot_ros.tracking.overlay import OverlayVideo
    from microbot_ros.tracking.rows import Rows
    from microbot_ros.tracking.teach.learn import learn_first

    with console.status('learning what the particles look like'):
        appearance = stand_in(settings.kinds) if settings.kinds else learn_first(
            (frame.image for frame in recording.frames()), settings)
    if appearance is not None:
        _draw_settings(folder / 'settings.png', recording, appearance, settings)
    with (folder / 'tracks.csv').open('w', encoding='utf-8') as file:
        rows = Rows(file, recording.size,
                    None if pixel_size_um is None else to_si('_um', pixel_size_um),
                    [kind.name for kind in settings.kinds])
        if appearance is not None:
            video = OverlayVideo(
                folder / 'overlay.mp4', recording.size, recording.frame_rate or 10.0,
                appearance.diameter_px / 2) if overlay else None
            with video or nullcontext():
                _follow(recording, Tracker(settings, appearance), rows, commanded, video, console,
                        problems)
        rows.close()
    return _summary(rows) | {'appearance': appearance.describe() if appearance else []}


def _follow(
    recording: Source, tracker: Tracker, rows: Rows, commanded: _Commanded | None,
    video: OverlayVideo | None, console: Any, problems: list[str],
) -> None:
    """Pass every frame through the tracker, into the rows and the video."""
    from rich.progress import track as progress

    from microbot_ros.tracking import FrameError
    from microbot_ros.tracking.rows import Remarks

    remarks, last = Remarks(), 0.0
    for frame in progress(recording.frames(), 'tracking', recording.length, console=console,
                          transient=True):
        try:
            drive = commanded.between(last, frame.t) if commanded else None
            poses = tracker.update(frame.image, frame.t, drive)
            last = frame.t
        except FrameError as error:
            problems.append(f'frame {frame.index}: {error.expected}; left out')
            continue
        rows.add(frame.index, poses, *tracker.before_named)
        remarks.add(frame.index, tracker.remarks)
        if video:
            video.write(frame.image, poses)
    problems += remarks.sentences()


def _summary(rows: Rows) -> dict[str, Any]:
    counts = sorted(rows.seen.values())
    return {
        'frames': rows.frames,
        'tracks': len(counts),
        'whole_clip': sum(count >= _WHOLE * rows.frames for count in counts),
        'median_frames_seen': counts[len(counts) // 2] if counts else 0,
        'positions': sum(counts),
    }


class _Commanded:
    """Drive of the particles, from a commands.csv."""

    def __init__(self, path: Path) -> None:
        from microbot_ros.common.tables import read_table
        from microbot_ros.estimation.online.commands import NEGLIGIBLE
        from microbot_ros.session.tables.folder import ROLLING, UNIFORM
        from microbot_ros.tracking import Drive

        table = read_table(path, UNIFORM, ROLLING)
        columns = table.columns
        table.refuse(np.diff(columns['t_s'], prepend=-np.inf) <= 0, 'expected ascending times')
        if table.layout is ROLLING:
            angle, rate = columns['direction_rad'], columns['frequency_hz']
            drives = rate[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
            self._rows = list(zip(columns['t_s'], drives, strict=True))
        else:
            field = np.column_stack([columns['bx_mT'], columns['by_mT']])
            size = np.hypot(*field.T)
            turns = size >= NEGLIGIBLE  # without a field, particles keep their direction
            drives = field[turns] / size[turns, None]
            self._rows = list(zip(columns['t_s'][turns], drives, strict=True))
        self._rows.reverse()
        self._drive = Drive()

    def between(self, start: float, end: float) -> np.ndarray:
        """Return the drive (2,) in the image's axes, summed in order from `start` to `end` [s]."""
        while self._rows and self._rows[-1][0] <= end:
            self._drive.command(*self._rows.pop())
        x, y = self._drive.between(start, end)
        return np.array([x, -y])


def _draw_settings(
    path: Path, recording: Source, appearance: Appearance, settings: TrackerSettings
) -> None:
    from microbot_ros.tracking.settings_figure import write_settings_figure
    from microbot_ros.tracking.tracker import make_detector

    image = next(recording.frames()).image
    found = make_detector(appearance, settings).detect(image, np.empty((0, 2)))
    write_settings_figure(path, image, found, appearance, settings)
