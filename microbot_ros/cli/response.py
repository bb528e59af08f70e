"""Command `microbot response`: speed, turning and slip at each plateau of the command."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from microbot_ros.cli.options import NEW_FOLDER, PATH, force_option, json_option

if TYPE_CHECKING:
    from microbot_ros.response.plateaus import Against, Definition
    from microbot_ros.response.result import Labelled

_OUTPUTS = ('response.csv', 'response.json', 'response.parquet', 'response.png', 'response.pdf',
            'response.html')


@click.command()
@click.argument('sources', metavar='SESSION...|ARCHIVE', nargs=-1, required=True,
                type=PATH)
@click.option('--out', type=NEW_FOLDER, required=True, metavar='DIR',
              help='Folder for response.csv, .parquet, .json, the figures and the page.')
@click.option('--against', type=click.Choice(['frequency', 'field', 'tilt']), default='frequency',
              show_default=True, help='Commanded quantity: rotation, field strength, or the '
                                      'tilt of the axis of rotation.')
@click.option('--definition', type=click.Choice(['motion', 'tables']), default='motion',
              show_default=True, help='Definition of speed: motion along a constant command, '
                                      "or the definition of a laboratory's tables.")
@json_option('Write the content of response.json to this file too.')
@force_option
def command(sources: tuple[Path, ...], out: Path, against: Against, definition: Definition,
            json_path: Path | None, force: bool) -> None:
    """Measure how fast robots move at each plateau of the command.

    SESSION or ARCHIVE are sessions, or an archive filled by `microbot batch import` or `track`.
    The result contains for every robot and plateau the speed along and across the command, slip
    angle and turning, with 95 % intervals and the number of independent samples; by robot, kind
    and day, with cut-in and step-out by the law of `drive_response`. Frames after a change and
    turns are left out.

    \b
    Examples:
      microbot response archive --out out/response
      microbot response sessions/monday sessions/tuesday --out out/response --against field
      microbot response archive --out out/tables --definition tables
    """
    from rich.console import Console
    from rich.markup import escape

    from microbot_ros.common.errors import InputError
    from microbot_ros.common.files import output_folder, refuse_to_overwrite, write_text
    from microbot_ros.response import report, words
    from microbot_ros.response.result import respond_all

    refuse_to_overwrite(out, _OUTPUTS, force)
    progress = Console(stderr=True, highlight=False, soft_wrap=True)
    with progress.status('reading') as status:
        read: dict[Path, Labelled] = {}
        folders = _sessions(sources)
        for done, path in enumerate(folders):
            status.update(escape(f'reading {done + 1} of {len(folders)}: {path.name}'))
            try:
                read[path.resolve()] = _labelled(path)
            except InputError as error:
                if path in sources:
                    raise
                # One of many sessions of an archive, such as a film without a pixel size.
                progress.print(f'left out  {error}', markup=False)
        # A robot is a particle of a session, and two folders may have the same name.
        names = Counter(one.session.name for one in read.values())
        sessions = [one if names[one.session.name] == 1 else
                    replace(one, session=replace(one.session, name=str(path)))
                    for path, one in read.items()]
        status.update(f'measuring {len(sessions)} sessions')
        found = respond_all(sessions, against, definition)
        if not found.rows:
            turns = any(one.session.commands.frequency is not None for one in sessions)
            hint = '' if turns or against == 'field' else '; nothing rotates: try --against field'
            raise InputError(', '.join(map(str, sources)),
                             f'expected plateaus of the {against}, found none{hint}')
        status.update('drawing')
        with output_folder(out) as folder:
            report.write(found, folder)
            parquet = _write_parquet(found, folder)
            if json_path:
                write_text(json_path, (folder / 'response.json').read_text(encoding='utf-8'))
    console = Console(highlight=False, soft_wrap=True)
    for line in (words.summary(found), *map(words.unlike, found.unlike),
                 *words.exclusions(found)):
        console.print(line, markup=False)
    robots = len({row.robot for row in found.rows})
    console.print(f'{out}: {len(found.rows)} plateaus of {robots} robots in response.csv'
                  f'{", .parquet" if parquet else ""}, .json; response.png, .pdf; response.html',
                  markup=False)
    if not parquet:
        progress.print('no response.parquet: install PyArrow with pip install '
                       "'microbot_ros[dask]'")


def _sessions(sources: tuple[Path, ...]) -> list[Path]:
    """Return the sessions in `sources`, and in archives there; InputError for anything else."""
    from microbot_ros.archive.recordings import MARK
    from microbot_ros.archive.work import SESSIONS
    from microbot_ros.common.errors import InputError

    found: list[Path] = []
    for source in sources:
        if not (source / MARK).is_dir():
            found.append(source)
            continue
        inside = source / SESSIONS
        own = sorted(path for path in inside.iterdir() if (path / 'tracks.csv').is_file()) \
            if inside.is_dir() else []
        if not own:
            raise InputError(source, 'expected an archive with sessions, made by microbot batch '
                                     'import or track')
        found += own
    return found


def _labelled(path: Path) -> Labelled:
    from microbot_ros.archive.labels import labels_of
    from microbot_ros.archive.recordings import Found
    from microbot_ros.response.result import Labelled
    from microbot_ros.session import read_session
    from microbot_ros.session.mcap.recording import is_recording

    session = read_session(path)
    place = path.resolve()
    top = place if place.is_dir() else place.parent
    labels = labels_of(Found(place, 'recording' if is_recording(place) else 'session', top, ()))
    return Labelled(session, labels.kind or '', labels.day.isoformat() if labels.day else '',
                    labels.rig or '')


def _write_parquet(found: object, folder: Path) -> bool:
    """Write the rows as Parquet; return False if PyArrow is not installed."""
    from importlib.util import find_spec

    if find_spec('pyarrow') is None:
        return False
    from microbot_ros.archive.table import write_rows
    from microbot_ros.response.report import rows
    from microbot_ros.response.result import Response

    assert isinstance(found, Response)
    write_rows(rows(found), folder / 'response.parquet')
    return True
