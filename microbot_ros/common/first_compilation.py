"""Saying so when code is compiled: the first time that takes minutes, in silence."""

from __future__ import annotations

import os
from collections.abc import Callable

COMPILES = 'the first time code is compiled, which can take minutes; it is kept'

_who_tells: list[tuple[int, Callable[[str], None]]] = []


def tell_of_compiling(tell: Callable[[str], None]) -> None:
    """Call `tell` with a sentence once this process compiles code that is not kept yet."""
    _who_tells[:] = [(os.getpid(), tell)]


def about_to_compile() -> None:
    """What `compiled` calls before anything is compiled."""
    while _who_tells:
        process, tell = _who_tells.pop()
        if process == os.getpid():  # workers that were forked leave it to the one who asked
            tell(COMPILES)
