"""Times of the rows of a sheet: moments, intervals, frames, or another sheet's rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from microbot_ros.common.errors import InputError
from microbot_ros.common.units import to_si
from microbot_ros.session.spreadsheets.columns import Column
from microbot_ros.session.spreadsheets.sheets import Answers, Assumptions, Sheet

_STEADY = 20.0
"""Choice: largest interval of a camera in medians; moments exceed it."""
_LONGEST_STEP = 2.0
"""Choice: a longer step is as likely in milliseconds as in seconds."""
_MOST_BACK = 0.02
"""Choice: share of rows that may go back in a column of moments.

Intervals go back in a third to a half of the rows.
"""
_FEWEST_UP = 10
"""Choice: rows by which a column must go up more often than back to hold moments.

Intervals go back as often as up. A robot that is seen for a few rows shows neither.
"""
_LOST_FRAMES = 10
"""Choice: frames that a counter may advance between two rows without the time for them.

Beyond, the track was lost. Counters of busy trackers skip and repeat one or two frames.
"""


@dataclass(frozen=True)
class RowTimes:
    """Times `t` (n,) [s] of the rows of a `sheet`, and their `frames` numbers or None.

    `intervals`: the sheet states how long each row lasted, not when it was. `cuts`: rows at which
    a lost track was picked up again.
    """

    sheet: Sheet
    t: np.ndarray
    frames: np.ndarray | None
    intervals: bool
    cuts: tuple[int, ...] = ()


def row_times(
    robots: Sequence[tuple[Sheet, list[Column]]], answers: Answers, said: Assumptions,
) -> list[RowTimes]:
    """Return the times of the rows of the sheets of all `robots`, which share a tracker.

    A robot seen for a few frames does not show that its times are intervals; the others do.

    Parameters
    ----------
    robots : sequence of tuple[Sheet, list of Column]
        Sheets of the robots with their columns, with times or frames each.
    answers : Answers
        Answers of the user.
    said : Assumptions
        Collects assumptions.

    Returns
    -------
    list of RowTimes
        Times of the rows of each robot.
    """
    first = [_times_of(part, answers, Assumptions()) for part in robots]
    intervals = [float(np.diff(line.t).max(initial=0.0)) for line in first if line.intervals]
    lines = []
    for part, line in zip(robots, first, strict=True):
        few = intervals and not line.intervals and line.t.max(initial=0.0) <= max(intervals)
        lines.append(_times_of(part, replace(answers, times='intervals') if few else answers,
                               said))
    return lines


def _times_of(part: tuple[Sheet, list[Column]], answers: Answers, said: Assumptions) -> RowTimes:
    line = own_row_times(*part, answers, said)
    assert line is not None  # the sheet has times or frames
    return line


def own_row_times(
    sheet: Sheet, columns: Sequence[Column], answers: Answers, said: Assumptions,
) -> RowTimes | None:
    """Return the times that a `sheet` states itself in its `columns`; None if it states none.

    Parameters
    ----------
    sheet : Sheet
        The sheet.
    columns : sequence of Column
        Columns of the sheet.
    answers : Answers
        Answers of the user.
    said : Assumptions
        Collects assumptions.

    Returns
    -------
    RowTimes or None
        The times, or None.
    """
    by_role = {column.role: column for column in columns}
    frames = sheet.numbers(by_role['frame'].index) if 'frame' in by_role else None
    if 'time' in by_role:
        column = by_role['time']
        values = sheet.numbers(column.index)
        if len(values) > 1 and np.isnan(values[0]) and (np.diff(values[1:]) < 0).any():
            values[0] = np.nanmedian(values)  # no interval precedes the first row
        if np.isnan(values).any():
            name, row = sheet.names[column.index], int(np.argmax(np.isnan(values)))
            raise InputError(sheet.place, f"expected a time in '{name}'", sheet.lines[row])
        intervals = _are_intervals(sheet, column, values, 'particle' in by_role, answers, said)
        steps = values if intervals else np.diff(np.unique(values))
        factor = _seconds_per_unit(sheet, column, steps, answers, said)
        if not intervals:
            return RowTimes(sheet, values * factor, frames, intervals)
        values, cuts = _picked_up(sheet, values * factor, frames, said)
        return RowTimes(sheet, np.cumsum(values), frames, intervals, cuts)
    if frames is None:
        return None
    if answers.frame_rate is None:
        raise InputError(sheet.place, 'expected --frame-rate-hz: there are frames and no times')
    return RowTimes(sheet, frames / answers.frame_rate, frames, False)


def joined_row_times(sheet: Sheet, columns: Sequence[Column], others: list[RowTimes],
                    said: Assumptions) -> RowTimes:
    """Return times of a `sheet` with none of its own, or only frames, from `others`.

    Parameters
    ----------
    sheet : Sheet
        The sheet.
    columns : sequence of Column
        Columns of the sheet.
    others : list of RowTimes
        Times of other sheets.
    said : Assumptions
        Collects assumptions.

    Returns
    -------
    RowTimes
        The times.
    """
    longest = clock_of(others)
    if len(sheet.rows) == len(longest.t):
        said.add(f'{sheet.name}: matched row by row to {longest.sheet.name}')
        return RowTimes(sheet, longest.t, None, False)
    frame = next((column for column in columns if column.role == 'frame'), None)
    if frame is None or longest.frames is None:
        raise InputError(
            sheet.place, f'expected times, frames, or the {len(longest.t)} rows of '
                         f'{longest.sheet.name}; found {len(sheet.rows)} rows')
    frames = sheet.numbers(frame.index)
    known, first = np.unique(longest.frames, return_index=True)
    inside = (known[0] <= frames) & (frames <= known[-1])
    if not inside.any():
        raise InputError(sheet.place, f'expected frames {known[0]:g} to {known[-1]:g}')
    said.add(f'{sheet.name}: beside {longest.sheet.name} by frame')
    t = np.interp(frames, known, longest.t[first])
    return RowTimes(sheet, np.where(inside, t, np.nan), frames, False)


def aligned(timelines: list[RowTimes], said: Assumptions) -> list[RowTimes]:
    """Return `timelines` of robots filmed together on one clock.

    If times are sums of intervals, every sheet runs row by row along the longest, from the frame
    where it begins. The clock is extended where a sheet begins before the longest or ends after
    it. After a cut a sheet continues from the frame at which its track was picked up. `said`
    collects assumptions.

    Parameters
    ----------
    timelines : list of RowTimes
        Times of the rows of each robot.
    said : Assumptions
        Collects assumptions.

    Returns
    -------
    list of RowTimes
        The times on one clock.
    """
    if not all(timeline.intervals for timeline in timelines) or len(timelines) < 2:
        return timelines
    clock = _clock(timelines)
    said.add(f'all robots on the clock of {clock.sheet.name}, row by row')
    return [replace(timeline, t=_along(clock, timeline)) for timeline in timelines]


def clock_of(timelines: Sequence[RowTimes]) -> RowTimes:
    """Return the clock to compare other sheets with: that of the longest of `timelines`.

    It is extended by the others if all run along it.

    Parameters
    ----------
    timelines : sequence of RowTimes
        Times of the rows of each robot.

    Returns
    -------
    RowTimes
        The clock.
    """
    if len(timelines) > 1 and all(timeline.intervals for timeline in timelines):
        return _clock(timelines)
    return max(timelines, key=lambda timeline: len(timeline.t))


def _clock(timelines: Sequence[RowTimes]) -> RowTimes:
    # A sheet without cuts has lost no time.
    clock = max(timelines, key=lambda timeline: (not timeline.cuts, len(timeline.t)))
    for other in timelines:
        if clock.frames is None or other.frames is None:
            continue
        t, frames = [clock.t], [clock.frames]
        before = int(np.searchsorted(other.frames, clock.frames[0]))
        if before and before < len(other.t):
            t.insert(0, clock.t[0] - other.t[before] + other.t[:before])
            frames.insert(0, other.frames[:before])
        after = int(np.searchsorted(other.frames, clock.frames[-1], side='right'))
        if 0 < after < len(other.t):
            t.append(clock.t[-1] - other.t[after - 1] + other.t[after:])
            frames.append(other.frames[after:])
        clock = replace(clock, t=np.concatenate(t), frames=np.concatenate(frames))
    return clock


def _along(clock: RowTimes, timeline: RowTimes) -> np.ndarray:
    """Return the times of the rows of a `timeline` on a `clock`."""
    if clock.frames is None or timeline.frames is None:
        return clock.t[:len(timeline.t)]
    if (np.diff(clock.frames) < 0).any():
        return timeline.t  # a counter that restarted says nothing about the others
    t = np.empty(len(timeline.t))
    bounds = [0, *timeline.cuts, len(t)]
    for start, end in pairwise(bounds):
        offset = int(np.searchsorted(clock.frames, timeline.frames[start]))
        shared = clock.t[offset:offset + end - start]
        if len(shared) < end - start:
            raise InputError(
                timeline.sheet.place, f'expected no more rows than {clock.sheet.name} has from '
                f'the same frame on, found {len(timeline.t)}')
        t[start:end] = shared
    return t


def _picked_up(sheet: Sheet, intervals: np.ndarray, frames: np.ndarray | None, said: Assumptions,
               ) -> tuple[np.ndarray, tuple[int, ...]]:
    """Return positive intervals (n,) [s], and the rows at which a lost track was picked up again.

    There the frame counter jumps and the interval does not include the gap.
    """
    usual = float(np.median(intervals[intervals > 0])) if (intervals > 0).any() else 0.0
    intervals = intervals.copy()
    cuts: list[int] = []
    if frames is not None:
        step = np.diff(frames, prepend=frames[:1] - 1)
        lost = (np.abs(step) > _LOST_FRAMES) | (step < 0)
        lost &= intervals < 0.5 * np.abs(step) * usual
        lost[0] = False
        cuts = np.flatnonzero(lost).tolist()
        intervals[lost] = np.maximum(step[lost], 1) * usual
    for row in cuts:
        said.add(f'{sheet.name}: the robot was lost and found again in line {sheet.lines[row]}, '
                 f'at {intervals[:row + 1].sum():.1f} s; the track is cut there')
    short = intervals[1:] <= 0
    if short.any():
        said.add(f'{sheet.name}: {int(short.sum())} intervals of 0 taken as {usual:.4g} s')
        intervals[1:][short] = usual
    return intervals, tuple(cuts)


def _are_intervals(
    sheet: Sheet, column: Column, values: np.ndarray, many_rows_a_time: bool, answers: Answers,
    said: Assumptions,
) -> bool:
    if answers.times:
        return answers.times == 'intervals'
    steps = np.diff(values)
    if many_rows_a_time or not len(steps) or (steps > 0).all():
        return False
    usual = float(np.median(values))
    up, back = int((steps > 0).sum()), int((steps < 0).sum())
    # Moments that were rounded to equal ones, or a clock that was set back.
    moments = back <= max(1, _MOST_BACK * len(steps)) and up - back > _FEWEST_UP
    steady = not moments and values.min() >= 0 and usual > 0 and (
        values.max() < _STEADY * usual
        or ((steps < 0).mean() > _MOST_BACK and np.quantile(values, 0.95) < _STEADY * usual))
    if not steady:
        line = sheet.lines[int(np.argmax(steps <= 0)) + 1]
        raise InputError(
            sheet.place, f"expected ascending times in '{sheet.names[column.index]}'; if they are "
                         'intervals, use --times intervals', line)
    said.add(f"'{sheet.names[column.index]}' holds intervals: it decreases repeatedly; "
             'summed', sheet.name)
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
            sheet.place, f"expected --time-unit s or ms: steps of {step:g} in '{name}' fit both")
    said.add(f"'{name}' is in seconds, steps of {step:.1g}", sheet.name)
    return 1.0
