"""The folder of an archive: what is known of every recording, and every result.

`.microbot/` holds a result per job, under the name of the job, and `recordings.json`: where each
recording lies, what its content is, which jobs are its own. All is written whole or not at all, so
that who is stopped, at whatever moment, goes on where he was.
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
from microbot_ros.archive.work import SESSIONS, result_file
from microbot_ros.common.errors import InputError
from microbot_ros.common.files import write_text

TABLE, REPORT = OUTPUTS = ('archive.parquet', 'archive.html')
_INDEX, _LOCK, _FINDINGS = 'recordings.json', 'lock', 'findings.json'
_COMPANIONS = ('commands.csv', 'session.yaml')


@dataclass
class Entry:
    """What an archive knows of the recording of that `name` and `kind`, found below `top`.

    It is made of `files`, and `content` is their digest; `jobs` {task: key of its latest job};
    `rig`, `batch`, `day` (ISO) and `particle_kind` as its labels say.
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
    """An archive in a `folder`, which is made when something is written.

    `entries` by the path of the recording; `refused`, by name, could not be read; `cards` of
    files.
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
        """Write what is known, and the `findings` where they are new, each in one step.

        Only those of a run that was `complete` are good for the next one.
        """
        kept = {**self._known(), 'files': self.cards.known}
        write_text(self._index, json.dumps(kept, ensure_ascii=False) + '\n')
        if findings is not None:
            content = {'of': self._state() if complete else '', 'findings': findings}
            write_text(self.folder / MARK / _FINDINGS,
                       json.dumps(content, ensure_ascii=False) + '\n')

    def findings(self) -> dict[str, Any] | None:
        """Those of the last run, where it was complete and nothing has changed since."""
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
        """A digest of all that the findings follow from."""
        text = json.dumps(self._known(), sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()

    def result(self, key: str) -> dict[str, Any] | None:
        """The result of the job of that `key`; None where there is none."""
        try:
            content = result_file(self.folder, key).read_text(encoding='utf-8')
        except FileNotFoundError:
            return None
        found: dict[str, Any] = json.loads(content)
        return found

    def results(self, task: str) -> dict[str, dict[str, Any]]:
        """{path of a recording: result} of a `task`, one for each content.

        Of recordings that are copies of one another the first by name counts.
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
        """The entry of what was `found`, with this `content` and `labels`."""
        known = self.entries.get(str(found.path))
        day = None if labels.day is None else labels.day.isoformat()
        entry = Entry(found.name, found.kind, str(found.top), content, [*map(str, found.files)],
                      labels.rig, labels.batch, day,
                      known.jobs if known and known.content == content else {}, labels.kind)
        self.entries[str(found.path)] = entry
        return entry

    def forget(self, tops: Sequence[Path], there: set[str]) -> None:
        """Leave out what was found below one of `tops` once and is not `there` any more."""
        gone = {str(top) for top in tops}
        self.entries = {path: one for path, one in self.entries.items()
                        if one.top not in gone or path in there}
        self.refused = {name: one for name, one in self.refused.items() if one.top not in gone}
        self.cards.known = {path: card for path, card in self.cards.known.items()
                            if os.path.exists(path)}

    def publish(self, recording: Path, session: str) -> None:
        """Lay into a `session` what lies beside the `recording` that it is of, and the labels."""
        target = self.folder / SESSIONS / session
        beside = recording if recording.is_dir() else recording.parent
        for name in _COMPANIONS:
            if (beside / name).is_file() and not (target / name).exists():
                shutil.copyfile(beside / name, target / name)
        entry = self.entries[str(recording)]
        said = {'rig': entry.rig, 'batch': entry.batch, 'kind': entry.particle_kind,
                'recorded': entry.day}
        known = [f'{key}: {json.dumps(value, ensure_ascii=False) if key != "recorded" else value}'
                 for key, value in said.items() if value]
        if known:
            write_text(target / LABELS, '\n'.join([*known, '']))

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Keep all others from writing here meanwhile; InputError where another run does.

        Of a run that found its input wrong before it did anything here nothing stays.
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
                    raise BlockingIOError  # of a run that has just taken it away
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
                    with suppress(OSError):  # there is something in it
                        for folder in made:
                            folder.rmdir()
