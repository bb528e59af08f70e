"""Errors with messages for the user."""

from __future__ import annotations

import difflib
import reprlib
from collections.abc import Iterable
from pathlib import Path

_SHOWN = 80  # choice: characters of a value in a message, one terminal line
_LISTED = 400
"""Choice: characters of names listed in a message; of more, only the nearest are listed."""
_short = reprlib.Repr()
_short.maxlevel = 2
_short.maxstring = _short.maxother = _SHOWN


class InputError(ValueError):
    """Error in something the user supplied: a file, an option, a device name.

    The message is one line: place, what was expected, what was found. Commands print it on
    standard error and exit with 2.

    Parameters
    ----------
    source : str or Path
        File, option or device.
    expected : str
        What was expected, and what was found.
    line : int or None
        Line of the file; None for none.
    """

    def __init__(self, source: str | Path, expected: str, line: int | None = None) -> None:
        self.source = one_line(str(source))
        self.expected = one_line(expected)
        self.line = line
        place = self.source if line is None else f'{self.source}:{line}'
        super().__init__(f'{place}: {self.expected}' if place else self.expected)


class PackageError(InputError):
    """An installed package is not as expected, whatever file was being read."""


class RigError(RuntimeError):
    """A running rig did not do what was requested: a node is missing, silent or refuses.

    The message is one line that names the node. Commands print it on standard error and exit with
    1.
    """


class ReportError(RuntimeError):
    """A report could not be made from results that are complete and written.

    The message is one line that names the report. Commands print it on standard error and exit
    with 1.
    """


def one_line(text: str) -> str:
    """Return `text` with everything unprintable escaped, as one line for a terminal.

    Parameters
    ----------
    text : str
        The text.

    Returns
    -------
    str
        One line.
    """
    return ''.join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


def shown(value: object) -> str:
    """Return the representation of a received `value` in at most 80 characters.

    Parameters
    ----------
    value : object
        The value.

    Returns
    -------
    str
        The representation.
    """
    return clipped(_short.repr(value))


def clipped(text: str) -> str:
    """Return `text`, cut to 80 characters with an ellipsis if it is longer.

    Parameters
    ----------
    text : str
        The text.

    Returns
    -------
    str
        At most 80 characters.
    """
    return text if len(text) <= _SHOWN else f'{text[:_SHOWN - 1]}…'


def known(names: Iterable[str], received: str) -> str:
    """List the `names`, or if they are too many the five nearest to the one `received`.

    Parameters
    ----------
    names : iterable of str
        Valid names.
    received : str
        Name that was received.

    Returns
    -------
    str
        The list as text.
    """
    listed = sorted(names)
    if len(', '.join(listed)) <= _LISTED:
        return f'known are: {", ".join(listed)}'
    nearest = difflib.get_close_matches(clipped(received), listed, n=5, cutoff=0.0)
    return f'nearest of {len(listed)} are: {", ".join(nearest)}'


def counted(count: int, what: str) -> str:
    """Return a number of things in words: '1 robot', '2 robots'.

    Parameters
    ----------
    count : int
        How many.
    what : str
        One of them.

    Returns
    -------
    str
        The text.
    """
    return f'{count} {what}{"" if count == 1 else "s"}'
