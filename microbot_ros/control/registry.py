"""Discovery of controllers: entry points `microbot_ros.controllers` of any package."""

from __future__ import annotations

import functools
import logging
from importlib.metadata import EntryPoint, entry_points

from microbot_ros.common.errors import clipped
from microbot_ros.control.contract import INTERFACE_VERSION, Controller

GROUP = 'microbot_ros.controllers'

_log = logging.getLogger(__name__)


class PluginError(Exception):
    """A controller requested by name is not available; the message says why."""


@functools.cache
def _installed() -> dict[str, EntryPoint]:
    """Return the entry points by name, cached because it reads all package metadata."""
    return {point.name: point for point in entry_points(group=GROUP)}


def controller_class(name: str) -> type[Controller]:
    """Return the class of the controller `name`; PluginError if it is missing or unusable.

    Parameters
    ----------
    name : str
        Name of the controller.

    Returns
    -------
    type[Controller]
        The class.
    """
    if name not in _installed():
        known = ', '.join(sorted(_installed())) or 'none'
        raise PluginError(f"no controller '{clipped(name)}' is installed; there are: {known}")
    return _load(_installed()[name])


def controller_classes(required: str | None = None) -> dict[str, type[Controller]]:
    """Return every installed and working controller by name, in alphabetical order.

    One that cannot be loaded is logged and omitted, unless it is `required`: then PluginError.

    Parameters
    ----------
    required : str or None
        Name of a controller that must work; None for none.

    Returns
    -------
    dict[str, type[Controller]]
        Class by name.
    """
    classes = {} if required is None else {required: controller_class(required)}
    for name, point in _installed().items():
        if name not in classes:
            try:
                classes[name] = _load(point)
            except PluginError as error:
                _log.warning('left out: %s', error)
    return dict(sorted(classes.items()))


def _load(point: EntryPoint) -> type[Controller]:
    try:
        found = point.load()
    except Exception as error:
        reason = f'{type(error).__name__}: {error}'
        raise PluginError(f"controller '{point.name}' ({point.value}): {reason}") from error
    if not (isinstance(found, type) and issubclass(found, Controller)):
        raise PluginError(f"controller '{point.name}': {point.value} is no Controller class")
    version = getattr(found, 'interface_version', None)
    if version != INTERFACE_VERSION:
        raise PluginError(f"controller '{point.name}': written for interface version {version}; "
                          f'expected {INTERFACE_VERSION}')
    return found
