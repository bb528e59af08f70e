"""Reading and writing sessions: folders of CSV files and MCAP recordings."""

from __future__ import annotations

from pathlib import Path

from microbot_ros.errors import InputError
from microbot_ros.records import Session
from microbot_ros.session.folder import read_folder, write_folder
from microbot_ros.session.recorder import RecorderStatus, RecordingWriter

__all__ = ['RecorderStatus', 'RecordingWriter', 'read_session', 'write_session']


def read_session(path: str | Path) -> Session:
    """Tracks, commands and conditions of a session folder.

    Raises InputError naming file, line and what was expected.
    """
    path = Path(path)
    if not path.exists():
        raise InputError(path, 'expected a session folder or a recording, found nothing')
    return read_folder(path)


def write_session(path: str | Path, session: Session) -> None:
    """Write `tracks.csv`, `commands.csv` and `session.yaml` into a folder, all or nothing."""
    write_folder(Path(path), session)
