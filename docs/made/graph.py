"""Topics and services, from where the nodes make them."""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import yaml

from made.text import MADE, code, table
from microbot_ros import nodes
from microbot_ros.nodes.base.names import NODES
from microbot_ros.nodes.base.topics import CHANGES, TOPICS

_NODES = Path(nodes.__file__).parent
CONTENT = Path(__file__).with_name('graph.yaml')
"""Topic or service → what is in it, for people."""

_SHARED = {'lifecycle': NODES, 'log': ('tracker', 'model', 'controller'), 'replay': (),
           'frames': ('tracker',), 'felt_rotation': ('tracker', 'model'),
           'preview': ('camera', 'virtual_rig'), 'operated_rig': ('cockpit',),
           'rig_view': ('cockpit',), 'graph_client': (),
           'driven_rig': ('microbot discover --drive',),
           'verdict_publisher': ('microbot discover --live',)}
"""Module that makes a topic for others → for whom; of commands only those that stay."""

_CALLS = {'publisher': 'out', 'create_publisher': 'out', 'subscribe': 'in', 'service': 'service',
          'service_aside': 'service'}


class End(NamedTuple):
    """One end of a topic, `what` 'in' or 'out', or a 'service': its `name`, type and node."""

    what: str
    name: str
    kind: str
    node: str


def ends() -> Iterator[End]:
    """All that the nodes publish, take and offer, as the code says it."""
    for path in sorted(_NODES.rglob('*.py')):
        tree = ast.parse(path.read_text(encoding='utf-8'))
        types = _message_types(tree)
        for call in (found for found in ast.walk(tree) if isinstance(found, ast.Call)):
            if isinstance(call.func, ast.Attribute) and call.func.attr in _CALLS and (
                    len(call.args) > 1 and isinstance(call.args[1], ast.Constant)):
                kind, name = ast.unparse(call.args[0]), str(call.args[1].value)
                for node in _makers(path.stem):
                    yield End(_CALLS[call.func.attr], name.replace('~', node),
                              types.get(kind, kind), node)


def _makers(module: str) -> tuple[str, ...]:
    """Whose topics a module makes; LookupError for one of which nothing is said here."""
    if module not in NODES and module not in _SHARED:
        raise LookupError(f'{module} makes topics; expected it in _SHARED: for whom?')
    return _SHARED.get(module, (module,))


def _message_types(tree: ast.Module) -> dict[str, str]:
    """Class → package/Class, of the messages and services that a module imports."""
    return {alias.name: f'{found.module.partition(".")[0]}/{alias.name}'
            for found in ast.walk(tree) if isinstance(found, ast.ImportFrom) and found.module
            for alias in found.names if found.module.endswith(('.msg', '.srv'))}


def page() -> str:
    """`graph.md`."""
    content = yaml.safe_load(CONTENT.read_text(encoding='utf-8'))
    made = list(ends())
    topics, services = [], []
    for name in sorted({end.name for end in made}):
        by: dict[str, list[str]] = defaultdict(list)
        for end in made:
            if end.name == name:
                by[end.what].append(end.node)
        kind = next(end.kind for end in made if end.name == name)
        if 'service' in by:
            services.append([f'{code(name)} {kind}', content[name]])
        else:
            way = f'{_nodes(by["out"])} → {_nodes(by["in"])}'.strip()
            topics.append([f'{code(name)} {kind}', way, content[name]])
    return (f'# Topics and services\n\n{MADE} Names are relative, so that a rig may have a '
            'namespace. All numbers are in SI units; units and frames of each topic are in the '
            '[glossary](glossary.md). A stamp is the time at which the exposure of the frame '
            'began. Everything that is computed from the frame carries it. Every node is a '
            'lifecycle node, with its services. `recorder` records all topics but '
            f'{_not_recorded(made)} and, by default, `overlay/image_raw`. It also records '
            f'{code(CHANGES)}. `player` plays what was recorded, and `cockpit` subscribes also '
            'to the topics that an open page shows.\n\n## Topics\n\n'
            + table(('topic, type', 'from → to', 'content'), topics)
            + '\n## Services\n\n' + table(('service, type', 'does'), services))


def _not_recorded(made: list[End]) -> str:
    return ', '.join(map(code, sorted(
        {end.name for end in made if end.what != 'service'} - TOPICS.keys())))


def _nodes(names: list[str]) -> str:
    found = list(dict.fromkeys(names))
    return 'all' if found == list(NODES) else ', '.join(map(code, found))
