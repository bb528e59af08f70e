"""The errors that a person is meant to read."""

from __future__ import annotations

from pathlib import Path


class InputError(ValueError):
    """Something a person supplied is wrong: a file, an option, a device name.

    The message is one line: where, what was found, what was expected. Commands print it on
    standard error and exit with 2.
    """

    def __init__(self, source: str | Path, expected: str, line: int | None = None) -> None:
        self.source = str(source)
        self.expected = expected
        self.line = line
        place = self.source if line is None else f'{self.source}:{line}'
        super().__init__(f'{place}: {expected}' if place else expected)


class PackageError(InputError):
    """An installed package is not as expected, whatever file was being read."""


class RigError(RuntimeError):
    """A running rig did not do what it was asked: a node is missing, is silent or refuses.

    The message is one line that names the node. Commands print it on standard error and exit
    with 1.
    """
