"""Scale of the positions in a table, from the speeds in the same table.

A laboratory's tracker writes positions in pixels and speeds in µm/s. A speed is a displacement
over some frames, divided by a time, times the size of a pixel. The ratio of the two columns is
therefore the pixel size, and it is equal in all rows for the right number of frames and time base.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from microbot_ros.common.errors import InputError
from microbot_ros.common.records import SpeedWindow, TimeBase
from microbot_ros.common.units import to_si
from microbot_ros.session.spreadsheets.columns import Column
from microbot_ros.session.spreadsheets.row_times import RowTimes
from microbot_ros.session.spreadsheets.sheets import Answers, Assumptions, Sheet

Part = tuple[Sheet, list[Column]]

_LONGEST_WINDOW = 40
"""Choice: frames; the MagScope tracker uses 15, and windows beyond 1.5 s smear every turn."""
_FEWEST_ROWS = 20  # choice: rows from which a common ratio is no coincidence
_ROUNDING = 1e-5
"""Relative width of the ratios of numbers with six digits.

In a table with constant intervals two time bases fit alike, and rounding must not decide.
"""
_EXACT = 1e-3
"""Choice: relative width of half of the ratios below which the table's formula is found."""
_WIDEST = 0.3
"""Choice: relative width of half of the ratios above which speeds do not give the scale."""
_UNCERTAIN = 0.03
"""Choice: relative 95 % error above which a scale is not used.

Half refuses good tables of smoothed speeds; twice admits errors that double the uncertainty of a
diffusion coefficient.
"""
_AGREES = 0.02
"""Choice: relative difference of a stated and a measured scale that is no conflict."""
_PIXEL_UM = (0.01, 50.0)
"""Choice: pixel sizes [µm] of microscopes, from a 100x objective to a macro lens."""
_SPEED_UNITS = {'_um_s': 1e-6, '_mm_s': 1e-3, '': 1e-6}
"""Factors to m/s by suffix, by definition; without a suffix µm/s, as in most tables."""


@dataclass(frozen=True)
class SpeedRatio:
    """Ratio `value` of speed to displacement per time, in the units of the two columns.

    `error` is the relative 95 % error, `window` the definition of speed, `share` that of the rows.
    """

    value: float
    error: float
    window: SpeedWindow
    share: float

    @property
    def exact(self) -> bool:
        """Whether the table's own formula has been found."""
        return self.error < _EXACT


@dataclass(frozen=True)
class Scale:
    """Metres per unit of position (`factor`), None if the table does not show it.

    `pixel_size` [m] if positions are in pixels, else None; `window` of the table's speeds, or
    None.
    """

    factor: float | None
    pixel_size: float | None
    window: SpeedWindow | None


def speed_ratio(speed: np.ndarray, z: np.ndarray, t: np.ndarray) -> SpeedRatio | None:
    """Return the ratio of `speed` (n,) to displacements of complex positions `z` (n,) per time.

    `t` (n,) [s] are the times of the rows. All windows up to 40 frames and three time bases are
    tried; that with the best agreement is returned. None if no ratio is common to the rows.

    Parameters
    ----------
    speed : ndarray, shape (n,)
        Speeds of the table.
    z : ndarray, shape (n,)
        Positions, complex.
    t : ndarray, shape (n,)
        Times [s].

    Returns
    -------
    SpeedRatio or None
        The ratio, or None.
    """
    best: tuple[float, SpeedRatio] | None = None
    steps = np.diff(t, prepend=np.nan)
    for frames in range(1, min(_LONGEST_WINDOW, len(t) - _FEWEST_ROWS) + 1):
        moved = np.abs(z[frames:] - z[:-frames])
        for base, duration in _durations(frames, t, steps):
            with np.errstate(divide='ignore', invalid='ignore'):
                ratio = speed[frames:] * duration / moved
            known = np.isfinite(ratio) & (ratio > 0) & (moved > 0)
            if known.sum() < _FEWEST_ROWS:
                continue
            # Slow rows are dominated by position noise; the faster half decides.
            fast = known & (moved >= np.median(moved[known]))
            middle, width = _shorth(np.log(ratio[fast]))
            error = 2 * width / np.sqrt(max(fast.sum() / frames, 1.0))
            share = float((np.abs(np.log(ratio[fast]) - middle) < max(5e-3, 2 * width)).mean())
            # Of equal ones, up to rounding, the first is kept: fewer frames, elapsed time.
            if best is None or max(width, _ROUNDING) < (
                    1.0 if best[1].window.base == base else 0.5) * best[0]:
                best = max(width, _ROUNDING), SpeedRatio(
                    float(np.exp(middle)), max(error, width), SpeedWindow(frames, base), share)
    if best is None or best[0] > _WIDEST:
        return None
    width, found = best
    if width < _EXACT:
        return SpeedRatio(found.value, width, found.window, found.share)
    return found


