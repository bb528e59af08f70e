"""Command `microbot batch`: an archive of recordings, on many cores or machines."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from microbot_ros.cli.import_ import answer_options, answers
from microbot_ros.cli.options import (
    NEW_FOLDER,
    PATH,
    FiniteFloatRange,
    json_option,
    plausible_number,
)
from microbot_ros.common.errors import counted

if TYPE_CHECKING:
    from rich.console import Console

    from microbot_ros.archive import Progress, Summary
    from microbot_ros.archive.work import Task

_COMMON = (
    click.argument('folders', metavar='FOLDER...', nargs=-1, required=True,
                   type=PATH),
    click.option('--out', type=NEW_FOLDER, required=True, metavar='ARCHIVE',
                 help='Folder for archive.parquet, archive.html and the results.'),
    click.option('--workers', type=click.IntRange(1), metavar='N',
                 help='Processes on this machine; default: the number of cores.'),
    click.option('--scheduler', metavar='ADDRESS',
                 help='Address of a running Dask scheduler; its workers do the work.'),
    json_option('Write a summary of the work and its results as JSON to this file.'),
)
"""Options of all tasks; numbers are the smallest allowed, by definition."""

_LOGGED_S = 60.0
"""Time [s] between lines of progress where a line cannot change, as in a file.

Choice: a night makes a few hundred lines; a longer time looks like a run that stands still.
"""


def _common_options(command: Callable[..., Any]) -> Callable[..., Any]:
    for option in reversed(_COMMON):
        command = option(command)
    return command


@click.group()
def command() -> None:
    """Process all recordings in folders, each once, on Dask distributed.

    Recordings are found by the content of files: session folders, MCAP recordings, films, tables.
    Earlier results are kept, and an interrupted run continues where it was. An archive.yaml in any
    folder states `rig`, `batch`, `kind` and `recorded`, which no file contains, and options such
    as `pixel_size_um` for the folder, a file or a glob.

    \b
    Examples:
      microbot batch track films/ --out archive --pixel-size-um 0.33
      microbot batch fit archive/sessions recordings/ --out archive
      microbot batch discover recordings/ --out archive --scheduler tcp://head:8786
    """


@command.command('track')
@_common_options
@click.option('--pixel-size-um', type=plausible_number('pixel_size_um'),
              help='Width of a pixel in the sample, if no session.yaml beside a film states it.')
@click.option('--frame-rate-hz', type=plausible_number('frame_rate_hz'),
              help="Frames per second, of images or in place of a film's own rate.")
@click.option('--settings', 'settings_path', type=PATH, metavar='YAML',
              help='Settings of detection and linking; missing ones are chosen automatically.')
def _track(pixel_size_um: float | None, frame_rate_hz: float | None, settings_path: Path | None,
           **common: Any) -> None:
    """Track every film: a video file, or a folder of images.

    Each film becomes a session in ARCHIVE/sessions, with the commands.csv and session.yaml beside
    the film. A film and the table of the same name are one recording: the session has the film's
    tracks and the table's commands and scale, and both positions are compared.

    \b
    Example:
      microbot batch track films/ --out archive --pixel-size-um 0.33
    """
    from microbot_ros.common.files import read_yaml
    from microbot_ros.tracking import TrackerSettings

    tracker = read_yaml(settings_path, TrackerSettings) if settings_path else TrackerSettings()
    _run('track', {'pixel_size_um': pixel_size_um, 'frame_rate_hz': frame_rate_hz,
                   'tracker': tracker.content('given')}, **common)


@command.command('fit')
@_common_options
@click.option('--exposure-ms', type=FiniteFloatRange(0, 10_000), default=0.0, show_default=True,
              help='Exposure time of a frame, for the blur of diffusion during it.')
@answer_options
def _fit(exposure_ms: float, folders: tuple[Path, ...], out: Path, workers: int | None,
         scheduler: str | None, json_path: Path | None, **given: Any) -> None:
    """Fit v, φ, F, D and σ in every session, and compare the sessions.

    \b
    Example:
      microbot batch fit recordings/ --out archive --workers 4
    """
    settings = {'exposure_s': exposure_ms * 1e-3, 'answers': _answered(given)}
    _run('fit', settings, folders, out, workers, scheduler, json_path)


@command.command('discover')
@_common_options
@answer_options
def _discover(folders: tuple[Path, ...], out: Path, workers: int | None, scheduler: str | None,
              json_path: Path | None, **given: Any) -> None:
    """Search every session for the missing effect, and report effects that recur.

    Effects that recur are then measured in every session: which sessions have them, which do not,
    and whether their parameters are common or vary by session.

    \b
    Example:
      microbot batch discover recordings/ --out archive --scheduler tcp://head:8786
    """
    _run('discover', {'answers': _answered(given)}, folders, out, workers, scheduler, json_path)


@command.command('import')
@_common_options
@answer_options
def _import(folders: tuple[Path, ...], out: Path, workers: int | None, scheduler: str | None,
            json_path: Path | None, **given: Any) -> None:
    """Convert every table, spreadsheet or text, into a session in ARCHIVE/sessions.

    The options are those of `microbot import`, for all tables unless an archive.yaml states
    others. Every assumption is printed with the tables it was made for, and kept in session.yaml.
    Tables of averages are not recordings; they are counted separately.

    \b
    Example:
      microbot batch import tables/ --out archive
    """
    _run('import', {'answers': _answered(given)}, folders, out, workers, scheduler, json_path)


def _answered(given: dict[str, Any]) -> dict[str, Any]:
    return dataclasses.asdict(answers(**given))


def _run(task: Task, settings: dict[str, Any], folders: tuple[Path, ...], out: Path,
         workers: int | None, scheduler: str | None, json_path: Path | None) -> None:
    """Run a task with progress and print the results."""
    from rich.console import Console

    from microbot_ros.archive import run_batch
    from microbot_ros.common.errors import ReportError
    from microbot_ros.common.files import write_json

    if workers is not None and scheduler is not None:
        raise click.UsageError('expected either --workers or --scheduler')
    with _Shown(Console(stderr=True, highlight=False, soft_wrap=True, markup=False)) as shown:
        summary, found = run_batch(task, folders, out, settings, workers, scheduler, shown.report)
    for line in _told(summary):
        shown.console.print(line, markup=False)
    write_json(json_path, dataclasses.asdict(summary) | found)
    console = Console(highlight=False, soft_wrap=True, markup=False)
    own = {'import': lambda: _assumed(found['imported']),
           'track': lambda: _beside_tables(found['films'])}.get(task, list)
    for line in [*own(), *found['sentences']]:
        console.print(line, markup=False)
    if summary.no_report:
        raise ReportError(summary.no_report)
    if task in ('import', 'track'):
        made = found['imported']['sessions'] if task == 'import' else len(found['films'])
        console.print(f'{out}: {counted(made, "session")} in {out / "sessions"}', markup=False)
    else:
        console.print(
            f'{out}: {counted(found["sessions"], "session")}, '
            f'{counted(found["particles"], "particle")} in archive.parquet; archive.html',
            markup=False)


def _assumed(imported: dict[str, Any]) -> list[str]:
    """Return a line for each assumption, with the recordings that it was made for."""
    from microbot_ros.archive.conclusions.conclude import listed

    lines = []
    for one in imported['assumed']:
        of = one['recordings']
        where = f'all {len(of)}' if len(of) == imported['sessions'] and len(of) > 1 else listed(
            of, 3)
        lines.append(f'assumed  {one["sentence"]}  [{where}]')
    return lines


def _beside_tables(films: dict[str, Any]) -> list[str]:
    """Return a line for each film and robot of the table of the film's name."""
    return [f'{name}: {sentence}' for name, film in films.items() if 'table' in film
            for sentence in film['table']['sentences']]


