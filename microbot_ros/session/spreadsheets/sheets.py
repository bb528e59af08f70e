"""Tables of a laboratory as sheets of named columns, and the user's answers about them."""

from __future__ import annotations

import codecs
import csv
import math
import re
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from datetime import UTC, datetime, time, timedelta
from pathlib import Path
from typing import Any, Literal

import numpy as np

from microbot_ros.common.errors import InputError, counted

_SPREADSHEETS = ('.xlsx', '.xlsm')
_TEXTS = ('.csv', '.tsv', '.txt', '.dat')
_DECIMAL_COMMA = re.compile(r'^\s*[+-]?\d+,\d+\s*$')
_BLANK = ('', 'nan', 'na', 'n/a', 'none', '-', '#n/a', '#div/0!', '#value!', '#num!', '#ref!')
UTF_16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
"""Marks with which a text in UTF-16 begins."""
SAVE_AS_XLSX = 'expected .xlsx; save the file in that format'
"""What is said of a workbook in Excel's former format."""
_SAMPLE = 50
"""Choice: rows that show how wide a table is and whether it has decimal commas."""
_NOTE_CELLS = 0.5
"""Choice: share of the usual number of cells below which the last rows of a table are notes.

A mean below a column has one or two; a robot that is lost keeps half.
"""


@dataclass(frozen=True)
class Answers:
    """User's answers to what a file leaves open, in SI; None: to be detected.

    `columns` names the column of a role; `position_unit`, `time_unit`, `angle_unit` and
    `field_unit` are suffixes of `units`; `pixel_size` [m]; `y_axis`, its direction; `times`, the
    meaning of the time column; `frame_rate` [Hz]; `angle_sense`; `angle_offset` [rad], by which
    angles are too large; `full_scale` [T], the field of a share of 1; `ignore_speed`, whether
    speeds in the table say nothing about the scale of its positions.
    """

    columns: dict[str, str] = field(default_factory=dict)
    position_unit: str | None = None
    pixel_size: float | None = None
    y_axis: Literal['up', 'down'] | None = None
    time_unit: str | None = None
    times: Literal['moments', 'intervals'] | None = None
    frame_rate: float | None = None
    angle_unit: str | None = None
    angle_sense: Literal['counterclockwise', 'clockwise'] | None = None
    angle_offset: float | None = None
    field_unit: str | None = None
    full_scale: float | None = None
    ignore_speed: bool = False


class Assumptions(list[str]):
    """Assumptions of an import, a sentence each without repetition.

    Parameters
    ----------
    sentences : iterable of str
        First sentences.
    """

    def __init__(self, sentences: Iterable[str] = ()) -> None:
        super().__init__(sentences)
        self._sheets: dict[str, tuple[int, list[str]]] = {}

    def add(self, sentence: str, sheet: str = '') -> None:
        """Add a `sentence` about one `sheet` or about all.

        A sentence about several sheets takes one line.

        Parameters
        ----------
        sentence : str
            The sentence.
        sheet : str
            Name of the sheet; '' for all.
        """
        if not sheet:
            if sentence not in self:
                self.append(sentence)
            return
        place, sheets = self._sheets.setdefault(sentence, (len(self), []))
        if sheet not in sheets:
            sheets.append(sheet)
        more = len(sheets) - 1
        first = sheets[0] if not more else f'{sheets[0]} and {counted(more, "more sheet")}'
        self[place:place + 1] = [f'{first}: {sentence}']


