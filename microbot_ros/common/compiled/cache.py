"""Disk cache of numba that is safe when many processes compile at once.

The nodes of a rig start together, and on first use nothing is compiled. Numba 0.68 keeps for each
function an index of signatures and a numbered file of machine code per signature. Between reading
the index and writing both, another process may do the same for another signature; the index then
points to code for other types. Called through it, a complex array is read as a real one and a time
as an integer, silently; and as the wanted signature is never found, every call loads the file
again until memory runs out (numba/numba#10128 is similar). Here one process at a time accesses a
cache, and files of older sources are removed first. Only `compiled.load` imports this module.

If `NUMBA_CACHE_DIR` is set, the code of this package is cached there by the content of its
sources: a file and all package files that it imports. Numba itself uses the path and the time of
one file: it recompiles in every clone, and misses changes of imported functions or constants that
were compiled in.
"""

from __future__ import annotations

import fcntl
import hashlib
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import numba
from numba.core import caching, config, event
from numba.core.compiler_lock import global_compiler_lock

__all__ = ['digest', 'global_compiler_lock', 'install', 'numba']


class _OneAtATime(caching.IndexDataCacheFile):
    """Cache files of one function, locked while they are read or written."""

    def save(self, key: Any, data: Any) -> None:
        with self._locked(fcntl.LOCK_EX):
            if not self._load_index():
                for old in Path(self._cache_path).glob(
                        self._data_name_pattern.replace('{number:d}', '*')):
                    old.unlink()
            super().save(key, data)

    def load(self, key: Any) -> Any:
        try:
            with self._locked(fcntl.LOCK_SH):
                return super().load(key)
        except OSError:  # the folder is missing or read-only
            return super().load(key)

    @contextmanager
    def _locked(self, how: int) -> Iterator[None]:
        with Path(self._cache_path, 'numba.lock').open('a') as lock:
            fcntl.flock(lock, how)
            yield


_PACKAGE = Path(__file__).parents[2]  # the package's own folder
_IMPORTED = re.compile(
    rb'^\s*(?:from|import) microbot_ros(\.[\w.]+)?(?: import (\([^)]*|.*))?', re.MULTILINE)


@cache
def _imported(file: Path) -> frozenset[Path]:
    """Return the package files that a `file` imports directly."""
    found = set()
    for module, names in _IMPORTED.findall(file.read_bytes()):
        place = _PACKAGE.joinpath(*module.decode().split('.')[1:])
        inside = (place / f'{name}.py' for name in re.findall(r'\w+', names.decode()))
        found |= {path for path in (place.with_suffix('.py'), place / '__init__.py', *inside)
                  if path.is_file()}
    return frozenset(found)


@cache
def digest(file: Path) -> str:
    """Return the digest of a package `file` and of all package files that it imports.

    Parameters
    ----------
    file : Path
        The file.

    Returns
    -------
    str
        Hexadecimal digest.
    """
    found, new = {file}, {file}
    while new:
        new = {path for one in new for path in _imported(one)} - found
        found |= new
    made = hashlib.sha256()
    for path in sorted(found):
        made.update(b'%s\0%s\0' % (str(path.relative_to(_PACKAGE)).encode(), path.read_bytes()))
    return made.hexdigest()[:16]


# Older releases of numba mark its name as private.
_Provided: Any = next(kind for name, kind in vars(caching).items()
                      if name.lstrip('_') == 'UserProvidedCacheLocator')


class _ByContent(_Provided):
    """Location in `NUMBA_CACHE_DIR` for the code of a package file, by its `digest`."""

    def __init__(self, py_func: Any, py_file: str) -> None:
        super().__init__(py_func, py_file)
        self._digest = digest(Path(py_file))
        folder = Path(config.CACHE_DIR)  # type: ignore[attr-defined]
        self._cache_path = str(folder / f'{Path(py_file).stem}-{self._digest}')

    def get_source_stamp(self) -> str:
        return self._digest

    @classmethod
    def from_function(cls, py_func: Any, py_file: str) -> Any:
        ours = _PACKAGE in Path(py_file).parents
        return super().from_function(py_func, py_file) if ours else None


class _Announced(event.Listener):
    """Listener that calls `tell` before code is compiled; loading cached code does not count."""

    def __init__(self, tell: Callable[[], None]) -> None:
        self._tell = tell

    def on_start(self, event: Any) -> None:
        self._tell()

    def on_end(self, event: Any) -> None:
        pass


def install(tell: Callable[[], None]) -> None:
    """Let numba use this cache, and call `tell` before anything is compiled.

    Parameters
    ----------
    tell : callable
        Function that is called.
    """
    event.register('numba:compile', _Announced(tell))
    caching.IndexDataCacheFile = _OneAtATime  # type: ignore[misc]
    caching.CacheImpl._locator_classes.insert(0, _ByContent)
