"""`microbot arm`: let the coil driver drive, or not."""

from __future__ import annotations

import click

from microbot_ros.cli.options import namespace_option


@click.command()
@click.option('--off', is_flag=True, help='Disarm: the coils go to zero and stay there.')
@namespace_option
def command(off: bool, namespace: str) -> None:
    """Arm the safety gate of the running coil driver, or disarm it.

    Arming sends a short pulse through each coil to check its sign and gain. Ends with 1
    and the reason where the coil driver is not there, does not answer or refuses: where a coil is
    not right or a fault stands.

    \b
    Example:
      microbot arm
      microbot arm --off
    """
    from microbot_ros.nodes.graph_client import GraphClient

    with GraphClient(namespace=namespace) as client:
        client.arm(not off)
    click.echo('disarmed: the coils are at zero' if off else 'armed')
