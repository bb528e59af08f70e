"""Notice when code is compiled, because the first compilation takes silent minutes."""

from __future__ import annotations

import os
from collections.abc import Callable

COMPILES = 'compiling code for the first time; this can take minutes and is kept'

_who_tells: list[tuple[int, Callable[[str], None]]] = []


def tell_of_compiling(tell: Callable[[str], None]) -> None:
    """Call `tell` with a sentence once this process compiles code that is not cached.

    Parameters
    ----------
    tell : callable
        Function that is called with the sentence.
    """
    _who_tells[:] = [(os.getpid(), tell)]


def about_to_compile() -> None:
    """Report the compilation; called by `compiled` before anything is compiled."""
    while _who_tells:
        process, tell = _who_tells.pop()
        if process == os.getpid():  # forked workers leave the report to their parent
            tell(COMPILES)
