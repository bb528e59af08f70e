"""Commands in the sheets of a laboratory."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from microbot_ros.common.errors import InputError
from microbot_ros.common.records import Commands, Tracks
from microbot_ros.common.units import to_si
from microbot_ros.session.mcap.from_recording import changes
from microbot_ros.session.spreadsheets.angles import agreement, angles, settle_angles
from microbot_ros.session.spreadsheets.columns import Column
from microbot_ros.session.spreadsheets.row_times import (
    RowTimes,
    clock_of,
    joined_row_times,
    own_row_times,
)
from microbot_ros.session.spreadsheets.scale import Part
from microbot_ros.session.spreadsheets.sheets import Answers, Assumptions, Sheet
from microbot_ros.session.tables.folder import NOMINAL_FIELD

_GAUSS = 1e-4  # teslas
_LEAST_SHARE = 0.05
"""Choice: fields without a unit are shares of full scale if they reach this, but not more than 1.

0.05 of a unit would be a weak field in mT or G and a strong one in T.
"""
_FOLLOWS, _CLEARLY_LESS = 0.7, 0.8
"""Choices: share of the path that must follow the commands if it alone ties two sheets, and share
of that above which the other way to tie them is as good."""
_MOST_DIFFERENT = 0.2
"""Choice: share of rows in which tables of robots filmed together may differ in a command.

