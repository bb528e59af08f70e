"""Figures of the calibrations of camera and coils."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from microbot_ros.discovery.check.coil_map import CoilMap
    from microbot_ros.estimation.camera_turn import CameraTurn
    from microbot_ros.tracking.graticule import Graticule


def draw_camera(path: Path, turn: CameraTurn | None, image: np.ndarray | None,
                lines: Graticule | None) -> None:
    """Draw the direction of each particle, and the lines of a graticule.

    Parameters
    ----------
    path : Path
        File to write.
    turn : CameraTurn or None
        Result of the particles; None for none.
    image : ndarray or None
        Picture of the graticule; None for none.
    lines : Graticule or None
        Lines in it; None for none.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 4.5), layout='constrained')
    if turn:
        _directions(figure.add_subplot(1, 2, 1, projection='polar'), turn)
    if image is not None and lines:
        _lines(figure.add_subplot(1, 2, 2 if turn else 1), image, lines)
        if not turn:
            _profile(figure.add_subplot(1, 2, 2), image, lines)
    figure.savefig(path, dpi=150)


def _directions(axes: Any, turn: CameraTurn) -> None:
    for angle, std in zip(turn.angle, turn.angle_std, strict=True):
        spread = np.linspace(angle - 1.96 * std, angle + 1.96 * std, 20)
        axes.plot([angle, angle], [0, 1], color='C0', linewidth=1)
        axes.plot(spread, np.ones(20), color='C0', linewidth=2)
    if turn.known:
        axes.plot([turn.turn] * 2, [0, 1.1], color='C3', linewidth=2)
        spread = np.linspace(turn.turn - turn.interval, turn.turn + turn.interval, 40)
        axes.fill_between(spread, 0, 1.1, color='C3', alpha=0.25, linewidth=0)
    axes.set(yticks=[], ylim=(0, 1.15))
    sense = 'against' if turn.mirrored else 'with'
    said = (f'in common {math.degrees(turn.turn):.2f} ± {math.degrees(turn.interval):.2g}°'
            if turn.known else 'no direction in common')
    axes.set_title(f'Particles turn {sense} the command,\ngo beside it: {said}')


def _lines(axes: Any, image: np.ndarray, lines: Graticule) -> None:
    """Draw the picture with every tenth line of the fit."""
    height, width = image.shape
    axes.imshow(image, cmap='gray')
    normal = np.array([math.cos(lines.angle), math.sin(lines.angle)])
    phase = _phase(image, lines)
    corners = np.array([[0, 0], [width, 0], [0, height], [width, height]]) @ normal
    first, last = (corners.min() / lines.period_px, corners.max() / lines.period_px)
    for k in range(math.ceil(first - phase), math.floor(last - phase) + 1):
        if k % 10 == 0:
            foot = (k + phase) * lines.period_px * normal
            axes.axline(foot, foot + normal[::-1] * [-1, 1], color='C3', linewidth=0.7)
    axes.set(xlim=(0, width), ylim=(height, 0), xlabel='x [px]', ylabel='y [px]',
             title=f'Every tenth line found\n{lines.period_px:.3f} ± '
                   f'{1.96 * lines.period_std_px:.1g} px from line to line')


def _profile(axes: Any, image: np.ndarray, lines: Graticule) -> None:
    """Draw the grey level over the position within a period, averaged over all lines."""
    place, level = _across(image, lines), image.ravel().astype(float)
    bins = np.floor(place * 50).astype(int) % 50
    mean = np.bincount(bins, level, 50) / np.maximum(np.bincount(bins, minlength=50), 1)
    axes.plot((np.arange(50) + 0.5) / 50, mean)
    axes.set(xlabel='place between two lines', ylabel='mean grey level',
             title='All lines on top of one another')


def _across(image: np.ndarray, lines: Graticule) -> np.ndarray:
    """Return the position of each pixel across the lines, in periods."""
    y, x = np.indices(image.shape)
    place = (x * math.cos(lines.angle) + y * math.sin(lines.angle)) / lines.period_px
    return np.asarray(place.ravel())


def _phase(image: np.ndarray, lines: Graticule) -> float:
    """Return the position of the lines, dark or bright, in the period."""
    level = image.ravel() - image.mean()
    wave = np.sum(level * np.exp(2j * np.pi * _across(image, lines)))
    # Lines are narrower than the gaps between them: they are the rarer extreme.
    sign = 1.0 if np.mean(level**3) > 0 else -1.0
    return float(np.angle(sign * wave)) / (2 * math.pi)


def draw_coils(found: CoilMap, path: Path) -> None:
    """Draw the directions of particles relative to the command, the fitted field, and residuals.

    Parameters
    ----------
    found : CoilMap
        Result of the calibration.
    path : Path
        File to write.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 4.5), layout='constrained')
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    seen = found.deviations
    at, std = np.degrees(seen.commanded), 2 * np.degrees(seen.std)
    circle = np.linspace(-np.pi, np.pi, 361)
    above.plot(np.degrees(circle), np.degrees(found.expected(circle)), color='C1',
               label=f'fitted field at {1e3 * found.strength:.3g} mT')
    above.errorbar(at, np.degrees(seen.deviation), std, fmt='o', color='C0', markersize=4,
                   label='tracks, ± 2 std')
    gain, skew = found.gain_ratio, found.skew
    above.set(ylabel='beside the command [°]',
              title=f'Gain of y over x coils {gain.value:.3f} ± {gain.std:.3f}, '
                    f'lean {np.degrees(skew.value):.2f} ± {np.degrees(skew.std):.2f}°')
    figure.legend(loc='outside lower center', ncols=2)
    left = np.degrees(seen.deviation - found.expected(seen.commanded))
    below.errorbar(at, left, std, fmt='o', color='C0', markersize=4)
    for axis in (above, below):
        axis.axhline(0, color='0.7', linewidth=0.8, zorder=0)
    below.set(xlabel='commanded direction [°]', ylabel='residual [°]', xlim=(-185, 185),
              xticks=range(-180, 181, 45))
    figure.savefig(path, dpi=150)
