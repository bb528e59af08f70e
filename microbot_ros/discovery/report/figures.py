"""Figures of the report: gap, residual maps, field of place, and tracks in the predicted band."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from microbot_ros.discovery.report.prediction import Prediction
from microbot_ros.discovery.report.residual import Residual, by_place
from microbot_ros.discovery.report.words import chance, number
from microbot_ros.discovery.result import Gap, ResidualMap

BEFORE, AFTER, FLOOR = '#D55E00', '#0072B2', '#999999'
"""First-order model, final model and noise floor, in Okabe and Ito's colours.

Colour-blind readers can distinguish them; markers and line styles say the same.
"""

COMPONENTS: tuple[dict[str, Any], ...] = (
    {'marker': 'o', 'ls': '-'}, {'marker': 's', 'ls': '--'})
"""Styles of the first and second component of a residual."""

COLUMNS = 4
"""Panels in a row of residual maps: the width of a page."""

MOST_PARTICLES = 4
"""Particles drawn with their band. Choice: each takes a row of the page."""

ARROW = 0.07
"""Length of a typical arrow, relative to the width of a panel. Choice: about that of a place if
100 are visited; twice as long ones cross each other."""

MOST_POINTS = 500
"""Points of a curve. Choice: about one for each pixel of a panel."""


def embedded(figure: Figure) -> str:
    """Return a figure as a data URI: SVG, the same on every run.

    Parameters
    ----------
    figure : Figure
        The figure.

    Returns
    -------
    str
        `data:image/svg+xml;base64,…`.
    """
    stream = io.BytesIO()
    with mpl.rc_context({'svg.hashsalt': 'microbot_ros'}):
        figure.savefig(stream, format='svg', metadata={'Date': None})
    return 'data:image/svg+xml;base64,' + base64.b64encode(stream.getvalue()).decode()


def draw_gap(gap: Gap) -> Figure:
    """Draw the prediction errors before and after, beside the noise floor.

    Parameters
    ----------
    gap : Gap
        Errors on held-out data.

    Returns
    -------
    Figure
        Bars in µm.
    """
    figure = Figure(figsize=(7.5, 1.9), layout='constrained')
    axis = figure.subplots()
    bars = {'before': gap.before, 'after': gap.after, 'noise floor': gap.floor}
    if np.isfinite(gap.learned):
        bars = {'before': gap.before, 'after the names': gap.after,
                'after the learned term': gap.learned, 'noise floor': gap.floor}
    if np.isfinite(gap.truth):
        bars['true model'] = gap.truth
    values = np.array(list(bars.values())) * 1e6
    colours = {'before': BEFORE, 'noise floor': FLOOR, 'true model': 'white'}
    drawn = axis.barh(list(bars), np.nan_to_num(values), edgecolor='#444444',
                      color=[colours.get(name, AFTER) for name in bars])
    axis.bar_label(drawn, [f'{v:.3f} µm' if np.isfinite(v) else 'not known' for v in values],
                   padding=4)
    axis.invert_yaxis()
    axis.margins(x=0.15)
    axis.set_xlabel(f'one coordinate, {gap.horizon:g} s ahead (µm)')
    axis.spines[['top', 'right']].set_visible(False)
    return figure


def draw_maps(before: Sequence[ResidualMap], after: Sequence[ResidualMap]) -> Figure | None:
    """Draw the residual against each covariate, one panel each.

    Parameters
    ----------
    before, after : sequence of ResidualMap
        Maps of the first-order and the final model.

    Returns
    -------
    Figure or None
        None if no map has a curve.
    """
    later = {m.against: m for m in after}
    drawn = [m for m in before if any(len(mean) > 1 for mean, _ in m.curves.values())]
    if not drawn:
        return None
    rows = -(-len(drawn) // COLUMNS)
    figure = Figure(figsize=(3.1 * COLUMNS, 2.7 * rows + 0.4), layout='constrained')
    axes = figure.subplots(rows, COLUMNS, squeeze=False).ravel()
    for axis, first in zip(axes, drawn, strict=False):
        _map(axis, first, later.get(first.against, first))
    for axis in axes[len(drawn):]:
        axis.set_visible(False)
    keys = [mpl.lines.Line2D([], [], color=colour, lw=2, label=label) for colour, label in (
        (BEFORE, 'before: first-order model'), (AFTER, 'after: model found'))]
    figure.legend(handles=keys, loc='outside upper right', ncols=2, frameon=False)
    return figure


def _map(axis: Axes, before: ResidualMap, after: ResidualMap) -> None:
    """Draw one panel: the first component filled and solid, the second open and dashed."""
    axis.axhline(0, color='#bbbbbb', lw=0.8)
    for found, colour in ((before, BEFORE), (after, AFTER)):
        for style, (name, (mean, error)) in zip(COMPONENTS, found.curves.items(), strict=False):
            if name == 'power':
                axis.plot(*_peaks(found.middles, mean), color=colour, lw=0.8)
                axis.set_ylabel('power (χ²)', fontsize=8)
                continue
            axis.errorbar(found.middles, mean * 1e6, error * 1e6, lw=0.9, ms=3.5, elinewidth=0.7,
                          color=colour, **style, mfc=colour if style['ls'] == '-' else 'white')
            axis.set_ylabel('residual (µm/s)', fontsize=8)
    if 'power' not in before.curves:
        names = ', '.join(f'{m} {n}' for m, n in zip('●□', before.curves, strict=False))
        axis.text(0.02, 0.98, names, transform=axis.transAxes, fontsize=7, va='top')
    # y: or every draw measures all labels to find out whether the title must move.
    axis.set_title(f'{before.against}\n{_p(before)} → {_p(after)}', y=1.0, fontsize=9,
                   fontweight='bold' if after.fires else 'normal',
                   color=BEFORE if after.fires else 'black')
    if before.label == 'particle':
        axis.xaxis.set_major_locator(MaxNLocator(integer=True))
    axis.set_xlabel(before.label.replace('[', '(').replace(']', ')'), fontsize=8)
    axis.tick_params(labelsize=7)
    axis.margins(y=0.15)
    axis.spines[['top', 'right']].set_visible(False)


def _peaks(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a curve reduced to as many points as a figure shows, with its peaks."""
    group = -(-len(x) // MOST_POINTS)
    starts = np.arange(0, len(x), group)
    return x[starts], np.maximum.reduceat(y, starts)


def _p(found: ResidualMap) -> str:
    """Return a p-value short enough for a title."""
    return (f'{found.p_value:.2f}' if found.p_value >= 0.01
            else chance(found.p_value).removeprefix('p ').removeprefix('= '))


def draw_bands(prediction: Prediction) -> Figure:
    """Draw measured less predicted coordinates of the first particles.

    The scale fits usual deviations: single excursions leave the figure.

    Parameters
    ----------
    prediction : Prediction
        Predictions of one session.

    Returns
    -------
    Figure
        Both coordinates, with the predicted 90 % band.
    """
    shown = prediction.measured[:MOST_PARTICLES]
    figure = Figure(figsize=(11, 1.9 * len(shown) + 0.6), layout='constrained')
    axes = figure.subplots(len(shown), 2, sharex=True, squeeze=False)
    for n, row in enumerate(axes):
        for k, (axis, name) in enumerate(zip(row, 'xy', strict=True)):
            _band(axis, prediction, n, k)
            axis.set_ylabel(f'particle {prediction.names[n]}: {name} (µm)', fontsize=8)
    for axis in axes[-1]:
        axis.set_xlabel('time (s)')
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc='outside upper center', ncols=3, frameon=False)
    return figure


