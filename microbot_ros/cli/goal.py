"""`microbot goal`: where the controller is to go."""

from __future__ import annotations

import click

from microbot_ros import units
from microbot_ros.errors import InputError


@click.command()
@click.argument('positions_um', nargs=-1, required=True, metavar='X_UM,Y_UM...')
def command(positions_um: tuple[str, ...]) -> None:
    """Send goals to the running controller, in micrometres of the workspace, in order.

    \b
    Example, a square:
      microbot goal 20,20 -20,20 -20,-20 20,-20
    """
    from microbot_ros.nodes.remote import Remote

    goals = [_position(text) for text in positions_um]
    with Remote() as remote:
        remote.send_goals(goals)
    click.echo(f'{len(goals)} goals sent')


def _position(text: str) -> tuple[float, float]:
    try:
        x_um, y_um = (float(part) for part in text.split(','))
    except ValueError:
        raise InputError('goal', f'expected X_UM,Y_UM such as 20,-5; received {text!r}') from None
    return units.to_si('x_um', x_um), units.to_si('y_um', y_um)