def _told(summary: Summary) -> list[str]:
    lines = [f'{name}: {reason}' for name, reason in sorted(summary.refused.items())]
    lines += [f'{name}: {reason}; the next run tries it again'
              for name, reason in sorted(summary.failed.items())]
    lines += [f'{name}: {sentence}' for name, sentence in sorted(summary.summaries.items())]
    lines += [f'{name}: a copy of {other}' for name, other in sorted(summary.copy_of.items())]
    parts = [f'{summary.done} done', f'{summary.kept} kept from before']
    parts += [f'{count} {what}' for count, what in (
        (len(summary.copy_of), 'copied from others'),
        (len(summary.summaries), 'with averages only'), (summary.aside, f'not for {summary.task}'),
        (len(summary.refused), 'refused'), (len(summary.failed), 'failed')) if count]
    return [*lines, f'{counted(summary.found, "recording")}: {", ".join(parts)}']


class _Shown:
    """Progress on a console: a line that changes, and lines that stay.

    Where the console is no terminal, a line every `_LOGGED_S` takes the place of the one that
    changes.
    """

    def __init__(self, console: Console, now: Callable[[], float] = time.monotonic) -> None:
        self.console = console
        self._status = console.status('')
        self._now = now
        self._logged_s = now()

    def __enter__(self) -> _Shown:
        self._status.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._status.stop()

    def report(self, progress: Progress) -> None:
        """Show progress."""
        if progress.note:
            self.console.print(progress.note, markup=False)
            return
        line = _line(progress)
        self._status.update(line)
        if not self.console.is_terminal and self._now() - self._logged_s >= _LOGGED_S:
            self._logged_s = self._now()
            self.console.print(line, markup=False)


def _line(progress: Progress) -> str:
    if not progress.total:
        return progress.doing
    line = f'{progress.doing}: {progress.done} of {progress.total}'
    if progress.seconds_left is None:
        return line
    minutes, seconds = divmod(round(progress.seconds_left), 60)
    rate = (f'{progress.rate:.1f} a second' if progress.rate >= 0.1 else
            f'{60 * progress.rate:.1f} a minute')
    return f'{line}, {rate}, {minutes}:{seconds:02d} left'
