"""Objects that other packages provide by entry points."""

from __future__ import annotations

from importlib.metadata import entry_points
from typing import Any

from microbot_ros.common.errors import InputError, clipped
from microbot_ros.common.extras import advice


def installed(group: str, what: str, name: str) -> Any:
    """Load the object `name` of the entry-point `group`; `what` names its kind in messages.

    Raises InputError if the name is not registered or its object cannot be loaded; nothing else is
    tried.

    Parameters
    ----------
    group : str
        Name of the group.
    what : str
        Kind of the object, for messages.
    name : str
        Name of the object.

    Returns
    -------
    object
        The object.
    """
    found = {entry.name: entry for entry in entry_points(group=group)}
    if name not in found:
        known = ', '.join(sorted(found)) or f'those that a package brings in {group}'
        raise InputError(what, f"expected one of {known}; received '{clipped(name)}'")
    try:
        return found[name].load()
    except Exception as error:
        missing = advice(error) if isinstance(error, ImportError) else None
        reason = missing or ' '.join(f'{type(error).__name__}: {error}'.split())
        raise InputError(what, f"'{name}' does not load; {reason}") from None
