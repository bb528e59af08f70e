"""Command `microbot import`: tables of a laboratory as a session."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from microbot_ros.cli.options import (
    NEW_FOLDER,
    PATH,
    FiniteFloatRange,
    force_option,
    json_option,
    plausible_number,
)
from microbot_ros.common.errors import InputError, counted

if TYPE_CHECKING:
    from microbot_ros.session.spreadsheets.sheets import Answers

_ROLES = ('time, frame, particle, x, y, theta, direction, frequency, bx, by, speed, vx, vy, tilt, '
          'cone, gradient, sound')


_OPTIONS = (
    click.option('--column', 'columns', multiple=True, metavar='ROLE=NAME',
                 help=f'Name the column for a role: {_ROLES}.'),
    click.option('--position-unit', type=click.Choice(['um', 'mm', 'm', 'px'])),
    click.option('--pixel-size-um', type=plausible_number('pixel_size_um'),
                 help='Width of a pixel in the sample, if the table does not state it.'),
    click.option('--y', type=click.Choice(['up', 'down']),
                 help='Direction of y; down is assumed for pixels.'),
    click.option('--time-unit', type=click.Choice(['s', 'ms'])),
    click.option('--times', type=click.Choice(['moments', 'intervals'])),
    click.option('--frame-rate-hz', type=plausible_number('frame_rate_hz')),
    click.option('--angle-unit', type=click.Choice(['deg', 'rad'])),
    click.option('--angle-sense', type=click.Choice(['counterclockwise', 'clockwise'])),
    click.option('--angle-offset-deg', type=FiniteFloatRange(-3600, 3600),
                 help='Angle by which the angles of the commands are too large.'),
    click.option('--field-unit', type=click.Choice(['mT', 'T', 'G', 'fraction']),
                 help='Unit of Bx and By; fraction is of full scale.'),
    click.option('--full-scale-mT', 'full_scale_mT', type=plausible_number('reference_field_mT'),
                 help='Field that a fraction of 1 stands for.'),
    click.option('--ignore-speed', is_flag=True,
                 help='Do not check the scale against the speeds in the table.'),
)
"""Options for an import; the range of the angle is a choice, ten turns."""


def answer_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add to a command the options for facts that tables do not contain; see `answers`.

    Parameters
    ----------
    command : callable
        The command.

    Returns
    -------
    callable
        The command with the options.
    """
    for option in reversed(_OPTIONS):
        command = option(command)
    return command


@click.command(name='import')
@click.argument('source', type=PATH)
@click.option('--out', type=NEW_FOLDER, required=True,
              help='Folder of the session to write.')
@answer_options
@force_option
@json_option('Write findings and assumptions as JSON to this file.')
def command(source: Path, out: Path, force: bool, json_path: Path | None, **given: Any) -> None:
    """Convert SOURCE into a session: a spreadsheet, a delimited text file, or a folder of them.

    It recognises robots beside each other, below each other, or on separate sheets; times that are
    intervals; decimal commas; pixels with y down, and their size if the table has speeds in µm/s;
    units of angles; angles that increase clockwise. It prints its assumptions, keeps them in
    session.yaml, and asks, by the name of an option, for facts that no file contains. A stated
    pixel size that contradicts the speeds in the table is refused.

    \b
    Examples:
      microbot import tracks.xlsx --out sessions/monday
      microbot import places.xlsx --pixel-size-um 0.33 --out sessions/sunday
      microbot import robots.csv --column x="Centre X" --position-unit um --out sessions/tuesday
    """
    from rich.console import Console
    from rich.markup import escape

    from microbot_ros.common.files import refuse_to_overwrite, write_json
    from microbot_ros.common.units import exact_display
    from microbot_ros.session import write_session
    from microbot_ros.session.spreadsheets.assemble import import_session
    from microbot_ros.session.tables.folder import FILES

    own = [source] if source.is_file() else [source / name for name in FILES]
    if {one.resolve() for one in own} & {(out / name).resolve() for name in FILES}:
        raise InputError(out, 'expected another folder than that of the tables, which are kept')
    refuse_to_overwrite(out, FILES, force)
    with Console(stderr=True).status(escape(f'reading {source}')):
        session, said = import_session(source, answers(**given))
        write_session(out, session)
    tracks, commands = session.tracks, session.commands
    for sentence in said:
        click.echo(f'assumed  {sentence}')
    click.echo(f'{out}: {counted(len(tracks.particles), "robot")}, '
               f'{counted(len(tracks.t), "position")} over '
               f'{tracks.t[-1] - tracks.t[0]:.1f} s, {counted(len(commands.t), "command")}')
    if json_path:
        found = {
            'particles': tracks.particles.tolist(), 'positions': len(tracks.t),
            'commands': len(commands.t), 'duration_s': float(tracks.t[-1] - tracks.t[0]),
            'assumed': said,
            'pixel_size_um': session.conditions.pixel_size and float(
                exact_display('pixel_size_um', session.conditions.pixel_size)),
        }
        write_json(json_path, found)


def answers(*, columns: tuple[str, ...], **given: Any) -> Answers:
    """Return the facts on a table that the options of `answer_options` state.

    Parameters
    ----------
    columns : tuple of str
        Columns by role, as ROLE=NAME.
    **given : object
        Values of the other options.

    Returns
    -------
    Answers
        The facts.

    Raises
    ------
    InputError
        If a role of a column is unknown.
    """
    from microbot_ros.session.spreadsheets.stated import Stated

    return Stated(columns=_named_columns(columns), **given).answers()


def _named_columns(pairs: tuple[str, ...]) -> dict[str, str]:
    from microbot_ros.session.spreadsheets.columns import ROLES

    named = {}
    for pair in pairs:
        role, mark, name = pair.partition('=')
        if role not in ROLES or not mark or not name:
            raise InputError('--column', f'expected ROLE=NAME with a role of {_ROLES}; received '
                                         f'{pair}')
        named[role] = name
    return named
