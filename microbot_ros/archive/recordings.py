"""Recordings among the files of a laboratory, found by the content of files, not their names.

A folder with `tracks.csv` is a session and one of MCAP files a recording, as everywhere; the first
bytes of all other files, or the columns of a table, show what they are.
"""

from __future__ import annotations

import hashlib
import os
import re
import zipfile
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from microbot_ros.common.errors import InputError, one_line
from microbot_ros.session.mcap.bag import METADATA_FILE
from microbot_ros.session.spreadsheets.columns import find_columns
from microbot_ros.session.spreadsheets.sheets import SAVE_AS_XLSX, UTF_16, read_sheets
from microbot_ros.session.spreadsheets.summary import summary_of
from microbot_ros.session.tables.folder import FILES, TRACKS

Kind = Literal['session', 'recording', 'film', 'table']
MARK = '.microbot'
"""Hidden folder that marks an archive; recordings in an archive are found only if it is
requested."""

LABELS = 'archive.yaml'
_HIDDEN = ('.', '~$')
"""Beginnings of names of hidden files; `~$` are locks of Excel while a workbook is open."""
_SHEETS = ('.csv', '.tsv', '.xlsx', '.xlsm')
_CLAIMS = (*_SHEETS, '.xls', '.mcap', '.db3', '.avi', '.mp4', '.mov', '.mkv', '.webm', '.m4v')
"""Endings of files that people take for recordings: if they are none, that is reported."""

_MOST_TEXT = 2**28
"""Largest text that is examined for a table [bytes]. Choice: 256 MB, as a table is read into
memory as a whole."""

_MAGIC: tuple[tuple[int, bytes, str], ...] = (
    (0, b'\x89MCAP0\r\n', 'mcap'), (0, b'PK\x03\x04', 'zip'),
    (0, b'SQLite format 3\0', 'sqlite'),
    (0, b'\x89PNG\r\n', 'image'), (0, b'\xff\xd8\xff', 'image'), (0, b'II*\0', 'image'),
    (0, b'MM\0*', 'image'), (0, b'BM', 'image'), (0, b'P5\n', 'image'), (8, b'WEBP', 'image'),
    (8, b'AVI ', 'film'), (4, b'ftyp', 'film'), (0, b'\x1a\x45\xdf\xa3', 'film'),
    (4, b'moov', 'film'), (0, b'\x30\x26\xb2\x75', 'film'), (0, b'FLV', 'film'),
    (0, b'GIF8', 'film'), (0, b'\0\0\x01\xba', 'film'), (0, b'\0\0\x01\xb3', 'film'),
)
"""Offset and first bytes of types of files, by the definitions of their formats."""


@dataclass(frozen=True)
class Found:
    """A recording.

    Attributes
    ----------
    path : Path
        Its path.
    kind : Kind
        Its kind.
    top : Path
        Requested folder in which it was found.
    files : tuple of Path
        Its files.
    """

    path: Path
    kind: Kind
    top: Path
    files: tuple[Path, ...]

    @property
    def name(self) -> str:
        """Name for people: the path from the requested folder on."""
        return str(self.path.relative_to(self.top.parent))


@dataclass(frozen=True)
class Refused:
    """A file or folder that cannot be read.

    Attributes
    ----------
    name : str
        Its name.
    reason : str
        Why.
    top : str
        Requested folder in which it was found.
    """

    name: str
    reason: str
    top: str

    @classmethod
    def of(cls, path: Path, top: Path, error: OSError | str) -> Refused:
        """Return the refusal of a path.

        Parameters
        ----------
        path : Path
            The file or folder.
        top : Path
            Requested folder in which it was found.
        error : OSError or str
            Error, or the reason.

        Returns
        -------
        Refused
            The refusal.
        """
        reason = error if isinstance(error, str) else error.strerror or str(error)
        return cls(one_line(str(path.relative_to(top.parent))), reason, str(top))


