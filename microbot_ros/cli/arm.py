"""`microbot arm`: let the coil driver drive, or not."""

from __future__ import annotations

import click


@click.command()
@click.option('--off', is_flag=True, help='Disarm: the coils go to zero and stay there.')
def command(off: bool) -> None:
    """Arm the safety gate of the running coil driver, or disarm it.

    Arming sends a short pulse through each coil to check its sign and gain. It is refused, with
    the reason, where a coil is not right or a fault stands.

    \b
    Example:
      microbot arm
      microbot arm --off
    """
    from microbot_ros.nodes.remote import Remote

    with Remote() as remote:
        remote.arm(not off)
    click.echo('disarmed: the coils are at zero' if off else 'armed')
