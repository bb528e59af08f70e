"""Folder of an archive: all recordings and all results.

`.microbot/` holds one result per job, named after the job, and `recordings.json`: the place of
each recording, its content and its jobs. All files are written whole or not at all, so that an
interrupted run continues where it was.
"""

from __future__ import annotations

import errno
import fcntl
import hashlib
import json
import os
import shutil
import socket
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from microbot_ros.archive.labels import Labels
from microbot_ros.archive.recordings import LABELS, MARK, FileCards, Found, Kind, Refused
from microbot_ros.archive.work import SESSIONS, read_result, result_file
from microbot_ros.common.errors import InputError
from microbot_ros.common.files import write_text

TABLE, REPORT = OUTPUTS = ('archive.parquet', 'archive.html')
_INDEX, _LOCK, _FINDINGS = 'recordings.json', 'lock', 'findings.json'
_COMPANIONS = ('commands.csv', 'session.yaml')


@dataclass
class Entry:
    """A recording of an archive.

    Attributes
    ----------
    name : str
        Its name.
    kind : Kind
        Its kind.
    top : str
        Requested folder in which it was found.
    content : str
        Digest of its content.
    files : list of str
        Its files.
    rig : str or None
        Name of the rig; None for unknown.
    batch : str or None
        Name of the batch; None for unknown.
    day : str or None
        Day (ISO 8601); None for unknown.
    jobs : dict of str to str
        Key of its latest job, by task.
    particle_kind : str or None
        Kind of the particles; None for unknown.
    """

    name: str
    kind: Kind
    top: str
    content: str
    files: list[str]
    rig: str | None = None
    batch: str | None = None
    day: str | None = None
    jobs: dict[str, str] = field(default_factory=dict)
    particle_kind: str | None = None


