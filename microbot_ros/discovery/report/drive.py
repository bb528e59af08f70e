"""Advance of rollers per turn of the field by frequency, as measured and as modelled."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from microbot_ros.discovery.report.residual import Residual

BINS = 14
"""Maximum number of frequency bins. Choice: points stay apart in a figure of 7.5 inches."""


@dataclass(frozen=True)
class Drive:
    """Gains at B frequencies, means over the particles.

    Attributes
    ----------
    frequency : ndarray, shape (B,)
        Frequencies [Hz], ascending.
    measured, measured_std : ndarray, shape (B,)
        Measured gain and standard deviation [m/s/Hz].
    found, plain : ndarray, shape (B,)
        Gain expected by the final and the first-order model [m/s/Hz].
    """

    frequency: np.ndarray
    measured: np.ndarray
    measured_std: np.ndarray
    found: np.ndarray
    plain: np.ndarray


def drive(left: Residual, phi: np.ndarray, diffusion: float) -> Drive | None:
    """Return the gains of particles by frequency.

    Displacements along the heading are regressed on the path of unit speed: those measured, and
    those that the models expect.

    Parameters
    ----------
    left : Residual
        Residuals of the session.
    phi : ndarray, shape (N,)
        Angle of travel from the field [rad].
    diffusion : float
        D [m²/s].

    Returns
    -------
    Drive or None
        None for fewer than 3 frequencies.
    """
    frequency = np.abs(left.commands.frequency_at(left.times[:-1]))
    levels = np.unique(np.round(frequency[frequency > 0], 6))
    if len(levels) < 3:
        return None
    edges = np.append(
        0.0, levels if len(levels) <= BINS else np.geomspace(levels[0], levels[-1], BINS))
    edges[-1] = np.inf
    use = (np.isfinite(np.diff(left.found[..., 0], axis=0)) & ~left.jumps[1:]
           & (frequency > 0)[:, None])
    unit = _steps(left.path, use)
    measured = _steps(left.places, use)
    which = np.broadcast_to(
        np.searchsorted(edges, np.round(frequency, 6))[:, None] - 1, use.shape)[use]
    power = np.bincount(which, np.abs(unit) ** 2)
    turned = np.conj(unit * np.exp(1j * np.broadcast_to(phi, use.shape)[use]))
    measured_gain, by_found, by_plain = (
        np.bincount(which, (turned * (measured - missed)).real) / np.maximum(power, 1e-300)
        for missed in (0, _steps(left.found, use), _steps(left.plain, use)))
    spread = 2 * diffusion * np.broadcast_to(np.diff(left.times)[:, None], use.shape)[use]
    std = np.sqrt(np.bincount(which, np.abs(unit) ** 2 * spread)) / np.maximum(power, 1e-300)
    middles = np.bincount(which, np.broadcast_to(frequency[:, None], use.shape)[use])
    # Bins with few data are left out.
    known = (power > 0) & (std < np.abs(by_plain))
    return Drive(*(column[known] for column in (
        middles / np.maximum(np.bincount(which), 1), measured_gain, std, by_found, by_plain)))


def _steps(positions: np.ndarray, use: np.ndarray) -> np.ndarray:
    step: np.ndarray = np.diff(positions, axis=0)[use] @ np.array([1, 1j])
    return step


def draw_drive(found: Drive, before: str, after: str) -> Figure:
    """Draw the gain by frequency.

    Parameters
    ----------
    found : Drive
        Measured and expected gains.
    before, after : str
        Colours of the first-order and the final model.

    Returns
    -------
    Figure
        With 95 % error bars.
    """
    figure = Figure(figsize=(7.5, 3.2), layout='constrained')
    axis = figure.subplots()
    axis.errorbar(found.frequency, found.measured * 1e6, 1.96 * found.measured_std * 1e6,
                  fmt='ko', ms=4, lw=0.9, label='measured ± 95 %')
    axis.plot(found.frequency, found.plain * 1e6, ':', color=before, label='first-order model')
    axis.plot(found.frequency, found.found * 1e6, '-', color=after, label='model found')
    axis.set_xscale('log')
    axis.xaxis.set_major_formatter('{x:g}')
    axis.set_xlabel('rotation (Hz)')
    axis.set_ylabel('speed over frequency (µm/s/Hz)')
    axis.legend(frameon=False, loc='upper left', bbox_to_anchor=(1, 1))
    axis.spines[['top', 'right']].set_visible(False)
    return figure
