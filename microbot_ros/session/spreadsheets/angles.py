"""Which way a laboratory's angles turn, in what unit, and from which axis they count."""

from __future__ import annotations

import math

import numpy as np

from microbot_ros.errors import InputError
from microbot_ros.records import Commands, Tracks
from microbot_ros.session.spreadsheets.columns import Column
from microbot_ros.session.spreadsheets.sheets import Answers, Assumptions, Sheet

_CHORD_SECONDS = 0.25
"""Motion is judged over chords this long, to rise above the noise of single frames."""
_AGREEMENT = 0.2
"""Share of the path that must follow the commands before anything is concluded."""
_CLEARLY = 2.0
"""How many times better one sense must agree than the other."""
_NEAR_90 = math.radians(12)


def angles(sheet: Sheet, column: Column, answers: Answers, said: Assumptions) -> np.ndarray:
    """A column of angles (n,) in radians, by their unit, or by their size where none is told."""
    values, name = sheet.numbers(column.index), sheet.names[column.index]
    unit = answers.angle_unit or column.unit
    if not unit:
        largest, span = np.nanmax(np.abs(values)), np.nanmax(values) - np.nanmin(values)
        if largest > 2 * math.pi + 0.01:
            unit = '_deg'
            said.add(f"{sheet.name}, '{name}': in degrees, since it reaches {largest:.4g}")
        elif span > 3:
            unit = '_rad'
            said.add(f"{sheet.name}, '{name}': in radians, since it spans {span:.3g}")
        else:
            raise InputError(sheet.place, 'expected --angle-unit deg or rad: a span of '
                                          f"{span:.3g} in '{name}' could be either")
    return np.radians(values) if unit == '_deg' else values


def settle_angles(
    commands: Commands, tracks: Tracks, answers: Answers, said: Assumptions, source: str,
) -> Commands:
    """Commands in the workspace's angles: counterclockwise from x, as the motion shows.

    The sense of turning shows in whether the motion follows the angles or their mirror image. An
    offset near ±90° may be the convention of the angles or the heading offset of the robot: that
    is asked for, by an InputError that names `source`.
    """
    z = commands.field @ np.array([1, 1j])
    same, mirrored = _agreement(tracks, commands.t, z), _agreement(tracks, commands.t, z.conj())
    clockwise = answers.angle_sense == 'clockwise'
    if answers.angle_sense is None and abs(mirrored) > max(_AGREEMENT, _CLEARLY * abs(same)):
        clockwise = True
        said.add('angles turn clockwise, since the motion follows their mirror image; turned over')
    if clockwise:
        z, same = z.conj(), mirrored
    offset = answers.angle_offset
    if offset is None:
        offset = 0.0
        lead = math.degrees(np.angle(same))
        if abs(same) < _AGREEMENT:
            said.add('motion and commands show no common direction; angles kept as they are')
        elif abs(abs(np.angle(same)) - math.pi / 2) < _NEAR_90:
            raise InputError(
                source, f'expected --angle-offset-deg: the motion leads the commands by '
                        f'{lead:.0f}°; {-round(lead / 90) * 90} if the angles count from another '
                        'axis, 0 if that is the heading of the robot')
        else:
            said.add(f'the motion leads the commands by {lead:.0f}°: kept, as the robot’s own')
    z = z * np.exp(-1j * offset)
    return Commands(commands.t, np.column_stack([z.real, z.imag]), commands.frequency)


def _agreement(tracks: Tracks, t: np.ndarray, z: np.ndarray) -> complex:
    """Mean of motion over command, as far as it goes one way: its size from 0 to 1 is the share
    of the path that keeps one angle to the commands, its phase that angle [rad]."""
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
