"""Figure of a learned term: its curve, or its map, with the band."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from microbot_ros.common.units import from_si, symbol
from microbot_ros.discovery.report.figures import AFTER, BEFORE
from microbot_ros.model.learned_term import AXES, LearnedTerm

_WORDS = {
    'x_um': 'x', 'y_um': 'y', 'time_s': 'time', 'since_switch_s': 'time since the last switch',
    'angle_rad': 'angle', 'field_mT': 'field', 'frequency_hz': 'rotation',
    'distance_um': 'distance to a neighbour', 'particle': 'particle',
    'x_um_s': 'velocity along x', 'y_um_s': 'velocity along y',
    'away_um_s': 'velocity away from the neighbour', 'around_um_s': 'velocity around the '
                                                                    'neighbour',
    'factor': 'relative change of the speed', 'turn_rad': 'rotation of the heading',
}
"""Axis labels of covariates and components, without unit."""


def _label(name: str) -> str:
    unit = symbol(name)
    return f'{_WORDS[name]} ({unit})' if unit else _WORDS[name]


def draw_learned(term: LearnedTerm) -> Figure:
    """Draw a learned term against its covariate, where it has data.

    Parameters
    ----------
    term : LearnedTerm
        The term.

    Returns
    -------
    Figure
        Curves with their 95 % band, or a map.
    """
    if term.against == 'position':
        return _map(term)
    figure = Figure(figsize=(11, 3.2), layout='constrained')
    axes = figure.subplots(1, len(term.names), squeeze=False)[0]
    (axis_name,), (knots,) = AXES[term.against], term.axes
    x = np.asarray(from_si(axis_name, knots))
    for k, (axis, name) in enumerate(zip(axes, term.names, strict=True)):
        middle, low, high = (np.where(term.seen, from_si(name, part[:, k]), np.nan)
                             for part in (term.values, term.low, term.high))
        axis.axhline(0, color='#bbbbbb', lw=0.8)
        axis.fill_between(x, low, high, color=AFTER, alpha=0.22, lw=0, label='95 % band')
        axis.plot(x, middle, color=AFTER, marker='o' if len(x) < 30 else None, ms=3.5,
                  label=term.formula or 'curve')
        axis.set_xlabel(_label(axis_name))
        axis.set_ylabel(_label(name))
        axis.spines[['top', 'right']].set_visible(False)
    axes[-1].legend(frameon=False, fontsize=9, loc='upper left', bbox_to_anchor=(1, 1))
    return figure


def _map(term: LearnedTerm) -> Figure:
    figure = Figure(figsize=(6.5, 5.2), layout='constrained')
    axis = figure.subplots()
    x, y = np.meshgrid(*(part * 1e6 for part in term.axes), indexing='ij')
    sure = np.any((term.low > 0) | (term.high < 0), axis=1)
    if term.acts_on == 'velocity':
        _arrows(axis, term, x.ravel(), y.ravel(), sure)
    else:
        name = term.names[0]
        values = np.where(term.seen, from_si(name, term.values[:, 0]), np.nan).reshape(x.shape)
        most = float(np.nanmax(np.abs(values)))
        drawn = axis.pcolormesh(x, y, values, cmap='RdBu_r', vmin=-most, vmax=most)
        figure.colorbar(drawn, label=_label(name))
        inside = term.seen & ~sure
        axis.plot(x.ravel()[inside], y.ravel()[inside], '.', color='#666666', ms=3,
                  label='95 % band includes zero')
        axis.legend(frameon=False, fontsize=8, loc='lower left', bbox_to_anchor=(0, 1))
    axis.set_xlabel('x (µm)')
    axis.set_ylabel('y (µm)')
    axis.set_aspect('equal')
    return figure


def _arrows(axis: Axes, term: LearnedTerm, x: np.ndarray, y: np.ndarray,
            sure: np.ndarray) -> None:
    u, v = (term.values * 1e6).T
    drawn = term.seen
    arrows = axis.quiver(x[drawn], y[drawn], u[drawn], v[drawn], angles='xy', width=0.004,
                         color=np.where(sure[drawn], BEFORE, '#bbbbbb'))
    typical = float(f'{np.quantile(np.hypot(u, v)[drawn], 0.8):.1g}')
    axis.quiverkey(arrows, 0.75, 1.04, typical, f'{typical:g} µm/s', labelpos='E')
    axis.set_title('grey: the 95 % band includes zero', fontsize=9, loc='left')
    axis.margins(0.12)
