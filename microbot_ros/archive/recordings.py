"""Recordings among the files of a laboratory, found by what files hold, whatever they are called.

A folder with `tracks.csv` is a session and one of MCAP files a recording, as everywhere here; of
all other files the first bytes, or the columns of a table, say what they are.
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

from microbot_ros.common.errors import InputError
from microbot_ros.session.mcap.bag import METADATA_FILE
from microbot_ros.session.spreadsheets.columns import find_columns
from microbot_ros.session.spreadsheets.sheets import read_sheets
from microbot_ros.session.spreadsheets.summary import summary_of

Kind = Literal['session', 'recording', 'film', 'table']
MARK = '.microbot'
"""Hidden folder by which an archive is known; what lies in an archive is found if asked for."""

LABELS = 'archive.yaml'
_SESSION = ('tracks.csv', 'commands.csv', 'session.yaml')
_SHEETS = ('.csv', '.tsv', '.xlsx', '.xlsm')
_CLAIMS = (*_SHEETS, '.xls', '.mcap', '.db3', '.avi', '.mp4', '.mov', '.mkv', '.webm', '.m4v')
"""Endings of files that somebody takes for recordings: where they are none it is said."""

_MOST_TEXT = 2**28
"""Bytes of the longest text that is looked at for a table."""

# Where they stand → bytes → what files that begin so are.
_MAGIC: tuple[tuple[int, bytes, str], ...] = (
    (0, b'\x89MCAP0\r\n', 'mcap'), (0, b'PK\x03\x04', 'zip'),
    (0, b'SQLite format 3\0', 'sqlite'),
    (0, b'\x89PNG\r\n', 'image'), (0, b'\xff\xd8\xff', 'image'), (0, b'II*\0', 'image'),
    (0, b'MM\0*', 'image'), (0, b'BM', 'image'), (0, b'P5\n', 'image'), (8, b'WEBP', 'image'),
    (8, b'AVI ', 'film'), (4, b'ftyp', 'film'), (0, b'\x1a\x45\xdf\xa3', 'film'),
    (4, b'moov', 'film'), (0, b'\x30\x26\xb2\x75', 'film'), (0, b'FLV', 'film'),
    (0, b'GIF8', 'film'), (0, b'\0\0\x01\xba', 'film'), (0, b'\0\0\x01\xb3', 'film'),
)


@dataclass(frozen=True)
class Found:
    """A recording of a `kind` at `path`, made of `files`, found below the folder `top`."""

    path: Path
    kind: Kind
    top: Path
    files: tuple[Path, ...]

    @property
    def name(self) -> str:
        """For people: from the folder on that was asked for."""
        return str(self.path.relative_to(self.top.parent))


@dataclass(frozen=True)
class Refused:
    """What can't be read, found below the folder `top`: its `name` and the `reason`."""

    name: str
    reason: str
    top: str

    @classmethod
    def of(cls, path: Path, top: Path, error: OSError | str) -> Refused:
        """The file or folder at `path` below `top`, and the `error` or what is wrong with it."""
        reason = error if isinstance(error, str) else error.strerror or str(error)
        return cls(str(path.relative_to(top.parent)), reason, str(top))


class FileCards:
    """What files are and what they hold, asked of a file again only when it has changed.

    `known`: {path: [bytes, time of change [ns], what it is or '', SHA-256 or '']}, as it is kept.
    """

    def __init__(self, known: dict[str, list[Any]]) -> None:
        self.known = known

    def what(self, file: Path) -> str:
        """'mcap', 'sqlite', 'image', 'film', 'positions', 'commands', 'spreadsheet', 'empty' or
        'other', or a sentence on why a `file` is no table.
        """
        card = self._card(file)
        if not card[2]:
            card[2] = _what(file, card[0])
        return str(card[2])

    def digest(self, file: Path) -> str:
        """SHA-256 of the content of a `file`; OSError where it can't be read."""
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
    """A digest of all that a recording holds, wherever it lies and whatever it is called.

    Of files by their `cards`; the names of files count only where they say what a file is.
    """
    named = found.kind in ('session', 'table')
    parts = [f'{file.name if named and len(found.files) > 1 else ""} {cards.digest(file)}'
             for file in found.files]
    return hashlib.sha256('\n'.join([found.kind, *parts]).encode()).hexdigest()


