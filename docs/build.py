"""Writes the parts of the documentation that are made from the code: `python docs/build.py`."""

from __future__ import annotations

import inspect
from pathlib import Path

from microbot_ros import settings, units
from microbot_ros.control.registry import controller_classes
from microbot_ros.model.effects import BUILT_IN
from microbot_ros.nodes.configuration import node_class
from microbot_ros.nodes.process import NODES

DOCS = Path(__file__).parent

_TABLE = '| effect | term | parameters | shows under | looks like |\n'


def parameters() -> str:
    """`parameters.md`: every node's and controller's parameters, from their dataclasses."""
    parts = ['# Parameters\n\nMade from the code by `python docs/build.py`. Set them in a ROS '
             'parameter file (`config/rig.yaml`), with `microbot set NODE PARAMETER VALUE` or '
             '`ros2 param set`. Those marked *fixed* are read once, at start-up.\n']
    for node in NODES:
        parts.append(f'## `{node}`\n\n' + _table(node_class(node).Parameters, ''))
    for name, kind in controller_classes(required='hold').items():
        if settings.defaults(kind.Parameters):
            parts.append(f'## `controller`: `{name}`\n\n{kind.summary}\n\n'
                         + _table(kind.Parameters, f'{name}.'))
    return '\n'.join(parts)


def _table(kind: type, prefix: str) -> str:
    rows = ['| parameter | default | unit | range | meaning |', '|---|---|---|---|---|']
    for name, default in settings.defaults(kind).items():
        about = settings.about(kind, name)
        limits = ' … '.join('' if v is None else f'{v:g}' for v in (about.lower, about.upper))
        allowed = ', '.join(about.choices) or ('' if limits == ' … ' else limits)
        meaning = about.description + (' *Fixed.*' if about.read_only else '')
        meaning += f' Formerly `{prefix}{about.formerly}`.' if about.formerly else ''
        rows.append(f'| `{prefix}{name}` | `{default!r}` | {units.symbol(name)} | {allowed} '
                    f'| {meaning} |')
    return '\n'.join(rows) + '\n'


def effects() -> str:
    """`effects.md`, whose last part is a table of the built-in effects, from their classes."""
    written = (DOCS / 'effects.md').read_text(encoding='utf-8').split(_TABLE)[0]
    rows = [_TABLE + '|---|---|---|---|---|']
    for kind in BUILT_IN:
        term = ' '.join((inspect.getdoc(kind) or '').split('\n\n')[0].split())
        names = ', '.join(f'`{p.name}`' for p in kind.parameters())
        alike = ', '.join(f'`{other}`' for other in kind.confounded_with)
        cells = (kind.id.join('``'), term, names, kind.required_excitation, alike)
        rows.append('| ' + ' | '.join(cell.replace('|', r'\|') for cell in cells) + ' |')
    return written + '\n'.join(rows) + '\n'


if __name__ == '__main__':
    (DOCS / 'effects.md').write_text(effects(), encoding='utf-8')
    (DOCS / 'parameters.md').write_text(parameters(), encoding='utf-8')
