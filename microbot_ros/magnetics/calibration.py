"""Gain and sign of each coil and the background field, from gaussmeter readings or from tracks.

Every reading is B = b + Σₖ gₖ Iₖ cₖ(p), with cₖ the field per ampere of the geometry of coil k at
the probe position p. It is linear in the signed gains gₖ and the background b, so one
least-squares fit finds them. The background includes the zero offset of the probe. Tracks
determine only pairs of opposite coils, not single coils (`with_coil_map`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations, compress, permutations, product
from pathlib import Path
from typing import Any

import numpy as np

from microbot_ros.common.errors import InputError
from microbot_ros.common.tables import Layout, read_table
from microbot_ros.common.units import from_si
from microbot_ros.magnetics.coils import CoilSet
from microbot_ros.magnetics.settings import CoilSettings, Vector, Winding

_BELIEVED = 0.2  # choice: unexplained part that is accepted; probe placement costs a few percent
_CLEAN = 0.01  # choice: unexplained part below which no swapped columns are looked for
_MUCH_BETTER = 3  # choice: factor by which a swap must be better to be reported
_SINGULAR = 1e6  # choice: condition number above which the readings do not separate the coils
# Choice: gains beyond this factor mean a dead coil or other units; geometry is known better.
_PLAUSIBLE = 3
# Choice: up to this many columns every swap of four is tried; for more it would take minutes.
_FEW = 8


@dataclass(frozen=True)
class Readings:
    """M readings of a probe.

    Attributes
    ----------
    currents : (M, N) array [A]
    points : (M, 3) array [m]
        Position of the probe.
    field : (M, 3) array [T]
        NaN in the z column if the probe did not measure it.
    """

    currents: np.ndarray
    points: np.ndarray
    field: np.ndarray


@dataclass(frozen=True)
class Calibration:
    """Gains and background that readings give for a rig.

    Attributes
    ----------
    names : tuple of str
        The N coils.
    gain, gain_std : (N,) array
        Signed gain and its standard deviation.
    background, background_std : (axes,) array [T]
    residuals : (M, 3) array [T]
        Measured minus fitted field, NaN where `Readings.field` is.
    """

    names: tuple[str, ...]
    gain: np.ndarray
    gain_std: np.ndarray
    background: np.ndarray
    background_std: np.ndarray
    residuals: np.ndarray

    def summary(self) -> dict[str, Any]:
        """Return gains, signs and background with standard deviations, and the residual.

        Returns
        -------
        dict of str to object
            Values by name, in the units of the names.
        """
        return {
            'coils': {
                name: {'gain': abs(gain), 'gain_std': std, 'sign': 1 if gain > 0 else -1}
                for name, gain, std in zip(
                    self.names, self.gain.tolist(), self.gain_std.tolist(), strict=True)
            },
            'background_mT': from_si('_mT', self.background).tolist(),
            'background_std_mT': from_si('_mT', self.background_std).tolist(),
            'residual_rms_mT': float(from_si('_mT', np.sqrt(np.nanmean(self.residuals**2)))),
        }

    def applied_to(self, settings: CoilSettings) -> CoilSettings:
        """Return `settings` with these gains, signs and background.

        Parameters
        ----------
        settings : CoilSettings
            Settings of the coils.

        Returns
        -------
        CoilSettings
            The corrected settings.
        """
        summary = self.summary()
        windings = tuple(
            winding.replaced(**{key: summary['coils'][winding.name][key]
                                for key in ('gain', 'sign')})
            for winding in settings.windings
        )
        return settings.replaced(
            windings=windings, background_mT=tuple(summary['background_mT']))


def read_readings(path: str | Path, settings: CoilSettings) -> Readings:
    """Read probe readings from a CSV file.

    Needed are `bx_mT`, `by_mT` and a column `<coil>_A` for each coil of `settings`; `bz_mT` too if
    the coils make a field along z. Optional are `bz_mT` otherwise, and the position of the probe
    `x_mm`, `y_mm`, `z_mm` (default: the workspace centre). The order of the columns of `path` is
    free. Raises InputError naming file, line and column for anything else.

    Parameters
    ----------
    path : str or Path
        CSV file to read.
    settings : CoilSettings
        Settings of the coils.

    Returns
    -------
    Readings
        The readings.
    """
    currents = [f'{winding.name}_A' for winding in settings.windings]
    needed, optional = ['bx_mT', 'by_mT', *currents], ['bz_mT', 'x_mm', 'y_mm', 'z_mm']
    if CoilSet(settings).axes == 3:
        needed.insert(2, optional.pop(0))
    table = read_table(Path(path), Layout(tuple(needed), tuple(optional)))
    for name in table.columns:
        table.refuse(np.isnan(table.columns[name]), f"expected a number in '{name}'")

    def column(name: str, missing: float) -> np.ndarray:
        return table.columns.get(name, np.full(len(table.lines), missing))

    return Readings(
        np.column_stack([table.columns[name] for name in currents]),
        np.column_stack([column(name, 0.0) for name in ('x_mm', 'y_mm', 'z_mm')]),
        np.column_stack([column(name, math.nan) for name in ('bx_mT', 'by_mT', 'bz_mT')]),
    )


def calibrate(readings: Readings, settings: CoilSettings, source: str | Path) -> Calibration:
    """Fit gains, signs and background to readings.

    Parameters
    ----------
    readings : Readings
        Measured fields and the currents that made them.
    settings : CoilSettings
        Geometry of the coils; its gains and signs are ignored.
    source : str or Path
        Origin of the readings, for messages.

    Returns
    -------
    Calibration
        Gains, signs and background.

    Raises
    ------
    InputError
        If the readings cannot separate the coils, columns look swapped, a coil makes no field, or
        the geometry does not explain the readings.
    """
    plain = [winding.replaced(gain=1.0, sign=1) for winding in settings.windings]
    coils = CoilSet(settings.replaced(windings=tuple(plain)))
    fit = _fit(readings, coils)
    if fit is None:
        raise InputError(source, 'expected readings that separate the coils: drive each coil '
                                 'alone, in both directions; the equations are singular')
    calibration, unexplained = fit
    if unexplained > _CLEAN and (swap := _swap(readings, coils, unexplained)):
        raise InputError(source, f'expected columns that are not swapped; these fit if {swap}')
    if not unexplained <= _BELIEVED:
        raise InputError(source, "expected readings that fit the coils' geometry;"
                         f' {min(unexplained, 1):.0%} of their variation is unexplained')
    for name, gain, std in zip(coils.names, calibration.gain, calibration.gain_std, strict=True):
        if not (1 / _PLAUSIBLE <= abs(gain) <= _PLAUSIBLE and std < abs(gain) / 5):
            raise InputError(
                source, f'expected a gain between 1/{_PLAUSIBLE} and {_PLAUSIBLE} for {name},'
                f" found {gain:.3g} ± {std:.2g}: see its wiring and turns, and the columns' units")
    return calibration


def _fit(readings: Readings, coils: CoilSet) -> tuple[Calibration, float] | None:
    """Return the least-squares fit and the part of the variation that it leaves unexplained.

    None if the readings do not determine every gain and the background.
    """
    axes = np.flatnonzero(np.isfinite(readings.field).all(axis=0))
    field = readings.field[:, axes]
    driven = coils.effective(readings.currents).T[:, :, None] * coils.field_per_ampere(
        readings.points)[..., axes]
    constant = np.broadcast_to(np.eye(len(axes))[:, None], (len(axes), *field.shape))
    design = np.concatenate([driven, constant]).reshape(-1, field.size).T
    scale = np.linalg.norm(design, axis=0)
    freedom = field.size - len(scale)
    if freedom < 1 or not scale.all() or np.linalg.cond(design / scale) > _SINGULAR:
        return None
    inverse = np.linalg.pinv(design / scale) / scale[:, None]
    solution = inverse @ field.ravel()
    residual = field - (design @ solution).reshape(field.shape)
    std = np.linalg.norm(inverse, axis=1) * np.linalg.norm(residual) / math.sqrt(freedom)
    residuals = np.full(readings.field.shape, np.nan)
    residuals[:, axes] = residual
    variation = np.linalg.norm(field - field.mean(axis=0))
    unexplained = np.linalg.norm(residual) / variation if variation else math.inf
    count = len(coils.names)
    gain, background = slice(count), slice(count, count + coils.axes)
    return Calibration(
        coils.names, solution[gain], std[gain], solution[background], std[background], residuals,
    ), float(unexplained)


def _swap(readings: Readings, coils: CoilSet, unexplained: float) -> str:
    """Return the simplest swap of columns that explains the readings much better, or ''."""
    fits: list[tuple[float, list[str]]] = []
    for order, axes in product(_orders(len(coils.names)), ((0, 1, 2), (1, 0, 2))):
        swapped = Readings(readings.currents[:, order], readings.points, readings.field[:, axes])
        fit = _fit(swapped, coils)
        if fit and fit[1] < unexplained / _MUCH_BETTER:
            found = [f'{coils.names[k]}_A holds the current of {coils.names[j]}'
                     for j, k in enumerate(order) if j != k]
            found += ['bx_mT holds y', 'by_mT holds x'] if axes[0] else []
            fits.append((fit[1], found))
    if not fits:
        return ''
    best = min(residual for residual, _ in fits)
    simplest = min((found for residual, found in fits if residual <= 1.1 * best), key=len)
    return ', '.join(simplest)


def _orders(count: int) -> Iterator[tuple[int, ...]]:
    """Yield the orders of the columns that move at most four of few, or two of many."""
    moved = min(count, 4) if count <= _FEW else 2
    for places in combinations(range(count), moved):
        for order in permutations(places):
            there = dict(zip(places, order, strict=True))
            yield tuple(there.get(k, k) for k in range(count))


def with_coil_map(settings: CoilSettings, gain_ratio: float, skew: float, matrix: np.ndarray,
               offset: np.ndarray) -> CoilSettings:
    """Return coils that reproduce a measured map from commanded to actual field.

    For the currents that the coils of `settings` need for B_cmd, the returned coils make
    B = matrix B_cmd + offset. Coils along z stay as they are.

    Parameters
    ----------
    settings : CoilSettings
        Coils as they were taken to be.
    gain_ratio : float
        Strength of the y pair over that of the x pair.
    skew : float
        Rotation of the y pair about the workspace centre towards +x [rad].
    matrix : (2, 2) array
        Actual field per commanded field.
    offset : (2,) array [T]
        Actual field at a commanded field of zero.

    Returns
    -------
    CoilSettings
        Settings of the corrected coils.

    Raises
    ------
    InputError
        If there are not two coils along x and two along y, or the y pair is not made of wire.
    """
    coils = CoilSet(settings)
    along = np.abs(coils.actuation_matrix()).argmax(axis=0)
    of_y = along == 1
    if of_y.sum() != 2 or (along == 0).sum() != 2:
        raise InputError('coils', 'expected two coils along x and two along y')
    for winding in compress(settings.windings, of_y):
        if winding.turns is None:
            raise InputError(winding.name, 'expected a wire; a measured field cannot be rotated')
    windings = tuple(
        _turned(winding, -skew).replaced(gain=winding.gain * gain_ratio)
        if y else winding for winding, y in zip(settings.windings, of_y, strict=True))
    # The currents were computed for the wanted field minus the background of `settings`.
    known, above = settings.background_mT[:2], settings.background_mT[2:]
    background = 1e3 * (offset + matrix @ (1e-3 * np.array(known)))
    return settings.replaced(
        windings=windings, background_mT=(*background.tolist(), *above))


def _turned(winding: Winding, angle: float) -> Winding:
    """Return the winding rotated about the z axis of the workspace."""
    def turn(vector: Vector) -> Vector:
        x, y, z = vector
        cosine, sine = math.cos(angle), math.sin(angle)
        return cosine * x - sine * y, sine * x + cosine * y, z

    return winding.replaced(
        position_mm=turn(winding.position_mm), axis=winding.axis and turn(winding.axis),
        vertices_mm=winding.vertices_mm and tuple(map(turn, winding.vertices_mm)))
