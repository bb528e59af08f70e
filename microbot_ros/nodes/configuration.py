"""ROS parameter file of a rig, checked before anything starts."""

from __future__ import annotations

import importlib
import re
from pathlib import Path
from typing import Any

from microbot_ros.common import errors, settings
from microbot_ros.common.checked import Field, Settings
from microbot_ros.common.errors import InputError, clipped
from microbot_ros.common.files import line_of, load_yaml, read_yaml
from microbot_ros.control.registry import PluginError, controller_class
from microbot_ros.drive.amplifier import amplifier_class
from microbot_ros.nodes.base.lifecycle import RigNode
from microbot_ros.nodes.base.names import NODES

EVERY_NODE = ('use_sim_time',)


class _Section(Settings):
    ros__parameters: dict[str, Any] = Field(default_factory=dict)


def read_rig(path: str | Path, namespace: str = '') -> dict[str, dict[str, Any]]:
    """Return the parameters of each node from a ROS parameter file.

    Parameters
    ----------
    path : str or Path
        File.
    namespace : str
        Only sections that ROS gives to nodes in this namespace ('/' for the root); '' for those of
        a file about one rig.

    Returns
    -------
    dict[str, dict of str to object]
        Parameters by node and full name.

    Raises
    ------
    InputError
        With file and line, for an unknown node, an unknown parameter, a value of the wrong type or
        out of range; and if no section is for nodes of the namespace, which ROS would leave at
        their defaults.
    """
    sections = read_yaml(path, dict[str, _Section])
    rig: dict[str, dict[str, Any]] = {}
    elsewhere = ''
    for key, section in sections.items():
        place, _, node = key.rpartition('/')
        if node not in NODES:
            raise InputError(path, f"unknown node '{clipped(key)}'; known are: "
                                   f"{', '.join(NODES)}", line_of(path, key))
        found: dict[str, Any] = {}
        for keys, value in _flatten(section.ros__parameters):
            line = line_of(path, key, 'ros__parameters', *keys)
            name = '.'.join(keys)
            found[name] = _checked(path, node, name, value, line)
        if not namespace or _is_in(place, namespace):
            rig[node] = rig.get(node, {}) | found
        else:
            elsewhere = elsewhere or key
    if elsewhere and not rig:
        raise InputError(path, f"'{clipped(elsewhere)}' is not a node of the namespace "
                               f"{namespace}; '/**/{elsewhere.rpartition('/')[2]}' would fit",
                         line_of(path, elsewhere))
    _refuse_missing_packages(path, rig, namespace)
    _refuse_contradictions(path, rig, namespace)
    return rig


def refused(path: str | Path, rig: dict[str, dict[str, Any]], namespace: str, node: str,
            problem: str) -> InputError:
    """Return the error for a node that could not start, with the line of its cause in the file.

    The line is that of the parameter that the problem names, or whose text it contains.

    Parameters
    ----------
    path : str or Path
        File.
    rig : dict[str, dict of str to object]
        Parameters by node and name.
    namespace : str
        Namespace of the rig; '/' for the root.
    node : str
        The node.
    problem : str
        Why the node could not start, in its own words.

    Returns
    -------
    InputError
        Error with file, line and node.
    """
    given = rig.get(node, {})
    texts = {name: value for name, value in given.items() if isinstance(value, str) and value}
    name = next((name for name in given if _speaks_of(problem, name)), '') or next(
        (name for name, text in texts.items() if _speaks_of(problem, text)), '')
    if name in texts:
        problem = problem.replace(texts[name], clipped(texts[name]))
    if name and not problem.startswith(name):
        problem = f'{name}: {problem}'
    line = _line_of(path, node, name, namespace) if node in rig else None
    return InputError(path, f'{node}: {problem}', line)


def _speaks_of(problem: str, word: str) -> bool:
    return re.search(rf'(?<!\w){re.escape(word)}(?!\w)', problem) is not None


def refuse_elsewhere(path: str | Path, node: str, namespace: str) -> None:
    """Refuse a parameter file with sections for a node, but none for it in this namespace.

    Parameters
    ----------
    path : str or Path
        File.
    node : str
        Name of the node.
    namespace : str
        Namespace of the rig; '/' for the root.

    Raises
    ------
    InputError
        If ROS would leave the node, and its limits, silently at their defaults.
    """
    content = load_yaml(path)[1]
    keys = [str(key) for key in content] if isinstance(content, dict) else []
    named = [key for key in keys if key.rpartition('/')[2] == node]
    if named and not any(_is_in(key.rpartition('/')[0], namespace) for key in named):
        raise InputError(path, f"'{named[0]}' is not a node of the "
                               f"namespace {namespace}; '/**/{node}' would "
                               'fit', line_of(path, named[0]))


