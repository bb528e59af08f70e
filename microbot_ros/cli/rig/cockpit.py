"""Command `microbot cockpit`: the operator's page of a running rig."""

from __future__ import annotations

import json
import sys

import click

from microbot_ros.cli.options import namespace_option


@click.command()
@click.option('--host', default='127.0.0.1', show_default=True, metavar='H',
              help='Host name or address of this machine to listen on; 0.0.0.0 for all addresses.')
@click.option('--port', type=click.IntRange(0, 65535), default=8642, show_default=True,
              metavar='P', help='Port to listen on; 0 takes any free port.')
@click.option('--token/--no-token', default=True, show_default=True,
              help='Whether pages need the token in the address; without it every user of this '
                   'machine can drive the rig.')
@namespace_option
def command(host: str, port: int, token: bool, namespace: str) -> None:
    """Serve the operator's page until Ctrl-C: watch, steer and stop the rig from any browser.

    On a terminal it prints the address to open; elsewhere, such as in a service, the name of the
    file that contains it, which only you can read. The address contains a token, new at each
    start, without which access is refused. On a machine with one user --no-token leaves it out; it
    is refused with a --host beyond this machine. Anybody on the network can read data sent over
    it.

    The cockpit is no safety barrier: the driver's dead-man and the amplifier's watchdog are.
    Ending it is harmless; a rig that drives continues.

    \b
    Example:
      microbot cockpit
      microbot cockpit --host 0.0.0.0 --port 8000
      microbot cockpit --no-token
    """
    from microbot_ros.nodes.client.graph_client import checked_namespace
    from microbot_ros.nodes.process import run

    given = {'host': json.dumps(host), 'port': str(port), 'token': str(token).lower()}
    sys.exit(run('cockpit', [
        '--ros-args', '-r', f'__ns:={checked_namespace(namespace)}',
        *(word for name, value in given.items() for word in ('-p', f'{name}:={value}'))]))
