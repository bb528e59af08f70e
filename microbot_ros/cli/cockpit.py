"""`microbot cockpit`: the operator's page of a running rig."""

from __future__ import annotations

import sys

import click

from microbot_ros.cli.options import namespace_option


@click.command()
@click.option('--host', default='127.0.0.1', show_default=True, metavar='H',
              help='Name or address of this machine to listen at; 0.0.0.0 for all it has.')
@click.option('--port', type=click.IntRange(0, 65535), default=8642, show_default=True,
              metavar='P', help='Port to listen at; 0 takes any that is free.')
@namespace_option
def command(host: str, port: int, namespace: str) -> None:
    """Serve the operator's page until Ctrl-C: see, point, steer, stop, from any browser.

    It prints the address to open. The page is for this machine, unless --host says otherwise;
    then its address holds a token, without which nobody is let in. What is sent over a network
    can be overheard.

    The cockpit is no barrier: the driver's dead-man and the amplifier's watchdog are. To end it
    harms nothing; a rig that drives goes on.

    \b
    Example:
      microbot cockpit
      microbot cockpit --host 0.0.0.0 --port 8000
    """
    from microbot_ros.nodes.graph_client import checked_namespace
    from microbot_ros.nodes.process import run

    given = {'host': host, 'port': str(port)}
    sys.exit(run(['cockpit'], [
        '--ros-args', '-r', f'__ns:={checked_namespace(namespace)}',
        *(word for name, value in given.items() for word in ('-p', f'{name}:={value}'))]))