def _is_in(place: str, namespace: str) -> bool:
    """Return whether the `place` of a section means nodes in a namespace.

    The place is the part before the node's name: '*' stands for one name, '**' for any number of
    names.
    """
    wanted = [part for part in place.split('/') if part]
    return _matches(wanted, [part for part in namespace.split('/') if part])


def _matches(wanted: list[str], names: list[str]) -> bool:
    if not wanted:
        return not names
    first, *rest = wanted
    if first == '**':
        return any(_matches(rest, names[k:]) for k in range(len(names) + 1))
    return bool(names) and first in ('*', names[0]) and _matches(rest, names[1:])


def node_class(name: str) -> type[RigNode]:
    """Return the class of a node.

    Parameters
    ----------
    name : str
        Name of the node.

    Returns
    -------
    type[RigNode]
        Its class.
    """
    found: type[RigNode] = getattr(
        importlib.import_module(f'microbot_ros.nodes.{name}'), NODES[name])
    return found


def _refuse_missing_packages(path: str | Path, rig: dict[str, dict[str, Any]], namespace: str,
                             ) -> None:
    """Raise InputError for a controller or an amplifier that is not installed."""
    for node, name, find in (('coil_driver', 'amplifier', amplifier_class),
                             ('controller', 'controller', controller_class)):
        try:
            if node in rig:
                find(_value(rig, node, name))
        except (InputError, PluginError) as error:
            line = _line_of(path, node, name, namespace)
            raise InputError(path, f'{node}: {error}', line) from None


def _refuse_contradictions(path: str | Path, rig: dict[str, dict[str, Any]], namespace: str,
                           ) -> None:
    """Raise InputError for parameters of different nodes that contradict each other.

    The controller may request no more than the coil driver's full field, and no node may wait for
    a field that the amplifier does not measure.
    """
    if 'coil_driver' not in rig:
        return
    if 'controller' in rig:
        asked = _value(rig, 'controller', 'max_field_mT')
        allowed = _value(rig, 'coil_driver', 'full_field_mT')
        if not asked <= allowed:
            raise InputError(path, f'controller: max_field_mT is {asked:g}, expected at most '
                             f'{allowed:g}, the full_field_mT of the coil_driver',
                             _line_of(path, 'controller', 'max_field_mT', namespace))
    amplifier = _value(rig, 'coil_driver', 'amplifier')
    for node in ('tracker', 'model'):
        if (node in rig and _value(rig, node, 'field_source') == 'applied'
                and not amplifier_class(amplifier).reads_back):
            raise InputError(path, f'{node}: field_source is applied, expected command: '
                                   f'{amplifier} measures no currents',
                             _line_of(path, node, 'field_source', namespace))


def _value(rig: dict[str, dict[str, Any]], node: str, name: str) -> Any:
    """Return the value of a parameter, or its default."""
    return rig[node].get(name, settings.defaults(node_class(node).Parameters)[name])


def _line_of(path: str | Path, node: str, name: str, namespace: str) -> int | None:
    """Where a file gives a node of a namespace a parameter, or else where it gives it any."""
    sections = [(key, section.ros__parameters)
                for key, section in read_yaml(path, dict[str, _Section]).items()
                if key.rpartition('/')[2] == node
                and (not namespace or _is_in(key.rpartition('/')[0], namespace))]
    for key, parameters in sections:
        for keys, _ in _flatten(parameters):
            if '.'.join(keys) == name:
                return line_of(path, key, 'ros__parameters', *keys)
    return line_of(path, sections[0][0], 'ros__parameters')


def _flatten(tree: dict[str, Any]) -> list[tuple[tuple[str, ...], Any]]:
    flat: list[tuple[tuple[str, ...], Any]] = []
    for key, value in tree.items():
        if isinstance(value, dict):
            flat += [((key, *rest), inner) for rest, inner in _flatten(value)]
        else:
            flat.append(((key,), value))
    return flat


def _checked(path: str | Path, node: str, name: str, value: Any, line: int | None) -> Any:
    """Return the value of a parameter in its type."""
    if name in EVERY_NODE:
        return value
    known = node_class(node).known_parameters()
    if name not in known:
        raise InputError(path, f"unknown parameter '{clipped(name)}' of {node}; "
                               f'{errors.known(known, name)}', line)
    try:
        return settings.convert(*known[name], value)
    except ValueError as error:
        raise InputError(path, f'{node}: {error}', line) from None
