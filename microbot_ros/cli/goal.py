"""`microbot goal`: where the controller is to go."""

from __future__ import annotations

import math
import sys
import time
from pathlib import Path

import click

from microbot_ros import units
from microbot_ros.cli.within import Within
from microbot_ros.errors import InputError

Places = list[tuple[float, float]]


# Unknown options are taken as positions, for those may begin with a minus sign.
@click.command(context_settings={'ignore_unknown_options': True})
@click.argument('positions_um', nargs=-1, metavar='[X_UM,Y_UM]...')
@click.option('--file', type=click.Path(path_type=Path),
              help='A CSV file with columns x_um,y_um instead; a column particle says whose goal '
                   'each is.')
@click.option('--path', 'as_path', is_flag=True, help='A path to follow, not goals.')
@click.option('--cancel', is_flag=True, help='Forget goals and path.')
@click.option('--wait', 'seconds', type=Within(0, 86400), metavar='SECONDS',
              help='Tell the progress and wait for the arrival; exit 1 if it takes longer.')
def command(positions_um: tuple[str, ...], file: Path | None, as_path: bool, cancel: bool,
            seconds: float | None) -> None:
    """Send goals to the running controller, in micrometres of the workspace, in order.

    \b
    Examples:
      microbot goal 20,20 -20,20 -20,-20 20,-20
      microbot goal 20,10 --wait 60
      microbot goal --file eight.csv --path
    """
    if bool(positions_um) + bool(file) + cancel != 1:
        raise click.UsageError('expected either positions, or --file, or --cancel')
    if seconds is not None and (as_path or cancel):
        raise click.UsageError('--wait is for goals')
    places, particles = _read(file) if file else ([_position(t) for t in positions_um], None)
    if as_path and particles is not None:
        raise InputError(str(file), 'expected no column particle in a path')
    from microbot_ros.nodes.remote import Remote

    with Remote() as remote:
        if as_path or cancel:
            remote.send_path(places)
        if not as_path:
            stamp = remote.send_goals(places, particles)
            if seconds is not None:
                _wait(remote, stamp, seconds)
                return
    click.echo('cancelled' if cancel else
               f'path of {len(places)} points sent' if as_path else f'{len(places)} goals sent')


def _position(text: str) -> tuple[float, float]:
    try:
        x_um, y_um = (float(part) for part in text.split(','))
    except ValueError:
        x_um = y_um = math.nan
    if not (math.isfinite(x_um) and math.isfinite(y_um)):
        raise InputError('goal', f'expected X_UM,Y_UM such as 20,-5; received {text!r}')
    return units.to_si('x_um', x_um), units.to_si('y_um', y_um)


def _read(file: Path) -> tuple[Places, list[int] | None]:
    from microbot_ros.session.tables import Layout, read_table

    table = read_table(file, Layout(('x_um', 'y_um')), Layout(('x_um', 'y_um', 'particle')))
    columns = table.columns
    places = list(zip(columns['x_um'].tolist(), columns['y_um'].tolist(), strict=True))
    if 'particle' not in columns:
        return places, None
    particle = columns['particle']
    table.refuse((particle < 0) | (particle >= 2**32) | (particle % 1 != 0),
                 "expected whole numbers from 0 in 'particle'")
    return places, particle.astype(int).tolist()


def _wait(remote, stamp: float, seconds: float) -> None:  # type: ignore[no-untyped-def]
    """Tell the progress until arrival; InputError where the goals are refused, else exit 1."""
    heard, next_line = ['', 'nothing was heard of the controller'], 0.0

    def tell(_level: bytes, sentence: str, values: dict[str, str]) -> None:
        nonlocal next_line
        if float(values['goals_stamp_s']) < stamp:
            return
        heard[:] = 'done' if values.get('done') == 'True' else values['result'], sentence
        if time.monotonic() >= next_line:
            next_line = time.monotonic() + 1.0
            click.echo(sentence, err=True)

    def warn(node: str, level: bytes, sentence: str, _values: dict[str, str]) -> None:
        if node == 'coil_driver' and level != b'\0' and warned[:1] != [sentence]:
            warned[:] = [sentence]
            click.echo(f'{node}: {sentence}', err=True)

    warned: list[str] = []
    remote.watch_health(warn)
    remote.watch_progress(tell)
    deadline = time.monotonic() + seconds
    while heard[0] not in ('done', 'bad goal', 'fault') and time.monotonic() < deadline:
        remote.spin(0.1)
    if heard[0] == 'bad goal':
        raise InputError('', heard[1])
    click.echo('arrived' if heard[0] == 'done' else f'not arrived: {heard[1]}')
    sys.exit(0 if heard[0] == 'done' else 1)
