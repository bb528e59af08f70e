"""Which rig, which batch of particles, which day: what only people know of a recording.

An `archive.yaml` in any folder says it for all recordings in it and below; the nearest one that
says something counts.
"""

from __future__ import annotations

import datetime
import re
from dataclasses import dataclass
from pathlib import Path

import pydantic

from microbot_ros.archive.recordings import LABELS, Found
from microbot_ros.errors import InputError
from microbot_ros.files import Settings, read_yaml
from microbot_ros.session import open_recording

_DAY = re.compile(r'(?<!\d)(20\d\d)([-_.]?)(\d\d)\2(\d\d)(?!\d)')
_SINCE_NS = 946_684_800_000_000_000
"""The year 2000: a recording whose clock says less was stamped by no calendar."""


class LabelFile(Settings):
    """`archive.yaml`, all of it optional."""

    rig: str | None = None
    batch: str | None = None
    recorded: datetime.date | None = None

    @pydantic.field_validator('rig', 'batch', mode='before')
    @classmethod
    def as_text(cls, value: object) -> object:
        """Numbers are names, too."""
        return str(value) if isinstance(value, int | float) else value


@dataclass(frozen=True)
class Labels:
    """`rig` and `batch` by name, and the `day` that it was recorded; None where nobody says."""

    rig: str | None = None
    batch: str | None = None
    day: datetime.date | None = None


def labels_of(found: Found) -> Labels:
    """What is known of a recording that was `found`.

    The day is that of `archive.yaml`, else that of the recording's own clock, else a date in the
    names of file and folders, such as 2026-03-14. InputError for an `archive.yaml` that is wrong.
    """
    said = LabelFile()
    for folder in _upwards(found):
        if (folder / LABELS).is_file():
            own = read_yaml(folder / LABELS, LabelFile)
            said = LabelFile(rig=said.rig or own.rig, batch=said.batch or own.batch,
                             recorded=said.recorded or own.recorded)
    return Labels(said.rig, said.batch, said.recorded or _clock(found) or _dated(found.name))


def _upwards(found: Found) -> list[Path]:
    """The folders of a recording, from its own up to where it was looked for."""
    first = found.path if found.path.is_dir() else found.path.parent
    folders = [first, *first.parents]
    return folders[:folders.index(found.top) + 1]


def _clock(found: Found) -> datetime.date | None:
    if found.kind != 'recording':
        return None
    try:
        with open_recording(found.path) as recording:
            start = recording.start_ns
    except (InputError, OSError):
        return None
    return (datetime.datetime.fromtimestamp(start / 1e9, datetime.UTC).date()
            if start > _SINCE_NS else None)


def _dated(name: str) -> datetime.date | None:
    """The last date in a name that is one."""
    for year, _, month, day in reversed(_DAY.findall(name)):
        try:
            return datetime.date(int(year), int(month), int(day))
        except ValueError:
            continue
    return None
