"""Fit for people and programs: `fit.json`, a table and a figure."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from microbot_ros.common.units import from_si, symbol
from microbot_ros.estimation.batch import FitResult
from microbot_ros.estimation.one_leg_regression import Leg

if TYPE_CHECKING:
    from rich.table import Table


def speed_key(fit: FitResult) -> str:
    """Return the name of a particle's speed in the files of a fit.

    Parameters
    ----------
    fit : FitResult
        The fit.

    Returns
    -------
    str
        `v_um_s`, or `gain_um_s_hz` for rollers.
    """
    return 'gain_um_s_hz' if fit.rolling else 'v_um_s'


def as_json(fit: FitResult) -> dict[str, Any]:
    """Return the content of `fit.json`, in the form of `baseline` in `result.json`.

    Parameters
    ----------
    fit : FitResult
        The fit.

    Returns
    -------
    dict
        Numbers in the units of their names; None where unknown.
    """
    speeds, key = fit.polar, speed_key(fit)
    particles = {}
    for n, name in enumerate(fit.ids):
        particles[str(name)] = {
            key: _number(key, speeds.speed[n], speeds.speed_std[n]),
            'phi_rad': _number(
                'phi_rad', _seen(speeds.phi[n], speeds.phi_std[n]), speeds.phi_std[n]),
            'force_pN': _number('force_pN', fit.force[n], fit.force_std[n]),
            'one_leg': _leg(fit.legs[n], key),
        }
    noise = fit.noise
    return {
        'particles': particles,
        'diffusion_um2_s': _number('x_um2_s', noise.diffusion, noise.diffusion_std),
        'localisation_um': _number('x_um', noise.localisation, noise.localisation_std),
        'delay_s': _number('x_s', _seen(fit.delay.value, fit.delay.std), fit.delay.std),
        'warnings': fit.warnings,
    }


def _seen(value: float, std: float) -> float:
    """Return a value that a fit begins from 0, or NaN where nothing told it otherwise."""
    return float(value) if np.isfinite(std) else np.nan


def _number(name: str, value: float, std: float) -> dict[str, float | None]:
    return {
        part: float(from_si(name, number)) if np.isfinite(number) else None
        for part, number in (('value', float(value)), ('std', float(std)))
    }


def _leg(leg: Leg, key: str) -> dict[str, Any]:
    return {
        key: _number(key, leg.speed, leg.speed_std),
        'phi_rad': _number('x_rad', leg.phi, leg.phi_std),
        'from_s': leg.start if np.isfinite(leg.start) else None,
        'to_s': leg.end if np.isfinite(leg.end) else None,
    }


def table(fit: FitResult) -> Table:
    """Return a table of every particle with 95 % intervals, beside the one-leg method.

    Parameters
    ----------
    fit : FitResult
        The fit.

    Returns
    -------
    rich.table.Table
        One row per particle.
    """
    from rich.table import Table

    unit = symbol(speed_key(fit))
    name = 'gain' if fit.rolling else 'v'
    shown = Table(
        'particle', f'{name} [{unit}]', 'φ [°]', *([] if fit.rolling else ['F [pN]']),
        f'one leg: {name}', 'φ [°]', title='± is the 95 % interval',
    )
    speeds = fit.polar
    for n, particle in enumerate(fit.ids):
        leg = fit.legs[n]
        cells = [
            _interval(speeds.speed[n] * 1e6, speeds.speed_std[n] * 1e6),
            _interval(np.degrees(_seen(speeds.phi[n], speeds.phi_std[n])),
                      np.degrees(speeds.phi_std[n])),
            _interval(fit.force[n] * 1e12, fit.force_std[n] * 1e12),
            _interval(leg.speed * 1e6, leg.speed_std * 1e6),
            _interval(np.degrees(leg.phi), np.degrees(leg.phi_std)),
        ]
        if fit.rolling:
            del cells[2]
        shown.add_row(str(particle), *cells)
    return shown


def _interval(value: float, std: float) -> str:
    if not np.isfinite(value):
        return '–'
    return f'{value:.3g}' if not np.isfinite(std) else f'{value:.3f} ± {1.96 * std:.2g}'


def figure(fit: FitResult, path: Path) -> None:
    """Draw a fit: intervals beside the one-leg method, and measured and modelled tracks.

    Parameters
    ----------
    fit : FitResult
        The fit.
    path : Path
        Image file.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    canvas = FigureCanvasAgg(Figure(figsize=(11, 4.2), layout='constrained'))
    left, middle, right = canvas.figure.subplots(1, 3, width_ratios=[1, 1, 1.6])
    speeds, legs = fit.polar, fit.legs
    label = 'gain [µm/s/Hz]' if fit.rolling else 'v [µm/s]'
    _compare(left, fit, label, speeds.speed * 1e6, speeds.speed_std * 1e6,
             [leg.speed * 1e6 for leg in legs], [leg.speed_std * 1e6 for leg in legs])
    _compare(middle, fit, 'φ [°]', np.degrees(speeds.phi), np.degrees(speeds.phi_std),
             np.degrees(beside(np.array([leg.phi for leg in legs]), speeds.phi)).tolist(),
             [np.degrees(leg.phi_std) for leg in legs])
    left.legend(frameon=False, fontsize='small', title='95 % intervals', loc='upper center',
                bbox_to_anchor=(0.5, -0.15))
    for n, name in enumerate(fit.ids):
        measured, predicted = fit.measured[:, n] * 1e6, fit.predicted[:, n] * 1e6
        right.plot(measured.real, measured.imag, lw=1.2, color=f'C{n % 10}', label=f'{name}')
        right.plot(predicted.real, predicted.imag, '--', color='0.25', lw=0.8)
    right.set(xlabel='x [µm]', ylabel='y [µm]', aspect='equal',
              title='tracks; dashed: the fitted model from the start')
    right.title.set_fontsize('medium')
    if len(fit.ids) <= 12:
        right.legend(title='particle', frameon=False, fontsize='small', loc='upper left',
                     bbox_to_anchor=(1, 1))
    canvas.figure.savefig(path, dpi=130)


def beside(angle: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Add whole turns to angles so that they are as near as possible to other angles.

    Parameters
    ----------
    angle : ndarray, shape (N,)
        Angles [rad].
    other : ndarray, shape (N,)
        Other angles [rad].

    Returns
    -------
    ndarray, shape (N,)
        Angles within π of the others [rad].
    """
    return other + np.angle(np.exp(1j * (angle - other)))


def _compare(axes: Any, fit: FitResult, label: str, value: np.ndarray, std: np.ndarray,
             leg: list[float], leg_std: list[float]) -> None:
    at = np.arange(len(fit.ids))
    axes.errorbar(at - 0.12, value, 1.96 * std, fmt='o', capsize=3, label='likelihood')
    axes.errorbar(at + 0.12, leg, 1.96 * np.array(leg_std), fmt='s', capsize=3, color='0.6',
                  label='one leg')
    axes.set(xlabel='particle', ylabel=label, xlim=(-0.5, len(at) - 0.5))
    step = max(1, len(at) // 12)
    axes.set_xticks(at[::step], [str(name) for name in fit.ids[::step]])
