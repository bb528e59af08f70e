"""The ROS parameter file of a rig, checked before anything starts."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import pydantic

from microbot_ros import settings
from microbot_ros.errors import InputError
from microbot_ros.files import Settings, line_of, read_yaml
from microbot_ros.nodes.lifecycle import RigNode
from microbot_ros.nodes.process import NODES

EVERY_NODE = ('use_sim_time',)


class _Section(Settings):
    ros__parameters: dict[str, Any] = pydantic.Field(default_factory=dict)


class _File(pydantic.RootModel[dict[str, _Section]]):
    pass


def read_rig(path: str | Path) -> dict[str, dict[str, Any]]:
    """Node → its parameters by full names, from the ROS parameter file `path`.

    Former names become those of today. Raises InputError naming file and line for an unknown node,
    an unknown parameter, a value of the wrong type or out of range.
    """
    sections = read_yaml(path, _File).root
    rig: dict[str, dict[str, Any]] = {}
    for node, section in sections.items():
        if node not in NODES:
            raise InputError(path, f"unknown node '{node}'; known are: {', '.join(NODES)}",
                             line_of(path, node))
        rig[node] = {}
        for keys, value in _flatten(section.ros__parameters):
            line = line_of(path, node, 'ros__parameters', *keys)
            rig[node] |= _checked(path, node, '.'.join(keys), value, line)
    _refuse_contradictions(path, rig)
    return rig


def node_class(name: str) -> type[RigNode]:
    """The class of a node by its name."""
    found: type[RigNode] = getattr(
        importlib.import_module(f'microbot_ros.nodes.{name}'), NODES[name])
    return found


def _refuse_contradictions(path: str | Path, rig: dict[str, dict[str, Any]]) -> None:
    """InputError where the controller may ask for more than the coil driver was told it will."""
    if not {'controller', 'coil_driver'} <= rig.keys():
        return
    asked, allowed = (
        rig[node].get(name, settings.defaults(node_class(node).Parameters)[name])
        for node, name in (('controller', 'max_field_mT'), ('coil_driver', 'full_field_mT')))
    if not asked <= allowed:
        raise InputError(path, f'controller: max_field_mT is {asked:g}, expected at most '
                         f'{allowed:g}, the full_field_mT of the coil_driver',
                         line_of(path, 'controller', 'ros__parameters', 'max_field_mT'))


def _flatten(tree: dict[str, Any]) -> list[tuple[tuple[str, ...], Any]]:
    flat: list[tuple[tuple[str, ...], Any]] = []
    for key, value in tree.items():
        if isinstance(value, dict):
            flat += [((key, *rest), inner) for rest, inner in _flatten(value)]
        else:
            flat.append(((key,), value))
    return flat


def _checked(path: str | Path, node: str, name: str, value: Any, line: int | None,
             ) -> dict[str, Any]:
    """The parameters that a name stands for, a former one perhaps for several, and their value."""
    known = node_class(node).known_parameters()
    if name in EVERY_NODE:
        return {name: value}
    present = {full: described for full, described in known.items() if name in (
        full, full.removesuffix(described[1]) + settings.about(*described).formerly)}
    if not present:
        names = ', '.join(sorted(known))
        raise InputError(path, f"unknown parameter '{name}' of {node}; known are: {names}", line)
    try:
        return {full: settings.convert(kind, field, value)
                for full, (kind, field) in present.items()}
    except ValueError as error:
        raise InputError(path, f'{node}: {error}', line) from None
