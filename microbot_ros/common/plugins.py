"""What other packages bring under an entry point."""

from __future__ import annotations

from importlib.metadata import entry_points
from typing import Any

from microbot_ros.common.errors import InputError, clipped
from microbot_ros.common.extras import advice


def installed(group: str, what: str, name: str) -> Any:
    """What is registered as `name` in the entry-point `group`; people call it `what`.

    Raises InputError for a name that is not registered or whose object does not load: there is no
    falling back to another.
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