@dataclass(frozen=True)
class Sheet:
    """One table.

    `source` is its file and `name` that for messages; `rows` hold as many cells as there are
    `names`, and row i is in line `lines[i]` of the file.
    """

    source: Path
    name: str
    names: list[str]
    rows: list[tuple[Any, ...]]
    lines: list[int]

    @property
    def place(self) -> str:
        """The file and the sheet, for messages."""
        return str(self.source) if self.name == self.source.stem else f'{self.source}[{self.name}]'

    def numbers(self, column: int) -> np.ndarray:
        """Return a `column` as floats (n,), NaN for blank cells; InputError for text.

        Parameters
        ----------
        column : int
            Number of the column.

        Returns
        -------
        ndarray, shape (n,)
            Numbers.
        """
        values = np.empty(len(self.rows))
        for i, row in enumerate(self.rows):
            value = _number(row[column])
            if value is None:
                found = f"found '{row[column]}'"
                raise InputError(
                    self.place, f"expected a number in '{self.names[column]}', {found}",
                    self.lines[i])
            values[i] = value
        return values

    def witness(self, column: int) -> np.ndarray:
        """Return a `column` as floats (n,), NaN for everything else.

        Parameters
        ----------
        column : int
            Number of the column.

        Returns
        -------
        ndarray, shape (n,)
            Numbers.
        """
        values = (_number(row[column]) for row in self.rows)
        return np.array([np.nan if value is None else value for value in values])


def read_sheets(path: Path) -> tuple[list[Sheet], list[str]]:
    """Read all sheets of a spreadsheet, a text file, or a folder of text files at `path`.

    Sentences on assumptions are returned too.

    Parameters
    ----------
    path : Path
        File or folder.

    Returns
    -------
    tuple[list of Sheet, list of str]
        The sheets and the sentences.
    """
    if path.is_dir():
        files = sorted(file for file in path.iterdir() if file.suffix.lower() in _TEXTS)
        if not files:
            raise InputError(path, f'expected files ending in {", ".join(_TEXTS)}')
        return _together([_read_text(file) for file in files])
    if not path.is_file():
        raise InputError(path, 'expected a spreadsheet or a table, found nothing')
    if path.suffix.lower() in _SPREADSHEETS:
        return _together(_read_spreadsheet(path))
    if path.suffix.lower() == '.xls':
        raise InputError(path, SAVE_AS_XLSX)
    return _together([_read_text(path)])


def _together(read: Iterable[tuple[Sheet, list[str]]]) -> tuple[list[Sheet], list[str]]:
    pairs = list(read)
    return [sheet for sheet, _ in pairs], [sentence for _, said in pairs for sentence in said]


def _read_spreadsheet(path: Path) -> list[tuple[Sheet, list[str]]]:
    import openpyxl

    try:
        book = openpyxl.load_workbook(path, read_only=True, data_only=True)
        try:
            for page in book.worksheets:
                page.reset_dimensions()  # some programs state fewer rows than they write
            pages = [(page.title, list(page.iter_rows(values_only=True)))
                     for page in book.worksheets]
        finally:
            book.close()
    except Exception:  # a damaged file raises errors of zlib, XML and whatever it breaks
        raise InputError(path, 'expected an .xlsx spreadsheet; the file is none or damaged'
                         ) from None
    filled = [read for title, rows in pages if (read := _sheet(path, title, rows)) is not None]
    if not filled:
        raise InputError(path, 'expected a sheet with a header and rows below it')
    return filled


def _read_text(path: Path) -> tuple[Sheet, list[str]]:
    text, said = _decoded(path)
    lines = text.splitlines()
    mark = _delimiter([line for line in lines if line.strip()][:20])
    divided = csv.reader(lines, delimiter=mark) if mark else (line.split() for line in lines)
    try:
        rows = [tuple(cell.strip() for cell in row) for row in divided]
    except csv.Error as error:
        raise InputError(path, f'expected a table in text ({error})') from None
    read = _sheet(path, path.stem, rows)
    if read is None:
        raise InputError(path, 'expected a header and rows below it')
    return read[0], [*said, *read[1]]


