"""Command `microbot arm`: permit the coil driver to drive, or forbid it."""

from __future__ import annotations

import click

from microbot_ros.cli.options import namespace_option


@click.command()
@click.option('--off', is_flag=True,
              help='Disarm: send zero to the coils, and report whether it is confirmed.')
@namespace_option
def command(off: bool, namespace: str) -> None:
    """Arm the safety gate of the running coil driver, or disarm it.

    Arming sends a short pulse through each coil to check its sign and gain. The request is sent
    once: without an answer to it the driver is disarmed. Ends with 1 and the reason if the coil
    driver is missing, does not answer or refuses, for example because a coil is faulty.

    Disarming prints one of three states: zero, confirmed by a reading; zero sent, not confirmed;
    not reachable. Ends with 1 for the third, and for the second if the amplifier reads its
    currents back and so could have confirmed it.

    \b
    Example:
      microbot arm
      microbot arm --off
    """
    from microbot_ros.nodes.client.graph_client import GraphClient

    with GraphClient(namespace=namespace) as client:
        answer = client.stop() if off else client.arm()
    click.echo(f'disarmed: {answer}' if off else answer)
