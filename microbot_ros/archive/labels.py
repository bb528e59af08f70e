"""Rig, batch, kind and day of a recording, and the options of its import, as stated by people.

An `archive.yaml` in any folder states them for all recordings in it and below, and under `files`
for single files, globs and folders. The most specific statement counts: that for a file before
that for its folder, and a nearer `archive.yaml` before one above.
"""

from __future__ import annotations

import datetime
import re
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated, Any

from microbot_ros.archive.recordings import LABELS, Found
from microbot_ros.common.checked import Field
from microbot_ros.common.errors import InputError
from microbot_ros.common.files import read_yaml
from microbot_ros.session.mcap.recording import Recording
from microbot_ros.session.spreadsheets.sheets import Answers
from microbot_ros.session.spreadsheets.stated import Stated

_DAY = re.compile(r'(?<!\d)(20\d\d)([-_.]?)(\d\d)\2(\d\d)(?!\d)')
_SINCE_NS = 946_684_800_000_000_000
"""Time [ns since 1970] of the year 2000, before which no recording was made: its clock was not
set."""

_Name = Annotated[str, lambda value: str(value) if isinstance(value, int | float) else value]
"""A name, which may be a number."""


class Statement(Stated):
    """Statement of an `archive.yaml` on recordings; everything is optional."""

    rig: _Name | None = None
    batch: _Name | None = None
    kind: _Name | None = None
    recorded: datetime.date | None = None


class LabelFile(Statement):
    """An `archive.yaml`: a statement for its folder, and more under `files` by path or glob."""

    files: dict[str, Statement] = Field(default_factory=dict)


@dataclass(frozen=True)
class Labels:
    """Labels of a recording; None for unknown ones.

    Attributes
    ----------
    rig : str or None
        Name of the rig.
    batch : str or None
        Name of the batch.
    day : datetime.date or None
        Day of the recording.
    kind : str or None
        Kind of the particles.
    """

    rig: str | None = None
    batch: str | None = None
    day: datetime.date | None = None
    kind: str | None = None


def labels_of(found: Found) -> Labels:
    """Return the labels of a recording.

    The day is that of `archive.yaml`, else that of the recording's own clock, else a date in the
    names of file and folders, such as 2026-03-14. The kind is that of `archive.yaml`, else, for
    tables and films, the name of the nearest folder below the requested one that is no date.

    Parameters
    ----------
    found : Found
        The recording.

    Returns
    -------
    Labels
        The labels.

    Raises
    ------
    InputError
        If an `archive.yaml` is not valid.
    """
    said = stated(found)
    day = said.get('recorded') or _clock(found) or _dated(found.name)
    kind = said.get('kind')
    if kind is None and found.kind in ('table', 'film'):
        above = found.path.relative_to(found.top).parent.parts
        kind = next((name for name in reversed(above) if not _DAY.search(name)), None)
    return Labels(said.get('rig'), said.get('batch'), day, kind)


def stated(found: Found) -> dict[str, Any]:
    """Return all statements of `archive.yaml` files on a recording.

    Parameters
    ----------
    found : Found
        The recording.

    Returns
    -------
    dict of str to object
        Values by key.

    Raises
    ------
    InputError
        If an `archive.yaml` is not valid.
    """
    known: dict[str, Any] = {}
    for statement in _statements(found):
        for key in statement.given - {'files'}:
            if getattr(statement, key) is not None:
                known.setdefault(key, getattr(statement, key))
    return known


def own_answers(found: Found, general: dict[str, Any]) -> dict[str, Any]:
    """Return the answers for the import of a recording: general ones, replaced by stated ones.

    Parameters
    ----------
    found : Found
        The recording.
    general : dict of str to object
        General answers.

    Returns
    -------
    dict of str to object
        `Answers` as a dictionary.
    """
    said = {key: value for key, value in stated(found).items() if key in Stated.names()}
    own, unsaid = asdict(Stated(**said).answers()), asdict(Answers())
    return general | {key: value for key, value in own.items() if value != unsaid[key]}


def _statements(found: Found) -> Iterator[Statement]:
    """Yield the statements on a recording, the most specific first."""
    for folder in _upwards(found):
        if not (folder / LABELS).is_file():
            continue
        own = read_yaml(folder / LABELS, LabelFile)
        path = found.path.relative_to(folder).as_posix()
        parents = [path, *(one.as_posix() for one in Path(path).parents)]
        # A name before a glob; globs in the order of the file.
        for pattern in sorted(own.files, key=lambda one: any(mark in one for mark in '*?[')):
            if any(fnmatchcase(one, pattern.rstrip('/')) for one in parents):
                yield own.files[pattern]
        yield own


def _upwards(found: Found) -> list[Path]:
    """Return the folders of a recording, from its own up to the requested one."""
    first = found.path if found.path.is_dir() else found.path.parent
    folders = [first, *first.parents]
    return folders[:folders.index(found.top) + 1]


def _clock(found: Found) -> datetime.date | None:
    if found.kind != 'recording':
        return None
    try:
        with Recording(found.path) as recording:
            start = recording.start_ns
    except (InputError, OSError):
        return None
    return (datetime.datetime.fromtimestamp(start / 1e9, datetime.UTC).date()
            if start > _SINCE_NS else None)


def _dated(name: str) -> datetime.date | None:
    """Return the last valid date in a name."""
    for year, _, month, day in reversed(_DAY.findall(name)):
        try:
            return datetime.date(int(year), int(month), int(day))
        except ValueError:
            continue
    return None