def _decoded(path: Path) -> tuple[str, list[str]]:
    """Return the text in a file, and a sentence if it is in an encoding of Windows."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(path, f'expected a readable table ({error.strerror})') from None
    said: list[str] = []
    for encoding in ('utf-16',) if content[:2] in UTF_16 else ('utf-8-sig', 'cp1252'):
        try:
            text = content.decode(encoding)
        except UnicodeDecodeError:
            said = [f'{path.name}: not in UTF-8; read as Windows-1252']
            continue
        if '\0' not in text:
            return text, said
    raise InputError(path, 'expected a table in text (UTF-8)')


def _delimiter(lines: list[str]) -> str | None:
    """Return the character that divides most lines alike; None for blanks."""
    for mark in (';', '\t', ','):
        counts = Counter(line.count(mark) for line in lines)
        if counts and counts.most_common(1)[0][0] > 0:
            return mark
    return None


def _with_point(cell: Any) -> Any:
    return cell.replace(',', '.') if isinstance(cell, str) and _DECIMAL_COMMA.match(cell) else cell


def _sheet(path: Path, name: str, rows: list[tuple[Any, ...]]) -> tuple[Sheet, list[str]] | None:
    """Return the table below the first row that looks like a header, and sentences; or None."""
    said: list[str] = []
    if any(_with_point(cell) is not cell for row in rows[:_SAMPLE] for cell in row):
        rows = [tuple(_with_point(cell) for cell in row) for row in rows]
        said.append(f'{path.name if name == path.stem else name}: decimal commas')
    numbered = [(i, row) for i, row in enumerate(rows, 1) if any(not _blank(c) for c in row)]
    # Lines on the experiment above the table have few cells.
    widths = sorted(map(_cells, (row for _, row in numbered[:_SAMPLE])))
    least = max(2, widths[len(widths) // 2] / 2) if widths else 2
    header = next((k for k, (_, row) in enumerate(numbered) if _words(row) >= least), None)
    if header is None or header + 1 == len(numbered):
        return None
    names = [str(cell).strip() if not _blank(cell) else '' for cell in numbered[header][1]]
    body = numbered[header + 1:]
    # Some programs describe their columns in further rows of words.
    while len(body) > 1 and _words(body[0][1]) == _cells(body[0][1]):
        body = body[1:]
    kept = _without_notes(body)
    if len(kept) < len(body):
        lines = f'line {body[-1][0]}' if len(body) == len(kept) + 1 else (
            f'lines {body[len(kept)][0]} to {body[-1][0]}')
        said.append(f'{name}: {lines} below the table hold notes; left out')
    for line, row in kept:
        if any(not _blank(cell) for cell in row[len(names):]):
            raise InputError(path, f'expected {len(names)} values, found {len(row)}', line)
    padded = [(tuple(row) + (None,) * len(names))[:len(names)] for _, row in kept]
    return Sheet(path, name, names, padded, [line for line, _ in kept]), said


def _without_notes(body: list[tuple[int, tuple[Any, ...]]]) -> list[tuple[int, tuple[Any, ...]]]:
    """Return the numbered rows of a table without those after a blank line that hold notes."""
    widths = sorted(_cells(row) for _, row in body)
    least = _NOTE_CELLS * widths[len(widths) // 2]
    end = len(body)
    while end > 1 and _cells(body[end - 1][1]) < least:
        end -= 1
    gap = next((k for k in range(end, len(body)) if body[k][0] > body[k - 1][0] + 1), len(body))
    return body[:gap]


def _cells(row: tuple[Any, ...]) -> int:
    """Return the number of cells of a row that are not blank."""
    return sum(not _blank(cell) for cell in row)


def _words(row: tuple[Any, ...]) -> int:
    """Return the number of cells of a row that are neither numbers nor blank."""
    return sum(_number(cell) is None for cell in row)


def _blank(cell: Any) -> bool:
    return cell is None or (isinstance(cell, str) and cell.strip().lower() in _BLANK)


def _number(cell: Any) -> float | None:
    """Return a cell as a number, NaN if blank, None for text; dates in seconds."""
    if _blank(cell):
        return math.nan
    if isinstance(cell, datetime):
        return cell.replace(tzinfo=UTC).timestamp()  # no hour is missing in UTC
    if isinstance(cell, time):
        return cell.hour * 3600 + cell.minute * 60 + cell.second + cell.microsecond / 1e6
    if isinstance(cell, timedelta):
        return cell.total_seconds()
    try:
        value = float(cell)
    except (TypeError, ValueError):
        return None
    return value if math.isfinite(value) else None