They are written a frame apart, while commands change.
"""
_UNRECORDED = 1.0
"""Choice: time [s] from the last row of commands to the end of the tracks that is noted."""
_UPRIGHT = np.radians(1.0)
"""Choice: tilts that differ by less [rad] are the same axis; boards write 1.570796."""


def commands_in(columns: Sequence[Column]) -> bool:
    """Return whether `columns` hold commands.

    Parameters
    ----------
    columns : sequence of Column
        Columns of the sheet.

    Returns
    -------
    bool
        Whether these columns hold commands.
    """
    roles = {column.role for column in columns}
    return 'direction' in roles or {'bx', 'by'} <= roles


def find_commands(
    parts: Sequence[Part], robots: Sequence[Part], timelines: list[RowTimes], tracks: Tracks,
    answers: Answers, said: Assumptions,
) -> Commands:
    """Return the commands of the sheets in `parts`, in workspace angles, on the robots' clock.

    `timelines` are the times of the `robots`' rows, `tracks` their motion, `answers` the user's
    options; `said` collects assumptions. Raises InputError naming the option that answers an open
    question.

    Parameters
    ----------
    parts : sequence of Part
        The sheets with their columns.
    robots : sequence of Part
        Sheets of the robots.
    timelines : list of RowTimes
        Times of the rows of each robot.
    tracks : Tracks
        The tracks.
    answers : Answers
        Answers of the user.
    said : Assumptions
        Collects assumptions.

    Returns
    -------
    Commands
        The commands.
    """
    chosen = [part for part in parts if commands_in(part[1])]
    if not chosen:
        said.add('no commands')
        return Commands(np.empty(0), np.empty((0, 2)))
    # A sheet with commands only takes precedence over columns repeated in tables of robots.
    alone = [part for part in chosen if part not in robots]
    if len(alone) > 1:
        raise InputError(alone[1][0].place, 'expected one table of commands, found a second '
                         f'beside {alone[0][0].name}: keep the one that belongs to these robots')
    if not alone:
        _refuse_different(chosen, timelines)
    sheet, columns = (alone or chosen)[0]
    own = next((line for line in timelines if line.sheet is sheet), None)
    if own is None and any(column.role == 'time' for column in columns):
        own = own_row_times(sheet, columns, answers, said)
    field, frequency = _field(sheet, columns, answers, said)
    if own is None:
        try:
            own = joined_row_times(sheet, columns, timelines, said)
        except InputError:
            own = _beside_the_motion(sheet, timelines, field, frequency, tracks, said)
            if own is None:
                raise
    tilt = None if frequency is None else _tilt(sheet, columns, answers, said)
    state = np.column_stack([
        field, *(column for column in (frequency, tilt) if column is not None)])
    known = np.isfinite(state).all(axis=1) & np.isfinite(own.t)
    t, first = np.unique(own.t[known], return_index=True)
    if not len(t):
        raise InputError(sheet.place, 'expected commands, found none')
    after = float(tracks.t[-1] - own.t[known].max())
    if after > _UNRECORDED:
        said.add(f'{sheet.name}: ends {after:.1f} s before the tracks; the last command is held')
    commands = changes(t, field[known][first], *(
        None if column is None else column[known][first] for column in (frequency, tilt)))
    axis = {'tilt', 'cone'} <= {column.role for column in columns}
    return settle_angles(commands, tracks, answers, said, sheet.place, axis)


def _refuse_different(chosen: Sequence[Part], timelines: Sequence[RowTimes]) -> None:
    """Raise InputError if robots have tables with different commands at the same times."""
    times = {id(line.sheet): line.t for line in timelines}
    (first, columns), *others = chosen
    for sheet, own in others:
        t = times[id(sheet)]
        row = np.searchsorted(times[id(first)], t, side='right') - 1
        both = (row >= 0) & (t <= times[id(first)][-1])
        for role in ('direction', 'frequency', 'bx', 'by'):
            a, b = (next((c.index for c in of if c.role == role), None) for of in (columns, own))
            if a is None or b is None or not both.any():
                continue
            differ = first.witness(a)[row[both]] != sheet.witness(b)[both]
            if differ.mean() > _MOST_DIFFERENT:
                raise InputError(sheet.place, f"expected '{sheet.names[b]}' as in {first.name} at "
                                              'the same times; import recordings one by one')


def _beside_the_motion(
    sheet: Sheet, timelines: list[RowTimes], field: np.ndarray, frequency: np.ndarray | None,
    tracks: Tracks, said: Assumptions,
) -> RowTimes | None:
    """Return times of a sheet aligned to the robots' first or last row by the motion, or None."""
    clock = clock_of(timelines)
    rows, step = len(sheet.rows), float(np.median(np.diff(clock.t))) if len(clock.t) > 1 else 0.0
    if not step > 0 or rows < 2:
        return None
    index = np.arange(rows)
    z = np.nan_to_num(field) @ np.array([1, 1j])
    if frequency is not None:
        z = np.where(np.nan_to_num(frequency) != 0, z, 0)
    found = {}
    for what, first in (('begin', 0), ('end', len(clock.t) - rows)):
        place = index + first
        inside = np.clip(place, 0, len(clock.t) - 1)
        t = clock.t[inside] + (place - inside) * step
        found[what] = t, max(abs(agreement(tracks, t, one)) for one in (z, z.conj()))
    best, other = sorted(found, key=lambda what: -found[what][1])
    if found[best][1] < _FOLLOWS or found[other][1] > _CLEARLY_LESS * found[best][1]:
        return None
    said.add(f'{sheet.name}: frames are counted differently from {clock.sheet.name}; the two '
             f'{best} together, as the motion follows the commands then')
    return RowTimes(sheet, found[best][0], None, False)


