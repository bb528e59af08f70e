"""A session from the sheets of a laboratory, with the assumptions made."""

from __future__ import annotations

import math
import re
from itertools import pairwise
from pathlib import Path

import numpy as np

from microbot_ros.common.errors import InputError, known
from microbot_ros.common.records import Conditions, Session, Tracks
from microbot_ros.session.spreadsheets.angles import angles
from microbot_ros.session.spreadsheets.columns import Column, find_columns
from microbot_ros.session.spreadsheets.commands import commands_in, find_commands
from microbot_ros.session.spreadsheets.identities import settle_identities
from microbot_ros.session.spreadsheets.row_times import RowTimes, aligned, row_times
from microbot_ros.session.spreadsheets.scale import Scale, settle_scale
from microbot_ros.session.spreadsheets.sheets import Answers, Assumptions, Sheet, read_sheets
from microbot_ros.session.spreadsheets.summary import SummaryError, summary_of
from microbot_ros.session.tables.plausibility import check_session


def import_session(path: Path, answers: Answers) -> tuple[Session, list[str]]:
    """Import the spreadsheet, text file or folder of such files `path`, and list assumptions.

    Robots may share a sheet (a column of identities, or columns numbered by robot) or have a sheet
    each; commands may be in the same sheets or in their own. `answers` are the user's options.
    Raises InputError naming the option that answers an open question, or the cell that is wrong;
    SummaryError if the file holds averages.

    Parameters
    ----------
    path : Path
        File or folder.
    answers : Answers
        Answers of the user.

    Returns
    -------
    tuple[Session, list of str]
        The session and the assumptions.
    """
    sheets, told = read_sheets(path)
    said = Assumptions(told)
    for role, name in answers.columns.items():
        if not any(name in sheet.names for sheet in sheets):
            there = {one for sheet in sheets for one in sheet.names if one}
            raise InputError(path, f"expected a column '{name}' (--column {role}), found none; "
                                   f'{known(there, name)}')
    parts = [(sheet, find_columns(sheet, answers.columns)) for sheet in sheets]
    robots = [part for part in parts if {'x', 'y'} <= {column.role for column in part[1]}]
    if not robots and (summary := summary_of(parts)):
        raise SummaryError(path, summary)
    if not robots:
        names = '; '.join(', '.join(filter(None, sheet.names)) for sheet in sheets)
        raise InputError(path, f'expected columns for x and y, found {names[:160]}; name them by '
                               '--column x=NAME --column y=NAME')
    timed = [part for part in robots if {'time', 'frame'} & {column.role for column in part[1]}]
    if not timed:
        raise InputError(robots[0][0].place, 'expected a column of times or frames; name it by '
                                             '--column time=NAME')
    robots = timed  # of the others it is said below that they are left out
    timelines = row_times(robots, answers, said)
    scale = settle_scale(path, robots, timelines, answers, said)
    timelines = aligned(timelines, said)
    pieces = [
        _pieces(sheet, columns, timeline, place, scale, answers, said)
        for place, ((sheet, columns), timeline)
        in enumerate(zip(robots, timelines, strict=True))
    ]
    seen = _without_gaps([piece for group in pieces for piece in group], path, said)
    tracks = _tracks(settle_identities(seen, said), path)
    commands = find_commands(parts, robots, timelines, tracks, answers, said)
    conditions = Conditions(
        'rolling' if commands.frequency is not None else 'catalytic',
        pixel_size=scale.pixel_size, frame_rate=_frame_rate(tracks, answers),
    )
    used = {id(sheet) for sheet, columns in parts if commands_in(columns)}
    used |= {id(sheet) for sheet, _ in robots}
    for sheet in sheets:
        if id(sheet) not in used:
            said.add(f'{sheet.name}: holds neither positions at times nor commands; left out')
    session = Session(tracks, commands, conditions, path.stem, assumed=tuple(said),
                      speed_window=scale.window)
    check_session(path, session)
    return session, said


