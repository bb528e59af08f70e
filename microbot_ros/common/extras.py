"""Optional libraries, the extra that installs each, and what other packages bring."""

from __future__ import annotations

from importlib.metadata import entry_points
from importlib.util import find_spec
from typing import Any

from microbot_ros.common.errors import InputError, clipped

EXTRAS = {
    'av': 'video',
    'lz4': 'mcap', 'mcap': 'mcap', 'rosbags': 'mcap', 'zstandard': 'mcap',
    'pymodbus': 'modbus',
    'osqp': 'predictive',
    'jinja2': 'analysis', 'matplotlib': 'analysis', 'openpyxl': 'analysis', 'rich': 'analysis',
    'starlette': 'cockpit', 'uvicorn': 'cockpit', 'websockets': 'cockpit',
    'gymnasium': 'gym', 'onnx': 'onnx', 'onnxruntime': 'onnx',
    'dask': 'dask', 'distributed': 'dask', 'pyarrow': 'dask',
}
"""Import name of a library → extra that installs it."""


def advice(error: ImportError) -> str | None:
    """Return what to install after an import `error`; None if no extra brings the library.

    Parameters
    ----------
    error : ImportError
        The error.

    Returns
    -------
    str or None
        The sentence, or None.
    """
    library = (error.name or '').partition('.')[0]
    if library not in EXTRAS:
        return None
    return (f"the library '{library}' is not installed; "
            f"pip install 'microbot_ros[{EXTRAS[library]}]'")


def lack(*extras: str) -> str:
    """Return which libraries of `extras` are missing and how to install them; '' if none.

    Parameters
    ----------
    *extras : str
        Names of extras.

    Returns
    -------
    str
        The sentence, or ''.
    """
    missing = [library for library, extra in EXTRAS.items()
               if extra in extras and find_spec(library) is None]
    needed = ','.join(dict.fromkeys(EXTRAS[library] for library in missing))
    if not missing:
        return ''
    return f"not installed: {', '.join(missing)}; pip install 'microbot_ros[{needed}]'"


def require(*extras: str) -> None:
    """Raise InputError with installation advice if a library of these `extras` is missing.

    For commands that would otherwise fail only after minutes of work.

    Parameters
    ----------
    *extras : str
        Names of extras.
    """
    if problem := lack(*extras):
        raise InputError('', problem)


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
