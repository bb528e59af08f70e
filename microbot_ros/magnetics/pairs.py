"""Corrections to pairs of opposite coils, as tracks tell them: no coil by itself."""

from __future__ import annotations

import math

import numpy as np

from microbot_ros.errors import InputError
from microbot_ros.magnetics.coils import CoilSet
from microbot_ros.magnetics.settings import CoilSettings, Vector, Winding


def with_pairs(settings: CoilSettings, gain_ratio: float, skew: float, matrix: np.ndarray,
               offset: np.ndarray) -> CoilSettings:
    """Coils that make B = `matrix` (2, 2) B_cmd + `offset` (2,) [T] of the currents that the coils
    in `settings` need for B_cmd: the y pair stronger by `gain_ratio` and turned about the
    workspace centre by `skew` [rad] towards +x. Raises InputError where there are no such pairs.
    """
    field = np.abs(CoilSet(settings).actuation_matrix()[:2])
    of_y = field[1] > field[0]
    if of_y.sum() != 2:
        raise InputError('coils', 'expected two coils along x and two along y')
    windings = tuple(
        _turned(winding, -skew).model_copy(update={'gain': winding.gain * gain_ratio})
        if y else winding for winding, y in zip(settings.windings, of_y, strict=True))
    # Currents were chosen for what was wanted less the background that the file knew.
    background = 1e3 * (offset + matrix @ (1e-3 * np.array(settings.background_mT)))
    return CoilSettings(windings=windings, background_mT=tuple(background.tolist()))


def _turned(winding: Winding, angle: float) -> Winding:
    """The coil turned about the z axis of the workspace."""
    def turn(vector: Vector) -> Vector:
        x, y, z = vector
        cosine, sine = math.cos(angle), math.sin(angle)
        return cosine * x - sine * y, sine * x + cosine * y, z

    return winding.model_copy(update={
        'position_mm': turn(winding.position_mm),
        'axis': winding.axis and turn(winding.axis),
        'vertices_mm': winding.vertices_mm and tuple(map(turn, winding.vertices_mm))})
