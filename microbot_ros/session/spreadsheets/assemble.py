"""A session out of the sheets of a laboratory, saying what was assumed on the way."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np

from microbot_ros.errors import InputError
from microbot_ros.records import Commands, Conditions, Session, Tracks
from microbot_ros.session.folder import NOMINAL_FIELD
from microbot_ros.session.from_recording import changes
from microbot_ros.session.plausibility import check_session
from microbot_ros.session.spreadsheets.angles import angles, settle_angles
from microbot_ros.session.spreadsheets.columns import Column, find_columns
from microbot_ros.session.spreadsheets.row_times import (
    RowTimes,
    aligned,
    joined_row_times,
    own_row_times,
)
from microbot_ros.session.spreadsheets.sheets import Answers, Assumptions, Sheet, read_sheets
from microbot_ros.units import to_si

_GAUSS = 1e-4
Part = tuple[Sheet, list[Column]]


def import_session(path: Path, answers: Answers) -> tuple[Session, list[str]]:
    """A session from a spreadsheet, a delimited text file or a folder of such files, and the
    assumptions made.

    Robots may share a sheet (a column of identities, or columns numbered by robot) or have a
    sheet each; commands may stand beside them or in a sheet of their own. InputError names the
    option that answers what the file leaves open, or the cell that is wrong.
    """
    sheets, told = read_sheets(path)
    said = Assumptions(told)
    parts = [(sheet, find_columns(sheet, answers.columns)) for sheet in sheets]
    robots = [part for part in parts if {'x', 'y'} <= {column.role for column in part[1]}]
    if not robots:
        names = '; '.join(', '.join(filter(None, sheet.names)) for sheet in sheets)
        raise InputError(path, f'expected columns for x and y, found {names[:160]}; name them by '
                               '--column x=NAME --column y=NAME')
    timelines = []
    for sheet, columns in robots:
        timeline = own_row_times(sheet, columns, answers, said)
        if timeline is None:
            raise InputError(sheet.place, 'expected a column of times or frames; name it by '
                                          '--column time=NAME')
        timelines.append(timeline)
    timelines = aligned(timelines, said)
    pieces = [
        _pieces(sheet, columns, timeline.t, place, answers, said)
        for place, ((sheet, columns), timeline)
        in enumerate(zip(robots, timelines, strict=True))
    ]
    tracks = _tracks([piece for group in pieces for piece in group], path, said)
    commands = _find_commands(parts, robots, timelines, tracks, answers, said)
    conditions = Conditions(
        'rolling' if commands.frequency is not None else 'catalytic',
        pixel_size=answers.pixel_size, frame_rate=_frame_rate(tracks, answers),
    )
    used = {id(sheet) for sheet, columns in parts if _commands_in(columns)}
    used |= {id(sheet) for sheet, _ in robots}
    for sheet in sheets:
        if id(sheet) not in used:
            said.add(f'{sheet.name}: holds neither positions nor commands; left out')
    session = Session(tracks, commands, conditions, path.stem)
    check_session(path, session)
    return session, said


def _pieces(
    sheet: Sheet, columns: list[Column], t: np.ndarray, place: int, answers: Answers,
    said: Assumptions,
) -> list[Tracks]:
    """The tracks of one sheet, one piece per pair of x and y columns."""
    particle = next((column for column in columns if column.role == 'particle'), None)
    pieces = []
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
            heading = angles(sheet, theta, answers, said)
        position = _positions(sheet, x, y, answers, said)
        if _points_down(x, answers):
            heading = -heading
        pieces.append(Tracks(t, ids, position, heading, np.full(len(t), np.nan)))
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
    sheet: Sheet, x: Column, y: Column, answers: Answers, said: Assumptions,
) -> np.ndarray:
    unit = answers.position_unit or x.unit or ('_px' if answers.pixel_size else '')
    name = f"{sheet.name}, '{sheet.names[x.index]}'"
    if not unit:
        raise InputError(sheet.place, f"expected --position-unit um, mm, m or px (px with "
                                      f"--pixel-size-um): '{sheet.names[x.index]}' names no unit")
    if unit == '_px' and answers.pixel_size is None:
        raise InputError(sheet.place, f'expected --pixel-size-um: {name} is in pixels')
    if not x.unit and not answers.position_unit:
        said.add('positions are in pixels, since a pixel size is given')
    scale = answers.pixel_size if unit == '_px' else to_si(unit, 1.0)
    assert scale is not None
    down = _points_down(x, answers)
    if answers.y_axis is None:
        said.add('y points down, as in pictures; turned up' if down else 'y points up')
    columns = sheet.numbers(x.index), sheet.numbers(y.index)
    return np.column_stack(columns) * scale * (1, -1 if down else 1)


def _points_down(x: Column, answers: Answers) -> bool:
    pixels = (answers.position_unit or x.unit or ('_px' if answers.pixel_size else '')) == '_px'
    return answers.y_axis == 'down' or (answers.y_axis is None and pixels)


def _tracks(pieces: list[Tracks], path: Path, said: Assumptions) -> Tracks:
    t, ids, position, theta = (
        np.concatenate([getattr(piece, name) for piece in pieces])
        for name in ('t', 'particle', 'position', 'theta')
    )
    seen = np.isfinite(position).all(axis=1)
    if not seen.any():
        raise InputError(path, 'expected positions, found none')
    if not seen.all():
        said.add(f'{int((~seen).sum())} rows without a position are gaps')
    order = np.lexsort((ids, t))
    order = order[seen[order]]
    again = (np.diff(t[order]) == 0) & (np.diff(ids[order]) == 0)
    if again.any():
        row = order[int(np.argmax(again))]
        raise InputError(path, f'expected one row per robot and time, found several of robot '
                               f'{ids[row]} at {t[row]:g} s')
    unknown = np.full(len(order), np.nan)
    return Tracks(t[order], ids[order], position[order], theta[order], unknown)


def _commands_in(columns: list[Column]) -> bool:
    roles = {column.role for column in columns}
    return 'direction' in roles or {'bx', 'by'} <= roles


def _find_commands(
    parts: list[Part], robots: list[Part], timelines: list[RowTimes], tracks: Tracks,
    answers: Answers, said: Assumptions,
) -> Commands:
    chosen = [part for part in parts if _commands_in(part[1])]
    if not chosen:
        said.add('no commands')
        return Commands(np.empty(0), np.empty((0, 2)))
    # A sheet of commands alone comes before the columns that tables of robots repeat.
    sheet, columns = next((part for part in chosen if part not in robots), chosen[0])
    own = next((line for line in timelines if line.sheet is sheet), None)
    if own is None and any(column.role == 'time' for column in columns):
        own = own_row_times(sheet, columns, answers, said)
    own = own or joined_row_times(sheet, columns, timelines, said)
    field, frequency = _field(sheet, columns, answers, said)
    state = field if frequency is None else np.column_stack([field, frequency])
    known = np.isfinite(state).all(axis=1) & np.isfinite(own.t)
    t, first = np.unique(own.t[known], return_index=True)
    if not len(t):
        raise InputError(sheet.place, 'expected commands, found none')
    commands = changes(
        t, field[known][first], None if frequency is None else frequency[known][first])
    return settle_angles(commands, tracks, answers, said, sheet.place)


def _field(
    sheet: Sheet, columns: list[Column], answers: Answers, said: Assumptions,
) -> tuple[np.ndarray, np.ndarray | None]:
    by_role = {column.role: column for column in columns}
    rotation = sheet.numbers(by_role['frequency'].index) if 'frequency' in by_role else None
    rolls = rotation is not None and np.nansum(np.abs(rotation)) > 0
    if 'direction' in by_role and (rolls or 'bx' not in by_role):
        angle = angles(sheet, by_role['direction'], answers, said)
        if rotation is None:
            said.add(f'the field has {NOMINAL_FIELD * 1e3:g} mT, since only its direction is told')
        return NOMINAL_FIELD * np.column_stack([np.cos(angle), np.sin(angle)]), rotation
    unit = answers.field_unit or by_role['bx'].unit
    if not unit:
        raise InputError(sheet.place, f"expected --field-unit mT, T or G: "
                                      f"'{sheet.names[by_role['bx'].index]}' names none")
    scale = _GAUSS if unit == '_G' else to_si(unit, 1.0)
    components = [sheet.numbers(by_role[role].index) for role in ('bx', 'by')]
    return scale * np.column_stack(components), None


def _frame_rate(tracks: Tracks, answers: Answers) -> float | None:
    steps = np.diff(np.unique(tracks.t))
    if answers.frame_rate or not len(steps):
        return answers.frame_rate
    rate = 1 / float(np.median(steps))
    return round(rate, 3 - math.floor(math.log10(rate)))