def _field(
    sheet: Sheet, columns: Sequence[Column], answers: Answers, said: Assumptions,
) -> tuple[np.ndarray, np.ndarray | None]:
    """Return the field (n, 2) [T] and its frequency (n,) [Hz], None if it does not rotate."""
    by_role = {column.role: column for column in columns}
    rotation = sheet.numbers(by_role['frequency'].index) if 'frequency' in by_role else None
    rolls = rotation is not None and np.nansum(np.abs(rotation)) > 0
    components = np.zeros((len(sheet.rows), 2))
    if {'bx', 'by'} <= by_role.keys():
        components = np.column_stack(
            [sheet.numbers(by_role[role].index) for role in ('bx', 'by')])
    pulled = _other_drives(sheet, by_role, said)
    components[pulled] = 0
    if rotation is not None:
        rotation = np.where(pulled, 0, rotation)
    acts = np.nan_to_num(components).any(axis=1)
    if 'direction' in by_role and (rolls or not acts.any()):
        angle = angles(sheet, by_role['direction'], columns, answers, said)
        if rotation is not None:  # a field that does not turn needs no direction
            angle = np.where(rotation == 0, np.nan_to_num(angle), angle)
        if rotation is None:
            said.add(f'the field is taken as {NOMINAL_FIELD * 1e3:g} mT: the table states only '
                     'its direction')
        elif not rolls:
            said.add(f'{sheet.name}: no rotation and no field in any row')
        elif acts.any():
            said.add(f'{sheet.name}: {int(acts.sum())} rows have a field beside the rotation; '
                     'left out')
        return NOMINAL_FIELD * np.column_stack([np.cos(angle), np.sin(angle)]), rotation
    return _teslas(sheet, by_role['bx'], components, answers, said) * components, None


def _other_drives(sheet: Sheet, by_role: dict[str, Column], said: Assumptions) -> np.ndarray:
    """Return the rows (n,) in which coils make a gradient, and note drives that are no field."""
    on = {role: np.nan_to_num(sheet.witness(by_role[role].index)) != 0 if role in by_role
          else np.zeros(len(sheet.rows), bool) for role in ('gradient', 'sound')}
    if on['gradient'].any():
        said.add(f'{sheet.name}: coils make a gradient in {int(on["gradient"].sum())} of '
                 f'{len(sheet.rows)} rows; no field is imported there')
    if on['sound'].any():
        said.add(f"{sheet.name}, '{sheet.names[by_role['sound'].index]}': sound drives the robots "
                 f'in {int(on["sound"].sum())} of {len(sheet.rows)} rows; not imported')
    return on['gradient']


def _teslas(sheet: Sheet, bx: Column, components: np.ndarray, answers: Answers,
            said: Assumptions) -> float:
    """Return teslas per unit of the field's `components` (n, 2)."""
    unit, name = answers.field_unit or bx.unit, sheet.names[bx.index]
    largest = float(np.nanmax(np.abs(components), initial=0.0))
    if not unit and largest == 0:
        return 1.0
    if not unit and _LEAST_SHARE < largest <= 1:
        unit = '_fraction'
        said.add(f"{sheet.name}, '{name}': shares of full scale, since fields reach "
                 f'{largest:.3g} and name no unit')
    if not unit:
        raise InputError(sheet.place, f"expected --field-unit mT, T, G or fraction: '{name}' "
                                      'names no unit')
    if unit != '_fraction':
        return _GAUSS if unit == '_G' else to_si(unit, 1.0)
    if largest > 1:
        raise InputError(sheet.place, "expected shares of full scale from −1 to 1 in "
                                      f"'{name}', found {largest:.4g}")
    if answers.full_scale is None:
        said.add(f'full scale is taken as {NOMINAL_FIELD * 1e3:g} mT; set it by --full-scale-mT')
    return answers.full_scale or NOMINAL_FIELD


def _tilt(sheet: Sheet, columns: Sequence[Column], answers: Answers, said: Assumptions,
          ) -> np.ndarray | None:
    """Return the angle (n,) [rad] of the rotation axis from the vertical, None if never tilted."""
    column = next((column for column in columns if column.role == 'tilt'), None)
    if column is None:
        return None
    tilt = angles(sheet, column, columns, answers, Assumptions())
    off = np.abs(tilt - np.pi / 2) > _UPRIGHT
    if not off.any() or np.isnan(tilt).all():
        return None
    said.add(f"{sheet.name}, '{sheet.names[column.index]}': the axis of rotation leaves the plane "
             f'in {int(off.sum())} rows; kept as tilt_rad')
    return np.where(np.isnan(tilt), np.pi / 2, tilt)
