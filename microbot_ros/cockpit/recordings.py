"""Recordings of a folder: a list for the page, files to download, a film to replay."""

from __future__ import annotations

import asyncio
import os
import sys
from collections.abc import AsyncIterator
from contextlib import suppress
from pathlib import Path
from typing import Any

from microbot_ros.common.ending import PARENT
from microbot_ros.common.errors import InputError
from microbot_ros.common.extras import lack

_LISTED = 100
"""Number of listed recordings, the newest. Choice: 100 are read in about 0.3 s."""
_PIECE = 64 * 1024
"""Size of a piece of a film [bytes]. Choice: that of a pipe of Linux."""


class Recordings:
    """Recordings in a folder, each in its own folder.

    Parameters
    ----------
    folder : Path
        Folder.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._read: dict[tuple[Path, int], dict[str, Any]] = {}
        self._drawing: asyncio.subprocess.Process | None = None

    def listed(self) -> list[dict[str, Any]]:
        """Return the recordings, newest first.

        Returns
        -------
        list of dict of str to object
            `name`, `files`, `bytes`, `began_s` [s since 1970], `seconds`, `title` and `notes` of
            each. For one that is running or was cut off, `seconds` is None, the texts are empty
            and `began_s` is the time of its last change.
        """
        found = {path: max(file.stat().st_mtime_ns for file in files)
                 for path in self._folder.glob('*') if (files := [*path.glob('*.mcap')])}
        newest = sorted(found, key=lambda path: found[path], reverse=True)[:_LISTED]
        self._read = {(path, found[path]): self._read.get((path, found[path])) or _described(path)
                      for path in newest}
        return [*self._read.values()]

    def file(self, name: str, file: str) -> Path | None:
        """Return the path of a file of a recording.

        Parameters
        ----------
        name : str
            Name of the recording.
        file : str
            Name of the file.

        Returns
        -------
        Path or None
            None if there is none.
        """
        path = self._folder / name / file
        known = path.suffix == '.mcap' and path.is_file() and {name, file}.isdisjoint(('.', '..'))
        return path if known else None

    async def film(self, name: str) -> AsyncIterator[bytes] | None:
        """Return a recording as a film, an MP4.

        Another process draws it, at the lowest priority, in place of the film that is being drawn.

        Parameters
        ----------
        name : str
            Name of the recording.

        Returns
        -------
        async iterator of bytes, or None
            Pieces of the file; None if there is no such recording.
        """
        if not any(name == one['name'] for one in await asyncio.to_thread(self.listed)):
            return None
        self.end()
        self._drawing = await asyncio.create_subprocess_exec(
            'nice', '-n', '19', sys.executable, '-m', 'microbot_ros.cli', 'replay',
            str(self._folder / name), '--film', '-', stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE, env={**os.environ, PARENT: str(os.getpid())})
        return _pieces(self._drawing)

    def end(self) -> None:
        """End the film that is being drawn."""
        if self._drawing is not None:
            _kill(self._drawing)


async def _pieces(process: asyncio.subprocess.Process) -> AsyncIterator[bytes]:
    """Yield the output of a process; end the process when the reader is gone."""
    assert process.stdout is not None
    try:
        while data := await process.stdout.read(_PIECE):
            yield data
    finally:
        _kill(process)


def _kill(process: asyncio.subprocess.Process) -> None:
    with suppress(ProcessLookupError):
        process.kill()


def _described(path: Path) -> dict[str, Any]:
    files = sorted(path.glob('*.mcap'))
    found: dict[str, Any] = {
        'name': path.name, 'files': [file.name for file in files],
        'bytes': sum(file.stat().st_size for file in files),
        'began_s': min(file.stat().st_mtime for file in files), 'seconds': None, 'title': '',
        'notes': ''}
    if lack('mcap') or not (path / 'metadata.yaml').is_file():
        return found  # running or cut off: reading would take long
    from microbot_ros.session.mcap.recording import Recording

    with suppress(InputError), Recording(path) as recording:
        subject = recording.metadata().get('recording', {})
        found |= {'began_s': 1e-9 * recording.start_ns,
                  'seconds': 1e-9 * (recording.end_ns - recording.start_ns),
                  'title': subject.get('title', ''), 'notes': subject.get('notes', '')}
    return found