def _pieces(
    sheet: Sheet, columns: list[Column], timeline: RowTimes, place: int, scale: Scale,
    answers: Answers, said: Assumptions,
) -> list[Tracks]:
    """Return the tracks of one sheet, a piece per pair of x and y columns and stretch."""
    particle = next((column for column in columns if column.role == 'particle'), None)
    t, pieces = timeline.t, []
    for x in (column for column in columns if column.role == 'x'):
        y, theta = (next(
            (c for c in columns if c.role == role and c.particle == x.particle), None)
            for role in ('y', 'theta'))
        if y is None:
            raise InputError(sheet.place, f"expected a y beside '{sheet.names[x.index]}'")
        if particle is not None:
            ids = _identities(sheet, particle)
        else:
            number = re.search(r'(\d+)\s*$', sheet.name)
            alone = int(number[1]) if number else place
            ids = np.full(len(t), alone if x.particle is None else x.particle)
        heading = np.full(len(t), np.nan)
        if theta is not None:
            heading = angles(sheet, theta, columns, answers, said)
        position = _positions(sheet, x, y, scale, answers, said)
        if _points_down(answers, scale):
            heading = -heading
        for start, end in pairwise([0, *timeline.cuts, len(t)]):
            rows = slice(start, end)
            pieces.append(Tracks(t[rows], ids[rows], position[rows], heading[rows],
                                 np.full(end - start, np.nan)))
    return pieces


def _identities(sheet: Sheet, column: Column) -> np.ndarray:
    ids = sheet.numbers(column.index)
    wrong = ids != np.floor(ids)
    if wrong.any():
        line = sheet.lines[int(np.argmax(wrong))]
        raise InputError(
            sheet.place, f"expected whole numbers in '{sheet.names[column.index]}'", line)
    return ids.astype(np.int64)


def _positions(
    sheet: Sheet, x: Column, y: Column, scale: Scale, answers: Answers, said: Assumptions,
) -> np.ndarray:
    name = sheet.names[x.index]
    if scale.factor is None:
        unit = answers.position_unit or x.unit
        raise InputError(sheet.place, f"expected --pixel-size-um: '{name}' is in pixels"
                                      if unit == '_px' else
                                      'expected --position-unit um, mm, m or px (px with '
                                      f"--pixel-size-um): '{name}' names no unit")
    down = _points_down(answers, scale)
    if answers.y_axis is None:
        said.add('y points down, as in images; converted to y up' if down else 'y points up')
    columns = sheet.numbers(x.index), sheet.numbers(y.index)
    return np.column_stack(columns) * scale.factor * (1, -1 if down else 1)


def _points_down(answers: Answers, scale: Scale) -> bool:
    return answers.y_axis == 'down' or (answers.y_axis is None and scale.pixel_size is not None)


def _without_gaps(pieces: list[Tracks], path: Path, said: Assumptions) -> list[Tracks]:
    """Return the `pieces` without rows that have no position; InputError if none has."""
    result, gaps = [], 0
    for piece in pieces:
        seen = np.isfinite(piece.position).all(axis=1)
        gaps += int((~seen).sum())
        if seen.any():
            result.append(piece.rows(seen))
    if not result:
        raise InputError(path, 'expected positions, found none')
    if gaps:
        said.add(f'{gaps} rows without a position are gaps')
    return result


def _tracks(pieces: list[Tracks], path: Path) -> Tracks:
    t, ids, position, theta = (
        np.concatenate([getattr(piece, name) for piece in pieces])
        for name in ('t', 'particle', 'position', 'theta')
    )
    order = np.lexsort((ids, t))
    again = (np.diff(t[order]) == 0) & (np.diff(ids[order]) == 0)
    if again.any():
        row = order[int(np.argmax(again))]
        raise InputError(path, f'expected one row per robot and time, found several of robot '
                               f'{ids[row]} at {t[row]:g} s')
    unknown = np.full(len(order), np.nan)
    return Tracks(t[order], ids[order], position[order], theta[order], unknown)


def _frame_rate(tracks: Tracks, answers: Answers) -> float | None:
    # Robots of several sheets may have times of their own, between those of the others.
    steps = np.concatenate([np.diff(tracks.of(one).t) for one in tracks.particles])
    if answers.frame_rate or not len(steps):
        return answers.frame_rate
    rate = 1 / float(np.median(steps))
    return round(rate, 3 - math.floor(math.log10(rate)))