class FileCards:
    """Types and digests of files, determined again only if a file has changed.

    Parameters
    ----------
    known : dict of str to list of object
        {path: [bytes, time of change [ns], type or '', SHA-256 or '']}, as it is stored.
    """

    def __init__(self, known: dict[str, list[Any]]) -> None:
        self.known = known

    def what(self, file: Path) -> str:
        """Return the type of a file.

        Parameters
        ----------
        file : Path
            The file.

        Returns
        -------
        str
            'mcap', 'sqlite', 'image', 'film', 'positions', 'commands', 'spreadsheet', 'empty',
            'other', or a sentence on why it is no table.
        """
        card = self._card(file)
        if not card[2]:
            card[2] = _what(file, card[0])
        return str(card[2])

    def digest(self, file: Path) -> str:
        """Return the SHA-256 of the content of a file.

        Parameters
        ----------
        file : Path
            The file.

        Returns
        -------
        str
            Hexadecimal digest.

        Raises
        ------
        OSError
            If the file cannot be read.
        """
        card = self._card(file)
        if not card[3]:
            with file.open('rb') as stream:
                card[3] = hashlib.file_digest(stream, 'sha256').hexdigest()
        return str(card[3])

    def _card(self, file: Path) -> list[Any]:
        state = file.stat()
        card = self.known.get(str(file))
        if card is None or card[:2] != [state.st_size, state.st_mtime_ns]:
            card = [state.st_size, state.st_mtime_ns, '', '']
            self.known[str(file)] = card
        return card


def content_of(found: Found, cards: FileCards) -> str:
    """Return a digest of the content of a recording, independent of its place and name.

    The names of its files count only if they determine the type of a file.

    Parameters
    ----------
    found : Found
        The recording.
    cards : FileCards
        Types and digests of files.

    Returns
    -------
    str
        Hexadecimal digest.
    """
    named = found.kind in ('session', 'table')
    parts = [f'{file.name if named and len(found.files) > 1 else ""} {cards.digest(file)}'
             for file in found.files]
    return hashlib.sha256('\n'.join([found.kind, *parts]).encode()).hexdigest()


def find(folders: Sequence[Path], cards: FileCards) -> Iterator[Found | Refused]:
    """Find all recordings in folders, and files that look like one and are none.

    Hidden files and archives within a folder are left out.

    Parameters
    ----------
    folders : sequence of Path
        Folders.
    cards : FileCards
        Types and digests of files.

    Yields
    ------
    Found or Refused
        In the order of names.

    Raises
    ------
    InputError
        If a folder does not exist.
    """
    seen: set[Path] = set()
    for folder in folders:
        top = folder.resolve()
        if not top.is_dir():
            raise InputError(folder, 'expected a folder of recordings')
        closed: list[OSError] = []
        for place, names, files in os.walk(top, onerror=closed.append):
            here = Path(place)
            for name in filter(_is_no_text, [*names, *files]):
                yield Refused.of(here / name, top, 'expected a name in UTF-8; rename it')
            names[:] = sorted(n for n in names if not n.startswith(_HIDDEN) and not _is_no_text(n)
                              and not os.path.isdir(here / n / MARK))
            if here in seen:
                names.clear()
                continue
            seen.add(here)
            visible = sorted(here / f for f in files if not f.startswith(_HIDDEN) and f != LABELS
                             and not _is_no_text(f))
            yield from _in_folder(here, [f for f in visible if f.is_file()], top, cards)
        yield from (Refused.of(Path(error.filename), top, error) for error in closed)


def _is_no_text(name: str) -> bool:
    """Return whether a name of a file is not in UTF-8, as on disks of old systems."""
    return any('\ud800' <= c <= '\udfff' for c in name)


def _in_folder(here: Path, files: list[Path], top: Path, cards: FileCards,
               ) -> Iterator[Found | Refused]:
    def found(path: Path, kind: Kind, of: Sequence[Path]) -> Found:
        return Found(path, kind, top, tuple(of))

    own = [file for file in files if file.name in FILES]
    tracks = here / FILES[0]
    if tracks in own and (len(own) > 1 or _has_session_columns(tracks)):
        yield found(here, 'session', own)
        files = [file for file in files if file not in own]
    kinds: dict[str, list[Path]] = {}
    for file in files:
        try:
            kinds.setdefault(cards.what(file), []).append(file)
        except OSError as error:
            yield Refused.of(file, top, error)
    mcaps = kinds.pop('mcap', [])
    metadata = [file for file in files if file.name == METADATA_FILE]
    together = len(mcaps) > 1 and len({
        (re.sub(r'_\d+$', '', file.stem), file.suffix == '.mcap') for file in mcaps}) == 1
    if mcaps and (metadata or together) and not tracks.exists():
        yield found(here, 'recording', [*mcaps, *metadata])
    else:
        yield from (found(file, 'recording', [file]) for file in mcaps)
    images = kinds.pop('image', [])
    if len(images) > 1:
        yield found(here, 'film', images)
    yield from (found(file, 'film', [file]) for file in kinds.pop('film', []))
    tables, commands = kinds.pop('positions', []), kinds.pop('commands', [])
    if tables and commands:  # robots and commands, one file each
        yield found(here, 'table', sorted([*tables, *commands]))
    else:
        yield from (found(file, 'table', [file]) for file in tables)
    yield from (found(file, 'table', [file]) for file in kinds.pop('spreadsheet', []))
    yield from _refused(kinds, top)


