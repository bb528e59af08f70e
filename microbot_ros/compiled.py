"""`numba`, with a cache on disk that bears many processes that compile at once.

The nodes of a rig start together, and before the first time nothing is compiled. Numba 0.68 keeps
for each function an index of signatures and a numbered file of machine code for each of them, and
between reading the index and writing both another process may do the same for another signature:
then the index leads to code for other types. Called with it a complex array is read as a real one
and a time as a whole number, silently; and as the signature asked for is never found, every call
loads the file again, until memory is out (numba/numba#10128 is of the same kind). So here one
process at a time looks into a cache, and what older sources left there goes first.
"""

from __future__ import annotations

import fcntl
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numba
from numba.core import caching, event

from microbot_ros.first_compilation import about_to_compile

__all__ = ['numba']


class _OneAtATime(caching.IndexDataCacheFile):
    """The files of one function, locked as long as they are read or written."""

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
        except OSError:  # no such folder, or one that only others may write to
            return super().load(key)

    @contextmanager
    def _locked(self, how: int) -> Iterator[None]:
        with Path(self._cache_path, 'numba.lock').open('a') as lock:
            fcntl.flock(lock, how)
            yield


class _Announced(event.Listener):
    """Tells before code is compiled; code that was kept is none."""

    def on_start(self, event: Any) -> None:
        about_to_compile()

    def on_end(self, event: Any) -> None:
        pass


event.register('numba:compile', _Announced())
caching.IndexDataCacheFile = _OneAtATime  # type: ignore[misc]
