"""Numbers of the paper and of its repetition."""

from __future__ import annotations

from typing import Any

import numpy as np

from microbot_ros.magnetics.coils import CoilSet
from microbot_ros.magnetics.force import MagneticParticle, force_speed, negligible_radius
from microbot_ros.paper.repetition import (
    APPROACHES,
    CAMERA,
    FIELD,
    FLUID,
    MOMENT,
    RADIUS,
    Trial,
    constants,
)

# As printed, in the units of the names.
PRINTED: dict[str, Any] = {
    'rmse_um': {'own': (4.11, 5.62, 4.02), 'mean': (6.91, 5.56, 5.77)},
    'rmse_mean_um': 4.59,
    'run_time_s': {
        'Newton–Stokes, translation, stiff solver': 2.13, 'first-order, Euler at 0.02 s': 2.04},
    'translation_us': 3.72,
    'rotation_us': 1.11,
    'distance_nm': (40.3, 47.5, 54.0),
}

ASSUMED = (
    f'radius 4.6 µm, which the paper’s mass and time constants agree with, though its text calls '
    f'4.6 µm the diameter; Brownian motion by Stokes–Einstein at {FLUID.temperature:.2f} K',
    f'field of {FIELD * 1e3:g} mT, the same everywhere and without a background',
    f'magnetic moment of {MOMENT:.2g} A·m² (1 kA/m), the same for all, fixed in the body',
    f'camera at {CAMERA.frame_rate:g} frames/s with the shutter always open, localisation to '
    f'{CAMERA.noise * 1e6:g} µm, nothing missed',
    'legs of 2–6 s in directions drawn evenly from the circle; F and φ from the longest leg',
    'no walls, no flow, no interaction, no drift, constant fuel',
)
"""Conditions that the paper does not state, as sentences for the page."""


def summarise(trials: list[Trial], run_times: dict[str, float]) -> dict[str, Any]:
    """Return all numbers of the page, ready for JSON, with units in the names.

    `run_times` [s] by solver, as from `repetition.run_times`.

    Parameters
    ----------
    trials : list of Trial
        The trials.
    run_times : dict of str to float
        Time [s] by solver, as from `repetition.run_times`.

    Returns
    -------
    dict of str to object
        Values by name.
    """
    by_solver = {
        solver: {a: np.array([getattr(t, kind)[a] for t in trials]) for a in APPROACHES}
        for solver, kind in (('first_order', 'rmse'), ('newton_stokes', 'rmse_stokes'))}
    return {
        'simulation': True,
        'seeds': [trial.seed for trial in trials],
        'assumed': list(ASSUMED),
        'rmse_um': {
            solver: {a: _spread(values) for a, values in approaches.items()}
            for solver, approaches in by_solver.items()},
        'rmse_printed_um': PRINTED['rmse_um'],
        'rmse_printed_mean_um': PRINTED['rmse_mean_um'],
        'solvers_differ_by_um': max(
            float(np.abs(by_solver['first_order'][a] - by_solver['newton_stokes'][a]).max() * 1e6)
            for a in APPROACHES),
        'run_time_s': run_times,
        'run_time_printed_s': PRINTED['run_time_s'],
        'constants': _constants(),
        'magnetic_force': _magnetic_force(),
    }


def _spread(rmse: np.ndarray) -> dict[str, Any]:
    """Return mean and standard deviation over trials `rmse` (R, 3), and the mean of all [µm]."""
    rmse = rmse * 1e6
    return {
        'particles': rmse.mean(axis=0).tolist(),
        'std': rmse.std(axis=0, ddof=min(1, len(rmse) - 1)).tolist(),
        'mean': float(rmse.mean()),
    }


def _constants() -> dict[str, Any]:
    known = constants()
    distances = np.array([known[f'distance_{i}_m'] for i in (1, 2, 3)]) * 1e9
    return {
        'translation_us': known['translation_s'] * 1e6,
        'rotation_us': known['rotation_s'] * 1e6,
        'alignment_ms': float(known['alignment_s'] * 1e3),
        'diffusion_um2_s': known['diffusion_m2_s'] * 1e12,
        'speed_um_s': [known[f'speed_{i}_m_s'] * 1e6 for i in (1, 2, 3)],
        'distance_300_tau_nm': distances.tolist(),
        'printed_over_recomputed': (np.array(PRINTED['distance_nm']) / distances).tolist(),
        'part_of_radius': float(distances.max() * 1e-9 / RADIUS),
    }


def _magnetic_force() -> dict[str, float]:
    """Return the force on the paper's slowest particle, at the corner of a 0.2 mm square."""
    particle, coils = MagneticParticle(radius=RADIUS, viscosity=FLUID.viscosity), CoilSet()
    corner = np.array([[0.1e-3, 0.1e-3]])
    speed = force_speed(coils, corner, FIELD, particle)[0]
    return {
        'speed_at_corner_um_s': float(speed * 1e6),
        'part_of_propulsion': float(speed / particle.speed),
        'negligible_within_mm': negligible_radius(coils, FIELD, particle) * 1e3,
    }
