"""Validated CSV tables whose numbers survive a round trip to the last bit.

Units are converted in decimals (`units.exact_si`): `0.1` in a column `x_um` is the double nearest
to 1e-7, and that double is written as `0.1` again.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from microbot_ros.common.errors import InputError, clipped
from microbot_ros.common.plausible import expected_range, implausible
from microbot_ros.common.units import exact_display, exact_si, from_si


@dataclass(frozen=True)
class Layout:
    """Columns of one kind of table; the unit of each is the suffix of its name.

    All `required` ones must exist; cells of `optional` ones may be empty (NaN); `ignored` ones may
    hold anything.
    """

    required: tuple[str, ...]
    optional: tuple[str, ...] = ()
    ignored: tuple[str, ...] = ()


@dataclass(frozen=True)
class Table:
    """Table read from `path` with a `layout`.

    `columns` by name, (rows,) each in SI, and `lines` of the file for each row.
    """

    path: Path
    layout: Layout
    columns: dict[str, np.ndarray]
    lines: np.ndarray

    def refuse(self, bad: np.ndarray, expected: str) -> None:
        """Raise InputError with `expected` at the first row where `bad` (rows,) is true.

        Parameters
        ----------
        bad : ndarray, shape (rows,)
            Whether each row is wrong.
        expected : str
            What was expected.
        """
        if bad.any():
            raise InputError(self.path, expected, int(self.lines[np.argmax(bad)]))


def read_table(path: Path, *layouts: Layout) -> Table:
    """Read a CSV file at `path` that follows one of the `layouts`, its columns in any order.

    Raises InputError with file, line and expectation if it is missing, empty, not text, or holds
    anything but plausible numbers under the names of a layout.

    Parameters
    ----------
    path : Path
        File or folder.
    *layouts : Layout
        The layouts.

    Returns
    -------
    Table
        The table.
    """
    try:
        text = path.read_text(encoding='utf-8-sig')
    except OSError as error:
        raise InputError(path, f'expected a readable CSV file ({error.strerror})') from None
    except UnicodeDecodeError:
        raise InputError(path, 'expected a CSV file, found bytes that are no text') from None
    rows = [(n, line) for n, line in enumerate(text.splitlines(), 1) if line.strip()]
    if not rows:
        raise InputError(path, f'expected the header {_headers(layouts)}, found an empty file')
    names, layout = _header(path, *rows[0], layouts)
    if len(rows) == 1:
        raise InputError(path, 'expected rows below the header, found none', rows[0][0])
    cells = [line.split(',') for _, line in rows[1:]]
    for (number, _), row in zip(rows[1:], cells, strict=True):
        if len(row) != len(names):
            hint = '; the decimal sign must be a point' if len(row) > len(names) else ''
            expected = f'expected {len(names)} values separated by commas, found {len(row)}{hint}'
            raise InputError(path, expected, number)
    lines = np.array([number for number, _ in rows[1:]])
    columns = {
        name: _column(path, name, texts, lines, name in layout.optional)
        for name, texts in zip(names, zip(*cells, strict=True), strict=True)
        if name not in layout.ignored
    }
    return Table(path, layout, columns, lines)


def write_table(path: Path, columns: dict[str, np.ndarray]) -> None:
    """Write `columns` in SI as a CSV file `path` in the units of their names; NaN is empty.

    Parameters
    ----------
    path : Path
        File or folder.
    columns : dict of str to ndarray
        Values in SI by name.
    """
    texts = [[to_text(value, name) for value in columns[name].tolist()] for name in columns]
    rows = (','.join(row) for row in zip(*texts, strict=True))
    path.write_text('\n'.join([','.join(columns), *rows, '']), encoding='utf-8')


def to_text(value: float, name: str) -> str:
    """Return an SI `value` as decimal text in the unit of its `name`; '' for NaN, else exact.

    Parameters
    ----------
    value : float
        Value in SI.
    name : str
        Name of the column.

    Returns
    -------
    str
        The text.
    """
    if math.isnan(value):
        return ''
    if isinstance(value, int):
        return str(value)
    return format(exact_display(name, value).normalize(), 'f')


def _headers(layouts: Sequence[Layout]) -> str:
    return ' or '.join(','.join(layout.required) for layout in layouts)


def _header(
    path: Path, line: int, text: str, layouts: Sequence[Layout],
) -> tuple[list[str], Layout]:
    if ';' in text or '\t' in text:
        raise InputError(path, 'expected columns separated by commas', line)
    names = [name.strip() for name in text.split(',')]
    for layout in layouts:
        known = {*layout.required, *layout.optional, *layout.ignored}
        if set(layout.required) <= set(names) <= known and len(set(names)) == len(names):
            return names, layout
    optional = sorted({name for layout in layouts for name in layout.optional})
    hint = f' and optionally {", ".join(optional)}' if optional else ''
    missing = min(([name for name in layout.required if name not in names] for layout in layouts),
                  key=len)
    lack = f'; missing: {", ".join(missing)}' if missing else ''
    raise InputError(path, f'expected the header {_headers(layouts)}{hint}, '
                     f'found {clipped(text.strip())}{lack}', line)


def _column(
    path: Path, name: str, texts: Sequence[str], lines: np.ndarray, optional: bool,
) -> np.ndarray:
    values = []
    for line, cell in zip(lines, texts, strict=True):
        value = _number(cell.strip(), name)
        if not math.isfinite(value) and not (optional and not cell.strip()):
            found = f"'{clipped(cell.strip())}'" if cell.strip() else 'an empty cell'
            raise InputError(path, f"expected a number in '{name}', found {found}", int(line))
        values.append(value)
    column = np.array(values, dtype=float)
    wrong = implausible(name, from_si(name, column)) & np.isfinite(column)
    if wrong.any():
        first = int(np.argmax(wrong))
        raise InputError(path, f"{expected_range(name)} in '{name}', found "
                               f"'{clipped(texts[first].strip())}'", int(lines[first]))
    return column


def _number(cell: str, name: str) -> float:
    """Return the SI value of decimal text in the unit of its name; NaN if it is not a number."""
    if '_' in cell:  # digit separators of Python, which are no number elsewhere
        return math.nan
    try:
        return exact_si(name, cell)
    except (ArithmeticError, ValueError):
        return math.nan
