"""Command `microbot set`: change a parameter of a running node."""

from __future__ import annotations

from pathlib import Path

import click

from microbot_ros.cli.options import namespace_option
from microbot_ros.common import strict_yaml
from microbot_ros.common.errors import InputError


@click.command(context_settings={'ignore_unknown_options': True})  # a number may be negative
@click.argument('node')
@click.argument('parameter')
@click.argument('value')
@namespace_option
def command(node: str, parameter: str, value: str, namespace: str) -> None:
    """Change PARAMETER of the running NODE to VALUE; the node may refuse, with the reason.

    A path is relative to the present directory, wherever the node runs on this machine.

    Ends with 2 if the value is refused, with 1 if the node is missing or does not answer.

    \b
    Example, switching the controller while running:
      microbot set controller controller waypoint
    """
    from microbot_ros.nodes.client.graph_client import GraphClient

    if not parameter:
        raise InputError('', 'expected the name of a parameter; received nothing')
    with GraphClient(namespace=namespace) as client:
        if parameter.endswith('_file') and value:
            value = str(Path(value).resolve())
        client.set(node, **{parameter: _typed(value)})
    click.echo(f'{node}: {parameter} is now {value}')


def _typed(text: str) -> bool | int | float | str | list[object]:
    """Return the value of a text in YAML, or the text if no node accepts such a value."""
    try:
        value = strict_yaml.load(text)[1]
    except strict_yaml.YamlError:
        return text
    return value if isinstance(value, bool | int | float | str | list) else text