class Archive:
    """An archive in a folder, which is made when something is written.

    `entries` are its recordings by path, `refused` those that could not be read by name, and
    `cards` the types and digests of files.

    Parameters
    ----------
    folder : str or Path
        Folder of the archive.

    Raises
    ------
    InputError
        If the index of the archive is damaged.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder).resolve()
        self.entries: dict[str, Entry] = {}
        self.refused: dict[str, Refused] = {}
        self.cards = FileCards({})
        if self._index.exists():
            self._load()

    @property
    def _index(self) -> Path:
        return self.folder / MARK / _INDEX

    def _load(self) -> None:
        try:
            kept = json.loads(self._index.read_text(encoding='utf-8'))
            self.entries = {path: Entry(**one) for path, one in kept['entries'].items()}
            self.refused = {name: Refused(**one) for name, one in kept['refused'].items()}
            self.cards = FileCards(kept['files'])
        except (OSError, ValueError, TypeError, KeyError):
            raise InputError(self._index, 'expected the index of an archive; '
                                          'without it the archive is rebuilt from '
                                          'its results') from None

    def save(self, findings: dict[str, Any] | None = None, complete: bool = False) -> None:
        """Write the index and, if new, the findings, each in one step.

        Parameters
        ----------
        findings : dict of str to object or None
            Findings of this run; None for no new ones.
        complete : bool
            Whether the run was complete; otherwise the next run does not use its findings.
        """
        kept = {**self._known(), 'files': self.cards.known}
        write_text(self._index, json.dumps(kept, ensure_ascii=False) + '\n')
        if findings is not None:
            content = {'of': self._state() if complete else '', 'findings': findings}
            write_text(self.folder / MARK / _FINDINGS,
                       json.dumps(content, ensure_ascii=False) + '\n')

    def findings(self) -> dict[str, Any] | None:
        """Return the findings of the last run, if it was complete and nothing has changed since.

        Returns
        -------
        dict of str to object or None
            The findings, or None.
        """
        try:
            kept = json.loads((self.folder / MARK / _FINDINGS).read_text(encoding='utf-8'))
        except (OSError, ValueError):
            return None
        there = all((self.folder / name).is_file() for name in OUTPUTS)
        found: dict[str, Any] = kept['findings']
        return found if there and kept['of'] == self._state() else None

    def _known(self) -> dict[str, Any]:
        return {'entries': {path: vars(one) for path, one in self.entries.items()},
                'refused': {path: vars(one) for path, one in self.refused.items()}}

    def _state(self) -> str:
        """Return a digest of all data that determine the findings."""
        text = json.dumps(self._known(), sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()

    def result(self, key: str) -> dict[str, Any] | None:
        """Return the result of a job.

        Parameters
        ----------
        key : str
            Key of the job.

        Returns
        -------
        dict of str to object or None
            The result; None if there is none.
        """
        return read_result(result_file(self.folder, key))

    def results(self, task: str) -> dict[str, dict[str, Any]]:
        """Return the results of a task, one for each content.

        Of several copies the first by name counts.

        Parameters
        ----------
        task : str
            Name of the task.

        Returns
        -------
        dict[str, dict of str to object]
            Result by path of the recording.
        """
        found: dict[str, dict[str, Any]] = {}
        seen: set[str] = set()
        for path, entry in sorted(self.entries.items(), key=lambda item: item[1].name):
            if entry.content in seen or task not in entry.jobs:
                continue
            result = self.result(entry.jobs[task])
            if result is not None:
                seen.add(entry.content)
                found[path] = result
        return found

    def note(self, found: Found, content: str, labels: Labels) -> Entry:
        """Register a recording.

        Parameters
        ----------
        found : Found
            The recording.
        content : str
            Digest of its content.
        labels : Labels
            Its labels.

        Returns
        -------
        Entry
            Its entry.
        """
        known = self.entries.get(str(found.path))
        day = None if labels.day is None else labels.day.isoformat()
        entry = Entry(found.name, found.kind, str(found.top), content, [*map(str, found.files)],
                      labels.rig, labels.batch, day,
                      known.jobs if known and known.content == content else {}, labels.kind)
        self.entries[str(found.path)] = entry
        return entry

    def forget(self, tops: Sequence[Path], there: set[str]) -> None:
        """Remove recordings that no longer exist.

        Parameters
        ----------
        tops : sequence of Path
            Folders that were searched.
        there : set of str
            Paths of the recordings in them.
        """
        gone = {str(top) for top in tops}
        self.entries = {path: one for path, one in self.entries.items()
                        if one.top not in gone or path in there}
        self.refused = {name: one for name, one in self.refused.items() if one.top not in gone}
        self.cards.known = {path: card for path, card in self.cards.known.items()
                            if os.path.exists(path)}

    def publish(self, recording: Path, session: str) -> None:
        """Copy files beside a recording into its session, and write its labels there.

        Parameters
        ----------
        recording : Path
            Path of the recording.
        session : str
            Name of the session.
        """
        target = self.folder / SESSIONS / session
        beside = recording if recording.is_dir() else recording.parent
        entry = self.entries[str(recording)]
        for name in _COMPANIONS:
            # An import writes what its table states; a film states nothing of the kind.
            if (beside / name).is_file() and (
                    entry.kind == 'film' or not (target / name).exists()):
                shutil.copyfile(beside / name, target / name)
        said = {'rig': entry.rig, 'batch': entry.batch, 'kind': entry.particle_kind,
                'recorded': entry.day}
        known = [f'{key}: {json.dumps(value, ensure_ascii=False) if key != "recorded" else value}'
                 for key, value in said.items() if value]
        if known:
            write_text(target / LABELS, '\n'.join([*known, '']))

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Exclude other writers meanwhile.

        A run whose input is refused before it did anything leaves no files.

        Yields
        ------
        None

        Raises
        ------
        InputError
            If another run writes.
        """
        lock = self.folder / MARK / _LOCK
        made = [one for one in (lock.parent, *lock.parent.parents) if not one.exists()]
        try:
            lock.parent.mkdir(parents=True, exist_ok=True)
            file = lock.open('a+', encoding='utf-8')
        except OSError as error:
            if error.errno in (errno.ENOSPC, errno.EDQUOT):
                raise
            problem = f'expected a folder that can be written ({error.strerror})'
            raise InputError(self.folder, problem) from None
        with file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if not os.fstat(file.fileno()).st_nlink:
                    raise BlockingIOError  # another run has just removed it
            except OSError:
                file.seek(0)
                raise InputError(self.folder, 'another run writes into this archive '
                                              f'({file.read().strip()})') from None
            file.truncate(0)
            file.write(f'process {os.getpid()} on {socket.gethostname()}')
            file.flush()
            try:
                yield
            except InputError:
                if made:
                    self._index.unlink(missing_ok=True)
                raise
            finally:
                if not self._index.exists():
                    lock.unlink()
                    with suppress(OSError):  # not empty
                        for folder in made:
                            folder.rmdir()
