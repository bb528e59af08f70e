"""CSV tables of numbers written by people: a header, columns in any order."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from microbot_ros.common.errors import InputError


def read_table(
    path: str | Path, needed: Sequence[str], optional: Sequence[str] = (),
) -> tuple[dict[str, np.ndarray], list[int]]:
    """Read a CSV file of numbers with a header.

    Parameters
    ----------
    path : str or Path
        CSV file to read.
    needed, optional : sequence of str
        Names of columns that must and that may be there.

    Returns
    -------
    dict, list of int
        Columns (K,) by name, and the line of the file on which each row ends.

    Raises
    ------
    InputError
        Naming file, line and column: for an unreadable file, other columns, values that are not
        finite numbers, and a file without rows.
    """
    try:
        text = Path(path).read_text(encoding='utf-8-sig').splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(path, f'expected a readable CSV file ({error})') from None
    rows = csv.reader(text)
    header = [name.strip() for name in next(rows, [])]
    if sorted(header) != sorted({*needed, *(name for name in header if name in optional)}):
        known = f' and, if known, {",".join(optional)}' if optional else ''
        raise InputError(path, f'expected the columns {",".join(needed)}{known}; '
                         f'found {",".join(header) or "none"}', 1)
    lines, values = [], []
    for row in rows:
        if row:
            lines.append(rows.line_num)
            values.append(_numbers(path, rows.line_num, header, row))
    if not values:
        raise InputError(path, 'expected rows of numbers below the header', 1)
    return dict(zip(header, np.array(values).T, strict=True)), lines


def _numbers(path: str | Path, line: int, header: list[str], row: list[str]) -> list[float]:
    if len(row) != len(header):
        raise InputError(path, f'expected {len(header)} values, found {len(row)}', line)
    for name, text in zip(header, row, strict=True):
        try:
            finite = math.isfinite(float(text))
        except ValueError:
            finite = False
        if not finite:
            raise InputError(path, f'expected a finite number in {name}, found {text!r}', line)
    return [float(text) for text in row]