def _band(axis: Axes, prediction: Prediction, n: int, k: int) -> None:
    every = slice(None, None, -(-len(prediction.times) // MOST_POINTS))
    t, half = prediction.times[every], prediction.band[n, every] * 1e6
    # Lines are interrupted where a prediction restarts.
    fresh = np.diff(prediction.elapsed[n, every], prepend=np.inf) < 0
    half[fresh] = np.nan
    found, plain = (np.where(fresh, np.nan, left[n, every, k]) * 1e6
                    for left in (prediction.measured, prediction.without))
    axis.fill_between(t, -half, half, color=AFTER, alpha=0.22, lw=0,
                      label='5–95 % of the model found')
    axis.plot(t, plain, ':', color=BEFORE, lw=1.1, label='measured − first-order model')
    axis.plot(t, found, '-', color='black', lw=0.8, label='measured − model found')
    usual, other = (float(np.quantile(known, 0.9)) if (
        known := np.abs(left[np.isfinite(left)])).size else 0.0 for left in (found, plain))
    widest = float(np.max(half, where=np.isfinite(half), initial=0.0))
    reach = max(1.3 * widest, 2 * usual, min(other, 4 * usual))
    if reach > 0:
        axis.set_ylim(-reach, reach)
    axis.tick_params(labelsize=8)
    axis.spines[['top', 'right']].set_visible(False)


def draw_places(left: Residual, diffusion: float) -> Figure | None:
    """Draw the mean residual velocity by place, before and after.

    Arrows longer than three standard errors, √(2D/time spent there), are dark. Both have one
    scale.

    Parameters
    ----------
    left : Residual
        Residuals of the session.
    diffusion : float
        D [m²/s].

    Returns
    -------
    Figure or None
        None if no place was visited enough.
    """
    before, after = (by_place(left, positions) for positions in (left.plain, left.found))
    if not (len(before[0]) and len(after[0])):
        return None
    typical = float(f'{np.quantile(np.hypot(*before[1].T), 0.8) * 1e6:.1g}') or 1.0
    places = 1e6 * np.concatenate([before[0], after[0]])
    margin = np.maximum(0.15 * np.ptp(places, axis=0), 1.0)  # who rests has a single place
    x_limits, y_limits = np.stack([places.min(axis=0) - margin, places.max(axis=0) + margin], 1)
    figure = Figure(figsize=(11, 4.6), layout='constrained')
    axes = figure.subplots(1, 2, sharex=True, sharey=True)
    for axis, title, colour, (place, velocity, time) in zip(
            axes, ('before: first-order model', 'after: model found'), (BEFORE, AFTER),
            (before, after), strict=True):
        sure = np.hypot(*velocity.T) > 3 * np.sqrt(2 * diffusion / time)
        arrows = axis.quiver(
            *(place.T * 1e6), *(velocity.T * 1e6), angles='xy', width=0.004,
            scale=typical / ARROW, scale_units='width', color=np.where(sure, colour, '#bbbbbb'))
        axis.quiverkey(arrows, 0.85, 1.03, typical, f'{number(typical)} µm/s', labelpos='E',
                       fontproperties={'size': 9}, color='black')
        axis.set_title(title, fontsize=10, loc='left', pad=18)  # above the key
        axis.set_xlabel('x (µm)')
        axis.set_aspect('equal')
        axis.set(xlim=x_limits, ylim=y_limits)
    axes[0].set_ylabel('y (µm)')
    return figure
