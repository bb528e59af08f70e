"""Sense, unit and zero axis of a laboratory's angles."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from microbot_ros.common.errors import InputError
from microbot_ros.common.records import Commands, Tracks
from microbot_ros.session.spreadsheets.columns import Column
from microbot_ros.session.spreadsheets.sheets import Answers, Assumptions, Sheet

_CHORD_SECONDS = 0.25
"""Choice: duration of chords of motion [s], above the noise of single frames."""
_AGREEMENT = 0.2
"""Choice: share of the path that must follow the commands for any conclusion."""
_CLEARLY = 2.0
"""Choice: factor by which one sense must agree better than the other."""
_ALIKE = 0.8
"""Choice: ratio of the agreement with the mirror image from which both agree equally."""
_FEWEST_ROWS = 20
"""Choice: rows from which motion along one line is not a coincidence."""
_NEAR_90 = math.radians(12)  # choice: error of a mean direction, with room
_NEAR_90_AXIS = math.radians(30)
"""Choice: robots of unequal coils lead by ±8 to ±16° at diagonals; this still counts as 90°."""
_NEAR_180 = math.radians(30)  # choice: as wide as `_NEAR_90_AXIS`
_FULL_TURN = 2 * math.pi + 0.01  # choice: a turn, with room for rounding
_MOST_TURNS = 4
"""Choice: turns of an unwrapped angle in radians; beyond, degrees are as likely."""


def angles(sheet: Sheet, column: Column, columns: Sequence[Column], answers: Answers,
           said: Assumptions) -> np.ndarray:
    """Return a `column` of angles (n,) in radians.

    The unit is the one in `answers`, that of the column's name, that of the other `columns` of
    angles, or the one that the size of the values shows. `said` collects assumptions. Raises
    InputError if none decides.

    Parameters
    ----------
    sheet : Sheet
        The sheet.
    column : Column
        The column.
    columns : sequence of Column
        Other columns of angles.
    answers : Answers
        Answers of the user.
    said : Assumptions
        Collects assumptions.

    Returns
    -------
    ndarray, shape (n,)
        Angles [rad].
    """
    values, name = sheet.numbers(column.index), sheet.names[column.index]
    unit = answers.angle_unit or column.unit
    if not unit and not np.isfinite(values).any():
        return values
    if not unit:
        largest, span = np.nanmax(np.abs(values)), np.nanmax(values) - np.nanmin(values)
        neighbour, shown = _unit_beside(sheet, columns)
        if largest == 0:
            unit = '_rad'
        elif neighbour == '_deg' or (largest > _FULL_TURN and not neighbour):
            unit = '_deg'
            said.add(f"'{name}' is in degrees, since {shown or f'it reaches {largest:.4g}'}",
                     sheet.name)
        elif neighbour and largest <= _MOST_TURNS * _FULL_TURN:
            unit = '_rad'
            said.add(f"'{name}' is in radians, since {shown}", sheet.name)
        elif not neighbour and span > 3:
            unit = '_rad'
            said.add(f"'{name}' is in radians, since it spans {span:.3g}", sheet.name)
        else:
            raise InputError(sheet.place, 'expected --angle-unit deg or rad: '
                             + (f"'{name}' reaches {largest:.4g} though {shown}" if neighbour else
                                f"'{name}' spans {span:.3g}, which fits degrees and radians: "
                                'state its unit'))
    return np.radians(values) if unit == '_deg' else values


def _unit_beside(sheet: Sheet, columns: Sequence[Column]) -> tuple[str, str]:
    """Return the unit shown by tilt and cone angle, and a phrase with the reason; '' if none.

    These are right angles on most boards, most of the time: 1.570796 or 90.
    """
    for column in columns:
        if column.role not in ('tilt', 'cone'):
            continue
        values, name = sheet.witness(column.index), sheet.names[column.index]
        if column.unit:
            return column.unit, f"'{name}' beside it is"
        for unit, right in (('_rad', math.pi / 2), ('_deg', 90.0)):
            if (np.abs(values - right) < 1e-3 * right).any():
                return unit, f"'{name}' beside it is {right:.6g}"
    return '', ''


def settle_angles(
    commands: Commands, tracks: Tracks, answers: Answers, said: Assumptions, source: str,
    axis: bool = False,
) -> Commands:
    """Convert commands to workspace angles: counterclockwise from x, as the motion shows.

    The sense follows from whether the motion follows the angles or their mirror image. An offset
    near ±90° may be the convention of the angles or the heading offset of the robot: an InputError
    naming `source` asks for it. If the angles are those of an `axis` of rotation, as tilt and cone
    angle show, robots roll at a right angle to it and nothing is asked.

    Parameters
    ----------
    commands : Commands
        The commands.
    tracks : Tracks
        The tracks.
    answers : Answers
        Answers of the user.
    said : Assumptions
        Collects assumptions.
    source : str
        Name of the file, for messages.
    axis : bool
        Whether the angles are those of an axis of rotation.

    Returns
    -------
    Commands
        The converted commands.
    """
    z = commands.field @ np.array([1, 1j])
    if commands.frequency is not None:
        z = np.where(commands.frequency != 0, z, 0)
    same, mirrored = agreement(tracks, commands.t, z), agreement(tracks, commands.t, z.conj())
    z = commands.field @ np.array([1, 1j])
    clockwise = answers.angle_sense == 'clockwise'
    if answers.angle_sense is None:
        if abs(mirrored) > max(_AGREEMENT, _CLEARLY * abs(same)):
            clockwise = True
            said.add('angles turn clockwise, since the motion follows their mirror image; '
                     'turned over')
        elif (abs(mirrored) > max(_AGREEMENT, _ALIKE * abs(same))
              and len(tracks.t) >= _FEWEST_ROWS):
            # Motion to and fro along one line follows both.
            clockwise = _opposite(same) and not _opposite(mirrored)
            said.add('the sense of the angles is not visible, as the motion keeps to one '
                     f'line; taken as {"clockwise" if clockwise else "counterclockwise"}')
    if clockwise:
        z, same = z.conj(), mirrored
    offset = answers.angle_offset
    if offset is None:
        offset = _offset(same, axis, said, source)
    z = z * np.exp(-1j * offset)
    return Commands(commands.t, np.column_stack([z.real, z.imag]), commands.frequency,
                    commands.tilt)


def _opposite(agreement: complex) -> bool:
    return bool(abs(np.angle(agreement)) > math.pi - _NEAR_180)


def _offset(same: complex, axis: bool, said: Assumptions, source: str) -> float:
    """Return how much angles are too large [rad], from the lead of the motion over them."""
    lead = float(np.angle(same))
    if abs(same) < _AGREEMENT:
        said.add('motion and commands show no common direction; angles kept as they are')
    elif abs(abs(lead) - math.pi / 2) < (_NEAR_90_AXIS if axis else _NEAR_90):
        right = math.copysign(90, lead)
        if axis:
            said.add(f'angles are those of the axis of rotation: the motion leads them by '
                     f'{math.degrees(lead):.0f}°; {right:.0f}° added'.replace('-', '−'))
            return -math.radians(right)
        raise InputError(
            source, f'expected --angle-offset-deg: the motion leads the commands by '
                    f'{math.degrees(lead):.0f}°; {-right:.0f} if the angles count from another '
                    'axis, 0 if that is the heading of the robot')
    else:
        said.add(f'the motion leads the commands by {math.degrees(lead):.0f}°: kept, as a '
                 'property of the robot'.replace('-', '−'))
    return 0.0


def agreement(tracks: Tracks, t: np.ndarray, z: np.ndarray) -> complex:
    """Return the mean of motion over command, as far as the direction is constant.

    Its size, 0 to 1, is the share of the path of the `tracks` that keeps one angle to the commands
    `z` (K,), complex, given at `t` (K,) [s]; its phase is that angle [rad].

    Parameters
    ----------
    tracks : Tracks
        The tracks.
    t : ndarray, shape (K,)
        Times [s].
    z : ndarray, shape (K,)
        Commands, complex.

    Returns
    -------
    complex
        The mean, complex.
    """
    unit = np.divide(z, np.abs(z), out=np.zeros_like(z), where=z != 0)
    along, path = 0j, 0.0
    for particle in tracks.particles:
        own = tracks.of(particle)
        steps = np.diff(own.t)
        if not len(steps):
            continue
        chord = max(1, round(_CHORD_SECONDS / float(np.median(steps))))
        p = own.position @ np.array([1, 1j])
        moved, middle = p[chord:] - p[:-chord], (own.t[chord:] + own.t[:-chord]) / 2
        index = np.searchsorted(t, middle, side='right') - 1
        command = np.where(index >= 0, unit[np.maximum(index, 0)], 0)
        along += (moved * command.conj())[command != 0].sum()
        path += np.abs(moved)[command != 0].sum()
    return along / path if path else 0j
