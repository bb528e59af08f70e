"""`numba.njit` that imports numba when the first compiled function is called.

Importing numba takes 0.22 s of processor time and its compiler 0.20 s more (numba 0.68, by `python
-X importtime`). A process that calls no compiled function needs neither. Nodes call `load` while
they are configured, so that no frame waits for it.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Callable
from threading import RLock
from types import FunctionType, SimpleNamespace
from typing import Any

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


def _about_to_compile() -> None:
    while _who_tells:
        process, tell = _who_tells.pop()
        if process == os.getpid():  # forked workers leave the report to their parent
            tell(COMPILES)


class _Compiled:
    """Stand-in for a function until numba is loaded, with the attributes of numba's dispatcher."""

    def __init__(self, function: FunctionType, declared: list[str],
                 options: dict[str, Any]) -> None:
        functools.update_wrapper(self, function)
        self.function, self.declared, self.options = function, declared, options
        self.dispatcher: Any = None

    def __call__(self, *arguments: Any) -> Any:
        if self.dispatcher is None:
            load()
        return self.dispatcher(*arguments)

    def __getattr__(self, name: str) -> Any:
        if name.startswith('__'):
            raise AttributeError(name)
        load()
        return getattr(self.dispatcher, name)


_lock = RLock()
_new: list[_Compiled] = []
_loaded = False


def _njit(signatures: list[str] | str = '', **options: Any) -> Callable[[FunctionType], Any]:
    """Return the decorator `numba.njit` with these signatures and options.

    It compiles for the types of the signatures when numba is loaded, or without any for each type
    that the function is called with.
    """
    declared = [signatures] if isinstance(signatures, str) else signatures

    def decorate(function: FunctionType) -> Any:
        made = _Compiled(function, [one for one in declared if one], options)
        with _lock:
            _new.append(made)
            if _loaded:
                load()
        return made.dispatcher or made
    return decorate


numba: Any = SimpleNamespace(njit=_njit)
"""What stands for the module in files with compiled functions, until it is loaded."""


def load() -> None:
    """Load numba for the compiled functions that were imported, if there are any.

    Compiled code finds other functions among the globals of its file: the stand-ins there are
    replaced. Declared signatures are compiled last, as they need that.
    """
    global _loaded
    with _lock:
        if not _new:
            return
        from microbot_ros.common.compiled import cache

        if not _loaded:
            cache.install(_about_to_compile)
            _loaded = True
        made, _new[:] = _new[:], []
        module = cache.numba
        with cache.global_compiler_lock:  # no thread compiles before all are replaced
            for one in made:
                one.dispatcher = module.njit(**one.options)(one.function)
            for names in {id(one.function.__globals__): one.function.__globals__
                          for one in made}.values():
                for name, value in list(names.items()):
                    if value is numba:
                        names[name] = module
                    elif isinstance(value, _Compiled):
                        names[name] = value.dispatcher
        for one in made:
            for signature in one.declared:
                one.dispatcher.compile(signature)
            if one.declared:
                one.dispatcher.disable_compile()
