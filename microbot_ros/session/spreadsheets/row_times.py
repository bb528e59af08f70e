"""When each row of a sheet was: moments, intervals, frames, or another sheet's rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from microbot_ros.errors import InputError
from microbot_ros.session.spreadsheets.columns import Column
from microbot_ros.session.spreadsheets.sheets import Answers, Assumptions, Sheet
from microbot_ros.units import to_si

_STEADY = 20.0
"""Intervals of a camera stay below this many of their medians; moments do not."""
_LONGEST_STEP = 2.0
"""A step above this is as likely in milliseconds as in seconds."""


@dataclass(frozen=True)
class RowTimes:
    """The times `t` (n,) [s] of the rows of a sheet, and their frame numbers where it has them.

    `intervals`: the sheet told how long each row lasted, not when it was.
    """

    sheet: Sheet
    t: np.ndarray
    frames: np.ndarray | None
    intervals: bool


def own_row_times(
    sheet: Sheet, columns: Sequence[Column], answers: Answers, said: Assumptions,
) -> RowTimes | None:
    """The times that a sheet states itself; None where it states none."""
    by_role = {column.role: column for column in columns}
    frames = sheet.numbers(by_role['frame'].index) if 'frame' in by_role else None
    if 'time' in by_role:
        column = by_role['time']
        values = sheet.numbers(column.index)
        if np.isnan(values).any():
            name, row = sheet.names[column.index], int(np.argmax(np.isnan(values)))
            raise InputError(sheet.place, f"expected a time in '{name}'", sheet.lines[row])
        intervals = _are_intervals(sheet, column, values, 'particle' in by_role, answers, said)
        steps = values if intervals else np.diff(np.unique(values))
        factor = _seconds_per_unit(sheet, column, steps, answers, said)
        t = np.cumsum(values) if intervals else values
        return RowTimes(sheet, t * factor, frames, intervals)
    if frames is None:
        return None
    if answers.frame_rate is None:
        raise InputError(sheet.place, 'expected --frame-rate-hz: there are frames and no times')
    return RowTimes(sheet, frames / answers.frame_rate, frames, False)


def joined_row_times(sheet: Sheet, columns: Sequence[Column], others: list[RowTimes],
                    said: Assumptions) -> RowTimes:
    """The times of a sheet that has none of its own, or only frames, from its neighbours'."""
    longest = max(others, key=lambda other: len(other.t))
    if len(sheet.rows) == len(longest.t):
        said.add(f'{sheet.name}: row by row beside {longest.sheet.name}')
        return RowTimes(sheet, longest.t, None, False)
    frame = next((column for column in columns if column.role == 'frame'), None)
    if frame is None or longest.frames is None:
        raise InputError(
            sheet.place, f'expected times, frames, or the {len(longest.t)} rows of '
                         f'{longest.sheet.name}; found {len(sheet.rows)} rows')
    frames = sheet.numbers(frame.index)
    known, first = np.unique(longest.frames, return_index=True)
    said.add(f'{sheet.name}: beside {longest.sheet.name} by frame')
    inside = (known[0] <= frames) & (frames <= known[-1])
    if not inside.any():
        raise InputError(sheet.place, f'expected frames {known[0]:g} to {known[-1]:g}')
    t = np.interp(frames, known, longest.t[first])
    return RowTimes(sheet, np.where(inside, t, np.nan), frames, False)


def aligned(timelines: list[RowTimes], said: Assumptions) -> list[RowTimes]:
    """Timelines of robots filmed together on one clock: where times are sums of intervals, every
    sheet runs row by row along the longest, from the frame where it begins."""
    if not all(timeline.intervals for timeline in timelines) or len(timelines) < 2:
        return timelines
    longest = max(timelines, key=lambda timeline: len(timeline.t))
    result = []
    for timeline in timelines:
        offset = 0
        if longest.frames is not None and timeline.frames is not None:
            offset = int(np.searchsorted(longest.frames, timeline.frames[0]))
        shared = longest.t[offset:offset + len(timeline.t)]
        if len(shared) < len(timeline.t):
            raise InputError(
                timeline.sheet.place, f'expected no more rows than {longest.sheet.name} has from '
                f'the same frame on, found {len(timeline.t)}')
        result.append(RowTimes(timeline.sheet, shared, timeline.frames, True))
    said.add(f'all robots on the clock of {longest.sheet.name}, row by row')
    return result


def _are_intervals(
    sheet: Sheet, column: Column, values: np.ndarray, many_rows_a_time: bool, answers: Answers,
    said: Assumptions,
) -> bool:
    name = f"{sheet.name}, '{sheet.names[column.index]}'"
    if answers.times:
        return answers.times == 'intervals'
    steps = np.diff(values)
    if many_rows_a_time or not len(steps) or (steps > 0).all():
        return False
    steady = values.min() >= 0 and 0 < values.max() < _STEADY * np.median(values)
    if not steady:
        line = sheet.lines[int(np.argmax(steps <= 0)) + 1]
        raise InputError(
            sheet.place, f"expected the times in '{sheet.names[column.index]}' to ascend; if they "
                         'are intervals, say --times intervals', line)
    said.add(f'{name}: intervals, since it goes back {int((steps < 0).sum())} times; summed')
    return True


def _seconds_per_unit(
    sheet: Sheet, column: Column, steps: np.ndarray, answers: Answers, said: Assumptions,
) -> float:
    name = sheet.names[column.index]
    unit = answers.time_unit or column.unit
    if unit:
        return to_si(unit, 1.0)
    step = float(np.median(steps)) if len(steps) else 0.0
    if step >= _LONGEST_STEP:
        raise InputError(
            sheet.place, f"expected --time-unit s or ms: steps of {step:g} in '{name}' could be "
                         'either')
    said.add(f"{sheet.name}, '{name}': in seconds, steps of {step:.4g}")
    return 1.0
