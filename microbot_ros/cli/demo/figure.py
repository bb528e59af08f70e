"""Figure of the demo: paths, estimates over time, goal error, latency."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from microbot_ros.cli.demo.results import LAST_SECONDS, DemoRun

COLOURS = ('#0072B2', '#D55E00', '#009E73', '#CC79A7', '#E69F00', '#56B4E9')
"""Palette of Okabe and Ito (2008), which colour-blind people can distinguish."""


def draw(run: DemoRun, goal: np.ndarray, unit: str, path: Path) -> None:
    """Draw the figure of a run.

    Parameters
    ----------
    run : DemoRun
        The run.
    goal : ndarray, shape (2,)
        Last goal [m].
    unit : str
        Unit of speeds.
    path : Path
        File to write.
    """
    figure = Figure(figsize=(12, 8), layout='constrained')
    axes = figure.subplot_mosaic([['paths', 'speed'], ['paths', 'phi'], ['error', 'latency']])
    colours = {p: COLOURS[i % len(COLOURS)] for i, p in enumerate(sorted(run.matches))}
    _paths(axes['paths'], run, colours)
    _estimates(axes['speed'], run, colours, 'speed', 1e6, f'v [{unit}]')
    _estimates(axes['phi'], run, colours, 'phi', 1.0, 'φ [rad]')
    _error(axes['error'], run, goal)
    _latency(axes['latency'], run)
    figure.savefig(path, dpi=110)


def _paths(axes: Axes, run: DemoRun, colours: dict[int, str]) -> None:
    for particle, colour in colours.items():
        _, x, y = run.path(run.particles, particle).T
        axes.plot(x * 1e6, y * 1e6, color=colour, linewidth=1)
        axes.plot(x[0] * 1e6, y[0] * 1e6, 'o', color=colour, markersize=4)
        axes.annotate(str(particle), (x[-1] * 1e6, y[-1] * 1e6), color=colour,
                      xytext=(4, 4), textcoords='offset points', weight='bold')
    for _, places in run.goals:
        x, y = places.T * 1e6
        axes.plot(x, y, 'k+', markersize=12, markeredgewidth=2, label='goals, in order')
        for number, (gx, gy) in enumerate(zip(x, y, strict=True), 1):
            axes.annotate(str(number), (gx, gy), xytext=(6, -12), textcoords='offset points')
    axes.set(title=f'Tracked paths; ● start; particle {run.steered} is steered',
             xlabel='x [µm]', ylabel='y [µm]', aspect='equal')
    axes.legend(loc='upper left', bbox_to_anchor=(1, 1))


def _estimates(axes: Axes, run: DemoRun, colours: dict[int, str], what: str, scale: float,
               label: str) -> None:
    true_at_end = {int(p['id']): p for p in run.truth[max(run.truth)]}
    for particle, colour in colours.items():
        rows = np.array([
            (t - run.origin, found[what], found[f'{what}_std'])
            for t, points in sorted(run.estimates.items())
            for found in points[points['id'] == particle]])
        known = rows[np.isfinite(rows[:, 2])]
        truth = float(true_at_end[run.matches[particle]][what])
        if what == 'phi':
            known[:, 1] = truth + np.angle(np.exp(1j * (known[:, 1] - truth)))
        t, value, std = known.T
        axes.axhline(truth * scale, color=colour, linestyle='--', linewidth=0.8)
        axes.plot(t, value * scale, color=colour, linewidth=1)
        axes.fill_between(t, (value - 1.96 * std) * scale, (value + 1.96 * std) * scale,
                          color=colour, alpha=0.2, linewidth=0)
    truths = np.array([float(p[what]) for p in true_at_end.values()]) * scale
    margin = 1.5 if what == 'speed' else 1.0
    axes.set(ylabel=label, xlabel='time [s]', ylim=(truths.min() - margin, truths.max() + margin),
             title='Estimate, 95 % band; dashed: truth' if what == 'speed' else '')


def _error(axes: Axes, run: DemoRun, goal: np.ndarray) -> None:
    t, x, y = run.path(run.truth, run.matches[run.steered]).T
    axes.plot(t, np.hypot(x - goal[0], y - goal[1]) * 1e6, color=COLOURS[0])
    axes.axhline(5.0, color='gray', linestyle=':', label='5 µm')
    axes.axvspan(t[-1] - LAST_SECONDS, t[-1], color='gray', alpha=0.15,
                 label=f'last {LAST_SECONDS:g} s')
    axes.set(title='True distance to the last goal', xlabel='time [s]', ylabel='distance [µm]')
    axes.legend(loc='upper right')


def _latency(axes: Axes, run: DemoRun) -> None:
    milliseconds = run.latency * 1e3
    if len(milliseconds):
        axes.hist(milliseconds, bins=60, range=(0, max(30.0, np.percentile(milliseconds, 99.5))),
                  color=COLOURS[0])
        for q, style in ((50, '-'), (99, '--')):
            value = float(np.percentile(milliseconds, q))
            axes.axvline(value, color=COLOURS[1], linestyle=style, label=f'p{q} {value:.1f} ms')
        axes.legend(loc='upper right')
    axes.set(title='From exposure to the amplifier’s acknowledgement', xlabel='latency [ms]',
             ylabel='frames')