def find(folders: Sequence[Path], cards: FileCards) -> Iterator[Found | Refused]:
    """Every recording in `folders`, and what looks like one and is none; files by their `cards`.

    In the order of names. Hidden files are left out, and archives within a folder. InputError for
    a folder that is not there.
    """
    seen: set[Path] = set()
    for folder in folders:
        top = folder.resolve()
        if not top.is_dir():
            raise InputError(folder, 'expected a folder of recordings')
        for place, names, files in os.walk(top):
            here = Path(place)
            names[:] = sorted(n for n in names if not n.startswith('.')
                              and not (here / n / MARK).is_dir())
            if here in seen:
                names.clear()
                continue
            seen.add(here)
            visible = sorted(here / f for f in files if not f.startswith('.') and f != LABELS)
            yield from _in_folder(here, [f for f in visible if f.is_file()], top, cards)


def _in_folder(here: Path, files: list[Path], top: Path, cards: FileCards,
               ) -> Iterator[Found | Refused]:
    def found(path: Path, kind: Kind, of: Sequence[Path]) -> Found:
        return Found(path, kind, top, tuple(of))

    if here / _SESSION[0] in files:
        own = [file for file in files if file.name in _SESSION]
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
    if mcaps and (metadata or together) and not (here / _SESSION[0]).exists():
        yield found(here, 'recording', [*mcaps, *metadata])
    else:
        yield from (found(file, 'recording', [file]) for file in mcaps)
    images = kinds.pop('image', [])
    if len(images) > 1:
        yield found(here, 'film', images)
    yield from (found(file, 'film', [file]) for file in kinds.pop('film', []))
    tables, commands = kinds.pop('positions', []), kinds.pop('commands', [])
    if tables and commands:  # robots and what drove them, a file each
        yield found(here, 'table', sorted([*tables, *commands]))
    else:
        yield from (found(file, 'table', [file]) for file in tables)
    yield from (found(file, 'table', [file]) for file in kinds.pop('spreadsheet', []))
    yield from _refused(kinds, top)


def _refused(kinds: dict[str, list[Path]], top: Path) -> Iterator[Refused]:
    """Files that claim to be recordings and are none, of those of other `kinds`."""
    reasons = {
        'sqlite': 'a bag of sqlite3: expected MCAP; convert it with ros2 bag convert',
        'empty': 'an empty file',
        'other': 'no known file in it',
    }
    for what, files in kinds.items():
        for file in files:
            if file.suffix.lower() in _CLAIMS:
                yield Refused.of(file, top, reasons.get(what, what))


def _what(file: Path, size: int) -> str:
    """What a file of so many bytes (`size`) is; see `FileCards.what`."""
    if not size:
        return 'empty'
    with file.open('rb') as stream:
        head = stream.read(4096)
    magic = next((what for at, mark, what in _MAGIC if head[at:at + len(mark)] == mark), '')
    if magic == 'zip':
        return 'spreadsheet' if _is_workbook(file) else 'other'
    if magic and (head[:2] != b'BM' or b'\0' in head):
        return magic
    if b'\0' in head or size > _MOST_TEXT or file.suffix.lower() in ('.yaml', '.yml', '.json'):
        return 'other'
    return _table(file)


def _is_workbook(file: Path) -> bool:
    try:
        with zipfile.ZipFile(file) as archive:
            return 'xl/workbook.xml' in archive.namelist()
    except (OSError, zipfile.BadZipFile):
        return False


def _table(file: Path) -> str:
    """'positions', 'commands', or why a text is no table of either."""
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
        return 'spreadsheet'  # whose import says what it is
    return 'expected columns of positions or commands; it has none'


def pairs(found: Sequence[Found]) -> dict[Path, Found]:
    """Return the table of each film that lies beside it under its name: {path of a film: table}.
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
    """Those `found` with the digests of their content, in their order, read by several threads.

    Files by their `cards`. `report` is told of each that is read for the first time.
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
