"""Command `microbot goal`: goals of the controller."""

from __future__ import annotations

import math
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

import click
import numpy as np

from microbot_ros.cli.options import PATH, FiniteFloatRange, namespace_option
from microbot_ros.common import units
from microbot_ros.common.errors import InputError, RigError, counted, shown
from microbot_ros.common.plausible import implausible

if TYPE_CHECKING:
    from microbot_ros.nodes.client.graph_client import GraphClient

Places = list[tuple[float, float]]

_HEALTH_SECONDS = 1.5
"""Time [s] for a report of a node on `/diagnostics`. Choice: one and a half periods of 1 s."""

_JUDGED_SECONDS = 1.0
"""Time [s] for the controller's verdict on goals. Choice: it judges them with the next frame, and
reports five times a second."""


# Unknown options are positions, which may begin with a minus sign.
@click.command(context_settings={'ignore_unknown_options': True})
@click.argument('positions_um', nargs=-1, metavar='[X_UM,Y_UM]...')
@click.option('--file', type=PATH,
              help='A CSV file with columns x_um,y_um in place of positions; an optional column '
                   'particle assigns each goal.')
@click.option('--path', 'as_path', is_flag=True, help='The positions are a path to follow, '
                                                      'not goals.')
@click.option('--cancel', is_flag=True, help='Delete goals and path.')
@click.option('--wait', 'seconds', type=FiniteFloatRange(0, 86400), metavar='SECONDS',
              help='Print the progress and wait for the arrival; exit 1 after this time.')
@namespace_option
def command(positions_um: tuple[str, ...], file: Path | None, as_path: bool, cancel: bool,
            seconds: float | None, namespace: str) -> None:
    """Send goals to the running controller, in micrometres of the workspace, in order.

    Ends when the controller has accepted them. Ends with 1 and the reason if the controller is
    missing, does not answer or refuses: goals outside the workspace, or a controller that accepts
    none, with the names of those that do. Reports if the coils are disarmed: the controller starts
    when they are armed.

    \b
    Examples:
      microbot goal 20,20 -20,20 -20,-20 20,-20
      microbot goal 20,10 --wait 60
      microbot goal --file eight.csv --path
    """
    if bool(positions_um) + bool(file) + cancel != 1:
        raise click.UsageError('expected either positions, or --file, or --cancel')
    if seconds is not None and (as_path or cancel):
        raise click.UsageError('expected --wait only with goals')
    places, particles = _read(file) if file else ([_position(t) for t in positions_um], None)
    if as_path and particles is not None:
        raise InputError(str(file), 'expected no column particle in a path')
    from microbot_ros.nodes.client.graph_client import GraphClient

    with GraphClient(namespace=namespace) as client:
        if cancel:
            client.send_path([])
            client.send_goals([])
            click.echo('cancelled')
            return
        coils = _Coils(client)
        taken = client.send_path(places) if as_path else client.send_goals(places, particles)
        count = len(places)
        what = f'path of {counted(count, "point")}' if as_path else counted(count, 'goal')
        _refuse(client, 'path' if as_path else 'goals', taken.stamp)
        if seconds is None:
            click.echo(f"{what} accepted by controller '{taken.controller}'")
            coils.listen()
            return
        _wait(client, taken.stamp, seconds)


def _position(text: str) -> tuple[float, float]:
    try:
        x_um, y_um = (float(part) for part in text.split(','))
    except ValueError:
        x_um = y_um = math.nan
    if implausible('x_um', np.array([x_um, y_um])).any():
        raise InputError('goal', f'expected X_UM,Y_UM such as 20,-5; received {shown(text)}')
    return units.to_si('x_um', x_um), units.to_si('y_um', y_um)


def _read(file: Path) -> tuple[Places, list[int] | None]:
    from microbot_ros.common.tables import Layout, read_table

    table = read_table(file, Layout(('x_um', 'y_um')), Layout(('x_um', 'y_um', 'particle')))
    columns = table.columns
    places = list(zip(columns['x_um'].tolist(), columns['y_um'].tolist(), strict=True))
    if 'particle' not in columns:
        return places, None
    particle = columns['particle']
    table.refuse((particle < 0) | (particle >= 2**32) | (particle % 1 != 0),
                 "expected whole numbers from 0 in 'particle'")
    return places, particle.astype(int).tolist()


class _Coils:
    """Reporter of why the coils will not act, once for each reason, on standard error."""

    def __init__(self, client: GraphClient) -> None:
        self._client = client
        self._heard = ''
        client.watch_health(self._on_health)

    def listen(self) -> None:
        """Wait until the coil driver has reported, if there is one."""
        if self._client.runs('coil_driver'):
            self._client.until(lambda: self._heard, _HEALTH_SECONDS)

    def _on_health(self, node: str, level: bytes, sentence: str, values: dict[str, str]) -> None:
        if node != 'coil_driver' or sentence == self._heard:
            return
        self._heard = sentence
        if level != b'\0' or values.get('armed') == 'False':
            click.echo(f'{node}: {sentence}', err=True)


def _refuse(client: GraphClient, what: str, stamp: float) -> None:
    """Raise RigError if the controller reports that it cannot follow the input of that stamp."""
    heard = ['', '']

    def tell(_level: bytes, sentence: str, values: dict[str, str]) -> None:
        # Until the next frame its poses count as stale.
        if float(values[f'{what}_stamp_s']) == stamp and values['result'] != 'stale poses':
            heard[:] = values['result'], sentence

    client.watch_progress(tell)
    client.until(lambda: heard[0], _JUDGED_SECONDS)
    if heard[0] == 'bad goal':
        raise RigError(heard[1])


def _wait(client: GraphClient, stamp: float, seconds: float) -> None:
    """Print progress until arrival; RigError if the goals are refused, else exit 1."""
    heard, next_line = ['', 'the controller stopped publishing'], 0.0

    def tell(_level: bytes, sentence: str, values: dict[str, str]) -> None:
        nonlocal next_line
        told = float(values['goals_stamp_s'])
        if told != stamp:
            heard[:] = (('replaced', 'other goals have replaced these') if told > stamp else
                        ('', 'the controller no longer has these goals'))
            return
        heard[:] = 'done' if values.get('done') == 'True' else values['result'], sentence
        if time.monotonic() >= next_line:
            next_line = time.monotonic() + 1.0
            click.echo(sentence, err=True)

    client.watch_progress(tell)
    client.until(lambda: heard[0] in ('done', 'bad goal', 'fault', 'replaced'), seconds)
    if heard[0] == 'bad goal':
        raise RigError(heard[1])
    click.echo('arrived' if heard[0] == 'done' else f'not arrived: {heard[1]}')
    sys.exit(0 if heard[0] == 'done' else 1)