def _has_session_columns(tracks: Path) -> bool:
    """Return whether `tracks` is the table of a session: programs of others use the name too."""
    try:
        with tracks.open(encoding='utf-8-sig', errors='replace') as file:
            names = {name.strip() for name in file.readline(4096).split(',')}
    except OSError:
        return True  # the reader of sessions says why
    return {*TRACKS.required} <= names


def _refused(kinds: dict[str, list[Path]], top: Path) -> Iterator[Refused]:
    """Yield files that claim to be recordings and are none."""
    reasons = {
        'sqlite': 'a bag of sqlite3: expected MCAP; convert it with ros2 bag convert',
        'empty': 'an empty file',
        'other': 'no known file in it',
    }
    for what, files in kinds.items():
        for file in files:
            if file.suffix.lower() in _CLAIMS:
                old = file.suffix.lower() == '.xls'
                yield Refused.of(file, top, SAVE_AS_XLSX if old else reasons.get(what, what))


def _what(file: Path, size: int) -> str:
    """Return the type of a file; see `FileCards.what`."""
    if not size:
        return 'empty'
    with file.open('rb') as stream:
        head = stream.read(4096)
    magic = next((what for at, mark, what in _MAGIC if head[at:at + len(mark)] == mark), '')
    if magic == 'zip':
        return 'spreadsheet' if _is_workbook(file) else 'other'
    if magic and (head[:2] != b'BM' or b'\0' in head):
        return magic
    text = head.startswith(UTF_16) or b'\0' not in head
    if not text or size > _MOST_TEXT or file.suffix.lower() in ('.yaml', '.yml', '.json'):
        return 'other'
    return _table(file)


def _is_workbook(file: Path) -> bool:
    try:
        with zipfile.ZipFile(file) as archive:
            return 'xl/workbook.xml' in archive.namelist()
    except (OSError, zipfile.BadZipFile):
        return False


def _table(file: Path) -> str:
    """Return 'positions', 'commands', or why a text is neither."""
    try:
        [sheet], _ = read_sheets(file)
        columns = find_columns(sheet, {})
        roles = {column.role for column in columns}
    except InputError as error:
        return error.expected
    if {'x', 'y'} <= roles:
        return 'positions'
    if 'direction' in roles or {'bx', 'by'} <= roles:
        return 'commands'
    if summary_of([(sheet, columns)]):
        return 'spreadsheet'  # the import reports the averages
    return 'expected columns of positions or commands; it has none'


def pairs(found: Sequence[Found]) -> dict[Path, Found]:
    """Return the table of each film that lies beside it under its name.

    Parameters
    ----------
    found : sequence of Found
        Recordings.

    Returns
    -------
    dict of Path to Found
        Table by path of the film.
    """
    films: dict[tuple[Path, str], list[Path]] = defaultdict(list)
    tables: dict[tuple[Path, str], list[Found]] = defaultdict(list)
    for one in found:
        key = (one.path.parent, one.path.name if one.path.is_dir() else one.path.stem)
        if one.kind == 'film':
            films[key].append(one.path)
        elif one.kind == 'table' and len(one.files) == 1:
            tables[key].append(one)
    return {films[key][0]: of[0] for key, of in tables.items()
            if len(of) == 1 and len(films[key]) == 1}


def in_parallel(found: Sequence[Found], cards: FileCards,
                report: Callable[[str], None]) -> Iterator[tuple[Found, str] | Refused]:
    """Read recordings in several threads and compute the digests of their content.

    Parameters
    ----------
    found : sequence of Found
        Recordings.
    cards : FileCards
        Types and digests of files.
    report : callable
        Function that is called with a sentence on each.

    Yields
    ------
    tuple of (Found, str), or Refused
        Recording and digest, in the order given.
    """
    from concurrent.futures import ThreadPoolExecutor

    def read(one: Found) -> tuple[Found, str] | Refused:
        try:
            report(f'reading {one.name}')
            return one, content_of(one, cards)
        except OSError as error:
            return Refused.of(one.path, one.top, error)

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        yield from pool.map(read, found)