def _durations(frames: int, t: np.ndarray, steps: np.ndarray,
               ) -> Iterator[tuple[TimeBase, np.ndarray]]:
    yield 'elapsed', t[frames:] - t[:-frames]
    yield 'last_interval', frames * steps[frames:]
    yield 'frames', np.full(len(t) - frames, float(frames))


def _shorth(values: np.ndarray) -> tuple[float, float]:
    """Return middle and width of the shortest interval that holds half of the `values` (n,)."""
    ordered = np.sort(values)
    half = max(1, len(ordered) // 2)
    widths = ordered[half:] - ordered[:-half]
    start = int(np.argmin(widths))
    return float(np.median(ordered[start:start + half + 1])), float(widths[start])


def settle_scale(path: Path, robots: Sequence[Part], timelines: Sequence[RowTimes],
                 answers: Answers, said: Assumptions) -> Scale:
    """Return the scale of positions of all `robots` of the file `path`, checked by `answers`.

    `timelines` hold the times of the robots' rows; `said` collects assumptions. Raises InputError
    if the stated scale contradicts the speeds of the table, or two robots have different scales.

    Parameters
    ----------
    path : Path
        File or folder.
    robots : sequence of Part
        Sheets of the robots.
    timelines : sequence of RowTimes
        Times of the rows of each robot.
    answers : Answers
        Answers of the user.
    said : Assumptions
        Collects assumptions.

    Returns
    -------
    Scale
        The scale.
    """
    sheet, columns = robots[0]
    x = next(column for column in columns if column.role == 'x')
    unit = answers.position_unit or x.unit
    for other, of in () if answers.position_unit else robots:
        for column in of:
            if column.role in ('x', 'y') and column.unit not in ('', x.unit):
                raise InputError(other.place, f"expected positions in {x.unit[1:] or 'one unit'} "
                                              f"as in '{sheet.names[x.index]}' of {sheet.name}, "
                                              f"found '{other.names[column.index]}'")
    found = _common_ratio(robots, timelines, answers.ignore_speed)
    window = found.ratio.window if found and found.ratio.exact else None
    if answers.ignore_speed:
        found = None
    if unit not in ('', '_px'):
        factor = to_si(unit, 1.0)
        if found is not None:
            _check_unit(sheet, x, unit, factor, found)
        return Scale(factor, None, window)
    said_px = _pixels(found)
    if answers.pixel_size is None:
        if said_px is None or found is None or found.ratio.error > _UNCERTAIN:
            return Scale(None, None, window)
        value, extent = _rounded(said_px, found.ratio)
        said.add(f'positions are in pixels of {value * 1e6:.6g} µm{extent}, since {found.place}'
                 f'{"" if found.named else ", taken as µm/s,"} is the displacement '
                 f'{_told(found.ratio.window)} times that{_most(found.ratio)}')
        return Scale(value, value, window)
    stated = answers.pixel_size
    if said_px is not None and found is not None:
        off = abs(said_px / stated - 1)
        if off > max(_AGREES, found.ratio.error):
            raise InputError(
                path, f'--pixel-size-um {stated * 1e6:.6g} contradicts {found.place}, which gives '
                      f'{said_px * 1e6:.4g} µm; expected that, or --ignore-speed')
        said.add(f'positions are in pixels of {stated * 1e6:.6g} µm, as stated; the speeds agree '
                 f'within {100 * max(off, 1e-3):.1f} %')
    elif not x.unit and not answers.position_unit:
        said.add('positions are in pixels: a pixel size is given')
    return Scale(stated, stated, window)


@dataclass(frozen=True)
class _Found:
    ratio: SpeedRatio
    place: str
    factor: float | None  # metres a second per unit of speed; None for pixels
    named: bool  # whether the column names its unit


def _common_ratio(robots: Sequence[Part], timelines: Sequence[RowTimes], lenient: bool,
                  ) -> _Found | None:
    """Return the ratio common to all robots; InputError if they differ, unless `lenient`."""
    found: list[_Found] = []
    for (sheet, columns), timeline in zip(robots, timelines, strict=True):
        for x in (column for column in columns if column.role == 'x'):
            one = _ratio_of(sheet, columns, x, timeline, lenient)
            if one is not None:
                found.append(one)
    exact = [one for one in found if one.ratio.exact]
    found = exact or found
    if not found:
        return None
    best = min(found, key=lambda one: one.ratio.error)
    for one in () if lenient else found:
        if abs(one.ratio.value / best.ratio.value - 1) > max(
                _AGREES, one.ratio.error + best.ratio.error):
            raise InputError(
                robots[0][0].source, f'expected one scale; {best.place} gives '
                                     f'{best.ratio.value:.4g} and {one.place} gives '
                                     f'{one.ratio.value:.4g}: state --pixel-size-um with '
                                     '--ignore-speed')
    return best


def _ratio_of(sheet: Sheet, columns: Sequence[Column], x: Column, timeline: RowTimes,
              lenient: bool) -> _Found | None:
    own = {column.role: column for column in columns if column.particle == x.particle}
    if 'y' not in own or any(column.role == 'particle' for column in columns):
        return None
    if 'speed' in own:
        name, unit = sheet.names[own['speed'].index], own['speed'].unit
        speed = np.abs(sheet.witness(own['speed'].index))
    elif {'vx', 'vy'} <= own.keys():
        unit = own['vx'].unit
        name = "' and '".join(sheet.names[own[role].index] for role in ('vx', 'vy'))
        speed = np.hypot(sheet.witness(own['vx'].index), sheet.witness(own['vy'].index))
    else:
        return None
    z = sheet.numbers(x.index) + 1j * sheet.numbers(own['y'].index)
    ratio = speed_ratio(speed, z, timeline.t)
    if ratio is None:
        return None
    if not lenient:
        _refuse_two_scales(sheet, name, ratio, speed, z, timeline.t)
    return _Found(ratio, f"'{name}' of {sheet.name}", _SPEED_UNITS.get(unit), bool(unit))


def _refuse_two_scales(sheet: Sheet, name: str, ratio: SpeedRatio, speed: np.ndarray,
                       z: np.ndarray, t: np.ndarray) -> None:
    """Raise InputError if the rows without this `ratio` share another one."""
    if not ratio.exact or ratio.share > 0.9:
        return
    frames, steps = ratio.window.frames, np.diff(t, prepend=np.nan)
    duration = dict(_durations(frames, t, steps))[ratio.window.base]
    moved = np.abs(z[frames:] - z[:-frames])
    with np.errstate(divide='ignore', invalid='ignore'):
        other = speed[frames:] * duration / moved
    rest = np.isfinite(other) & (other > 0) & (np.abs(other / ratio.value - 1) > _AGREES)
    if rest.sum() < _FEWEST_ROWS:
        return
    middle, width = _shorth(np.log(other[rest]))
    if width < _EXACT:
        line = sheet.lines[frames + int(np.flatnonzero(rest)[0])]
        raise InputError(sheet.place, f"expected one scale; '{name}' gives "
                                      f'{ratio.value:.4g} in most rows and '
                                      f'{np.exp(middle):.4g} in others', line)


def _pixels(found: _Found | None) -> float | None:
    """Return the pixel size [m] given by the speeds; None if they give none."""
    if found is None or found.factor is None:
        return None
    if found.ratio.exact and abs(found.ratio.value - 1) < _EXACT and not found.named:
        return None  # speeds in the unit of the positions
    size = found.ratio.value * found.factor
    return size if _PIXEL_UM[0] <= size * 1e6 <= _PIXEL_UM[1] else None


def _check_unit(sheet: Sheet, x: Column, unit: str, factor: float, found: _Found) -> None:
    """Raise InputError if speeds contradict the `unit` of positions."""
    if found.factor is None:
        return
    expected = factor / found.factor
    same = not found.named and abs(found.ratio.value - 1) < _AGREES
    off = abs(found.ratio.value / expected - 1)
    if not same and off > max(_AGREES, found.ratio.error):
        raise InputError(
            sheet.place, f"expected positions in {unit[1:]}; {found.place} is "
                         f"{found.ratio.value:.4g} times the displacement per second of "
                         f"'{sheet.names[x.index]}': state --position-unit px, or --ignore-speed")


def _rounded(size: float, ratio: SpeedRatio) -> tuple[float, str]:
    """Return a pixel size [m] to its known digits, and its error for messages."""
    if ratio.exact:
        return float(f'{size:.4g}'), ''
    return float(f'{size:.3g}'), f' ± {100 * ratio.error:.1g} %'


def _told(window: SpeedWindow) -> str:
    per = {'elapsed': 'the time between them', 'frames': 'their number',
           'last_interval': f'{window.frames} times the last interval'}[window.base]
    return f'over {window.frames} frames divided by {per}'


def _most(ratio: SpeedRatio) -> str:
    return '' if ratio.share > 0.98 else f' (in {100 * ratio.share:.0f} % of the rows)'
