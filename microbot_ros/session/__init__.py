"""Reading and writing sessions: folders of CSV files and MCAP recordings.

Examples
--------
>>> import tempfile, numpy as np
>>> from microbot_ros.common.records import Commands, Session, Tracks
>>> from microbot_ros.session import read_session, write_session
>>> t, unknown = np.arange(4) / 30, np.full(4, np.nan)
>>> tracks = Tracks(t, np.zeros(4, int), np.zeros((4, 2)), unknown, unknown)
>>> with tempfile.TemporaryDirectory() as folder:
...     write_session(folder, Session(tracks, Commands(t[:1], np.array([[5e-3, 0.0]]))))
...     len(read_session(folder).tracks.t)
4
"""

from __future__ import annotations

from pathlib import Path

from microbot_ros.common.errors import InputError
from microbot_ros.common.records import Session
from microbot_ros.session.tables.folder import read_folder, write_session

__all__ = ['read_session', 'write_session']


def read_session(path: str | Path) -> Session:
    """Read tracks, commands and conditions from `path`, a session folder or a recording.

    Raises InputError naming file, line or topic, and what was expected.

    Parameters
    ----------
    path : str or Path
        File or folder.

    Returns
    -------
    Session
        The session.
    """
    path = Path(path)
    if not path.exists():
        raise InputError(path, 'expected a session folder or a recording, found nothing')
    # Recordings need the extra `mcap`, folders do not.
    from microbot_ros.session.mcap.from_recording import session_of
    from microbot_ros.session.mcap.recording import Recording, is_recording

    if not is_recording(path):
        return read_folder(path)
    if (path / 'tracks.csv').exists():
        raise InputError(path, 'expected tracks.csv or a recording, found both')
    with Recording(path) as recording:
        return session_of(recording)
