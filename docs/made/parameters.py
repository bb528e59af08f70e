"""Every node's and controller's parameters, from their dataclasses."""

from __future__ import annotations

from collections.abc import Iterator

from made.text import MADE, code, table
from microbot_ros.common import settings, units
from microbot_ros.control.registry import controller_classes
from microbot_ros.nodes.base.names import NODES
from microbot_ros.nodes.configuration import node_class

_HEAD = ('parameter', 'default', 'unit', 'range', 'meaning')


def page() -> str:
    """`parameters.md`."""
    parts = [f'# Parameters\n\n{MADE} Set them in a ROS parameter file (`config/rig.yaml`), with '
             '`microbot set NODE PARAMETER VALUE` or `ros2 param set`. Parameters marked *fixed* '
             'are read once, at start-up.\n']
    for node in NODES:
        parts.append(f'## `{node}`\n\n' + table(_HEAD, _rows(node_class(node).Parameters, '')))
    for name, kind in controller_classes(required='hold').items():
        if settings.defaults(kind.Parameters):
            parts.append(f'## `controller`: `{name}`\n\n{kind.summary}\n\n'
                         + table(_HEAD, _rows(kind.Parameters, f'{name}.')))
    return '\n'.join(parts)


def _rows(kind: type, prefix: str) -> Iterator[list[str]]:
    for name, default in settings.defaults(kind).items():
        about = settings.about(kind, name)
        limits = ' … '.join('' if v is None else f'{v:g}' for v in (about.lower, about.upper))
        allowed = ', '.join(about.choices) or ('' if limits == ' … ' else limits)
        meaning = about.description + (' *Fixed.*' if about.read_only else '')
        yield [code(prefix + name), code(repr(default)), units.symbol(name), allowed, meaning]
