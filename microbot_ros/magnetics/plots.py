"""Figure of a coil calibration."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from microbot_ros.common.units import from_si
from microbot_ros.magnetics.calibration import Calibration, Readings


def draw_calibration(calibration: Calibration, readings: Readings, path: str | Path) -> None:
    """Save a figure of measured over fitted field, the residuals, and the gain of each coil.

    `calibration` was fitted to `readings`; `path` is the image file.

    Parameters
    ----------
    calibration : Calibration
        The calibration.
    readings : Readings
        Readings that it was fitted to.
    path : str or Path
        Image file to write.
    """
    from matplotlib.figure import Figure
    figure = Figure(figsize=(9, 4.5), layout='constrained')
    grid = figure.add_gridspec(2, 2, width_ratios=(3, 2), height_ratios=(2, 1))
    above, below = figure.add_subplot(grid[0, 0]), figure.add_subplot(grid[1, 0])
    measured = from_si('_mT', readings.field)
    residual = from_si('_mT', calibration.residuals)
    for axis, name in enumerate('xyz'):
        if np.isfinite(measured[:, axis]).all():
            fitted = measured[:, axis] - residual[:, axis]
            above.plot(fitted, measured[:, axis], '.', color=f'C{axis}', label=f'$B_{name}$')
            below.plot(fitted, residual[:, axis], '.', color=f'C{axis}')
    above.axline((0, 0), slope=1, color='0.7', linewidth=0.8, zorder=0)
    above.set(ylabel='measured [mT]', title='Readings')
    above.tick_params(labelbottom=False)
    above.sharex(below)
    above.legend(loc='upper left')
    below.axhline(0, color='0.7', linewidth=0.8, zorder=0)
    below.set(xlabel='fitted [mT]', ylabel='residual [mT]')
    gains = figure.add_subplot(grid[:, 1])
    rows = range(len(calibration.names))
    gains.errorbar(calibration.gain, rows, xerr=2 * calibration.gain_std, fmt='o', capsize=3)
    gains.axvline(1, color='0.7', linewidth=0.8, zorder=0)
    gains.axvline(0, color='black', linewidth=0.8, zorder=0)
    gains.set_yticks(rows, calibration.names)
    gains.invert_yaxis()
    gains.set(xlabel='measured over computed field', title='Gain with sign, ± 2 std')
    figure.savefig(path, dpi=150)
