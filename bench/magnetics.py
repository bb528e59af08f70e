"""Fields against magpylib, currents against magpylib's field and SciPy's linear programming."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import magpylib
import numpy as np
from scipy.optimize import linprog

from bench.figure import Figure, seconds
from microbot_ros.common.files import read_yaml
from microbot_ros.magnetics import Allocator, CoilSet, CoilSettings

_CONFIG = Path(__file__).parents[1] / 'config'
_POINTS = 10_000
_STEP = 5e-5  # of the differences of magpylib's field [m]
_BATCH = 50  # allocations per timed call: long for the clock, short for the scheduler
_DIRECTIONS = np.linspace(0, 2 * np.pi, 3600, endpoint=False)


def figures() -> Iterator[Figure]:
    """Every figure of the coils, measured on a rig with uneven gains, poses and limits."""
    settings = _uneven_rig()
    coils, peer = CoilSet(settings), _magpylib(settings)
    yield from _field(coils, peer)
    yield from _directions(coils, peer)
    yield from _times(coils)
    yield from _many(6)
    yield from _many(16)
    yield from _times_in_space()


def _uneven_rig() -> CoilSettings:
    rng = np.random.default_rng(0)
    content = CoilSettings().content('not none')
    for winding in content['windings']:
        winding.update(
            gain=rng.uniform(0.8, 1.1), max_current_A=rng.uniform(1.5, 2.5),
            position_mm=winding['position_mm'] + rng.normal(0, 0.5, 3),
            axis=winding['axis'] + rng.normal(0, 0.03, 3))
    return CoilSettings.from_content({**content, 'background_mT': (0.02, -0.045)})


def _magpylib(settings: CoilSettings) -> list[magpylib.current.Circle]:
    """The same coils, each under 1 A."""
    circles = []
    for winding in settings.windings:
        circle = magpylib.current.Circle(
            diameter=2e-3 * winding.radius_mm, current=winding.turns * winding.gain * winding.sign)
        axis = np.array(winding.axis) / np.linalg.norm(winding.axis)
        turn = np.cross((0, 0, 1), axis)  # the loop's axis is at right angles to z, or nearly
        turn *= np.arccos(axis[2]) / np.linalg.norm(turn)
        circles.append(circle.rotate_from_rotvec(turn, degrees=False).move(
            1e-3 * np.array(winding.position_mm)))
    return circles


def _around(count: int) -> CoilSettings:
    """Coils on a sphere about the workspace, evenly spread, each facing it."""
    steps = np.arange(count) + 0.5
    z, angle = 1 - 2 * steps / count, np.pi * (1 + math.sqrt(5)) * steps
    radius = np.sqrt(1 - z * z)
    axes = np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)
    winding = CoilSettings().windings[0].content('not none')
    return CoilSettings.from_content({'axes': 'xyz', 'windings': [
        {**winding, 'name': f'coil_{k}', 'position_mm': 45 * axis, 'axis': axis}
        for k, axis in enumerate(axes)]})


def _many(count: int) -> list[Figure]:
    """Field and gradient in space; magpylib has no gradient but differences of its field."""
    settings = _around(count)
    coils, peer = CoilSet(settings), _magpylib(settings)
    points = np.random.default_rng(1).uniform(-12e-3, 12e-3, (_POINTS, 3))
    shifts = _STEP * np.multiply.outer((-2, -1, 1, 2), np.eye(3))

    def ours() -> tuple[np.ndarray, np.ndarray]:
        return coils.field_per_ampere(points), coils.gradient_per_ampere(points)

    def theirs() -> tuple[np.ndarray, np.ndarray]:
        near = magpylib.getB(peer, (points + shifts[:, :, None]).reshape(-1, 3))
        near = near.reshape(count, 4, 3, len(points), 3)
        weights = np.array([1, -8, 8, -1]) / (12 * _STEP)
        return magpylib.getB(peer, points), np.einsum('s,csjmi->cmij', weights, near)

    error = max(
        float((np.linalg.norm((own - other).reshape(count, _POINTS, -1), axis=-1)
               / np.linalg.norm(other.reshape(count, _POINTS, -1), axis=-1)).max())
        for own, other in zip(ours(), theirs(), strict=True))
    field = seconds(lambda: coils.field_per_ampere(points),
                    lambda: magpylib.getB(peer, points), rounds=5)
    both = seconds(ours, theirs, rounds=3)
    what = f'of {count} coils in space at 10,000 points'
    return [
        Figure(19, f'field {what}: speed', field[1] / field[0], '×', '≥ 5', 'magpylib getB',
               field[1] / field[0] >= 5),
        Figure(19, f'field and gradient {what}: speed', both[1] / both[0], '×', '≥ 5',
               'magpylib getB and its differences', both[1] / both[0] >= 5),
        Figure(19, f'field and gradient {what}: largest relative difference', error, '1',
               '≤ 1e-9', 'magpylib getB and its differences', error <= 1e-9),
    ]


def _times_in_space() -> list[Figure]:
    rng = np.random.default_rng(2)
    fields = rng.normal(size=(_BATCH, 3))
    fields *= 1e-3 / np.linalg.norm(fields, axis=1, keepdims=True)
    six, eight = (Allocator(CoilSet(read_yaml(_CONFIG / f'coils_{number}.yaml', CoilSettings)))
                  for number in ('six', 'eight'))

    def each(call: Callable[[np.ndarray], object], of: np.ndarray) -> Callable[[], None]:
        def run() -> None:
            for one in of:
                call(one)
        return run

    times = seconds(each(six.allocate, fields), each(eight.allocate, fields),
                    each(six.allocate, 100 * fields), each(eight.allocate, 100 * fields),
                    rounds=99)
    names = ('field, 6 coils', 'field, 8 coils',
             'field beyond the limits, 6 coils', 'field beyond the limits, 8 coils')
    targets = (30, 30, 300, 300)
    return [Figure(19, f'currents for a wanted {name}', 1e6 * time / _BATCH, 'µs', f'≤ {target}',
                   '', 1e6 * time / _BATCH <= target)
            for name, time, target in zip(names, times, targets, strict=True)]


def _field(coils: CoilSet, peer: list[magpylib.current.Circle]) -> list[Figure]:
    points = np.random.default_rng(1).uniform(-12e-3, 12e-3, (_POINTS, 3))
    ours, theirs = coils.field_per_ampere(points), magpylib.getB(peer, points)
    size = np.linalg.norm(theirs, axis=-1)
    error = float((np.linalg.norm(ours - theirs, axis=-1) / size).max())
    own, other = seconds(lambda: coils.field_per_ampere(points),
                         lambda: magpylib.getB(peer, points), rounds=15)
    return [
        Figure(3, 'field of four coils at 10,000 points: speed', other / own, '×', '≥ 5',
               'magpylib getB', other / own >= 5),
        Figure(3, 'field of four coils at 10,000 points: largest relative difference', error, '1',
               '≤ 1e-9', 'magpylib getB', error <= 1e-9),
    ]


def _directions(coils: CoilSet, peer: list[magpylib.current.Circle]) -> list[Figure]:
    allocator = Allocator(coils)
    per_ampere = magpylib.getB(peer, (0, 0, 0))[:, :2]
    units = np.column_stack([np.cos(_DIRECTIONS), np.sin(_DIRECTIONS)])

    def worst_error(magnitude: float) -> float:
        currents = np.array([allocator.allocate(magnitude * unit).currents for unit in units])
        field = currents @ per_ampere + coils.background
        along = field[:, 0] + 1j * field[:, 1]
        return float(np.degrees(np.abs(np.angle(along * np.exp(-1j * _DIRECTIONS))).max()))

    inside, saturated = worst_error(2e-3), worst_error(1.0)
    shortfall = max(
        abs(1 - math.hypot(*allocator.allocate(unit).field)
            / _largest(coils, allocator.matrix, unit)) for unit in units[::10])
    return [
        Figure(6, 'field direction error inside limits, all directions', inside, '°', '≤ 0.1',
               'magpylib getB', inside <= 0.1),
        Figure(6, 'field direction error saturated, all directions', saturated, '°', '≤ 0.5',
               'magpylib getB', saturated <= 0.5),
        Figure(6, 'saturated magnitude against the largest possible', shortfall, '1', '≤ 1e-6',
               'scipy linprog', shortfall <= 1e-6),
    ]


def _largest(coils: CoilSet, matrix: np.ndarray, unit: np.ndarray) -> float:
    limits = [(-limit, limit) for limit in coils.max_current]
    solution = linprog([0, 0, 0, 0, -1], A_eq=np.column_stack([1e3 * matrix, -unit]),
                       b_eq=-1e3 * coils.background, bounds=[*limits, (0, None)])
    return 1e-3 * float(solution.x[4])


def _times(coils: CoilSet) -> list[Figure]:
    allocator = Allocator(coils)
    rng = np.random.default_rng(2)
    units = rng.normal(size=(_BATCH, 2))
    units /= np.linalg.norm(units, axis=1, keepdims=True)

    def allocate_all(fields: np.ndarray) -> None:
        for field in fields:
            allocator.allocate(field)

    inside, saturated = (1e6 * time / _BATCH for time in seconds(
        partial(allocate_all, 2e-3 * units), partial(allocate_all, 50e-3 * units), rounds=99))
    return [
        Figure(3, 'currents for one wanted field', inside, 'µs', '≤ 20', '', inside <= 20),
        Figure(6, 'allocation, one field, inside limits', inside, 'µs', '≤ 30', '', inside <= 30),
        Figure(6, 'allocation, one field, saturated', saturated, 'µs', '≤ 300', '',
               saturated <= 300),
    ]
