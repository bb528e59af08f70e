"""Figure of a response: speed, distance per turn and slip of every robot, by kind."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from microbot_ros.response.result import Group, Response, Row
from microbot_ros.response.words import COLUMNS

# Okabe and Ito's colours, safe for colour-blind readers; line styles distinguish them in grey.
_MEAN, _LAW, _CUT_IN, _STEP_OUT, _ROBOT = '#0072B2', '#D55E00', '#009E73', '#CC79A7', '#8a8a8a'
_STYLE: dict[Any, Any] = {'font.size': 8, 'axes.linewidth': 0.6, 'axes.spines.top': False,
          'axes.spines.right': False, 'xtick.major.width': 0.6, 'ytick.major.width': 0.6,
          'legend.frameon': False, 'legend.fontsize': 7, 'svg.fonttype': 'none'}
"""Choice: sizes [pt] that stay readable in two columns of a journal."""
_WIDEST_ANGLE = np.radians(60)  # choice: slip angles with a wider 95 % interval are not drawn
_WIDTH, _HEIGHT = 7.2, 2.3
"""Size in inches: two columns of a journal, and a row of panels per kind."""


def draw(found: Response) -> Figure:
    """Draw the response `found`; a row of panels per kind.

    Parameters
    ----------
    found : Response
        The response.

    Returns
    -------
    Figure
        The figure.
    """
    import matplotlib as mpl

    with mpl.rc_context(_STYLE):
        rows = max(len(found.kinds), 1)
        figure = Figure(figsize=(_WIDTH, _HEIGHT * rows + 0.35), layout='constrained')
        panels = figure.subplots(rows, 3, squeeze=False)
        for group, axes in zip(found.kinds, panels, strict=True):
            _draw_group(found, group, axes)
        column, _, unit = COLUMNS[found.against]
        name = {'frequency_hz': 'rotation frequency', 'field_mT': 'field', 'tilt_deg': 'tilt'}
        for axis in panels[-1]:
            axis.set_xlabel(f'{name[column]} ({unit})')
        named = {label: handle for axis in panels[:, 0] for handle, label in zip(
            *axis.get_legend_handles_labels(), strict=True)}
        figure.legend([*named.values()], [*named], loc='outside upper center', ncols=4)
    return figure


def _draw_group(found: Response, group: Group, axes: Sequence[Axes]) -> None:
    own = [row for row in found.rows if row.kind == group.kind]
    for index, robot in enumerate(group.robots):
        _draw_robot(found, [row for row in own if row.robot == robot], axes,
                    'one robot' if index == 0 else '')
    factor = COLUMNS[found.against][1]
    x = np.array([one.level for one in group.common]) * factor
    speeds = np.array([(one.speed.value, one.speed.low, one.speed.high)
                       for one in group.common]) * 1e6
    axes[0].fill_between(x, *speeds[:, 1:].T, color=_MEAN, alpha=0.18, lw=0,
                         label='95 % of the mean')
    axes[0].plot(x, speeds[:, 0], 'o-', color=_MEAN, ms=2.5, lw=1.1, label='mean of the kind')
    if found.against == 'frequency':
        axes[1].fill_between(x, *(speeds[:, 1:] / x[:, None]).T, color=_MEAN, alpha=0.18, lw=0)
        axes[1].plot(x, speeds[:, 0] / x, 'o-', color=_MEAN, ms=2.5, lw=1.1)
        axes[1].set_ylabel('speed / frequency (µm)')
    else:
        axes[1].set_ylabel('speed across (µm/s)')
    _draw_law(group, axes)
    if found.definition == 'tables':
        axes[2].set_axis_off()
        axes[2].text(0.5, 0.5, 'the tables state no angle', ha='center', va='center',
                     transform=axes[2].transAxes, color='0.4')
    else:
        axes[2].axhline(0, color='0.6', lw=0.6)
        axes[2].set_ylabel('slip angle (°)')
        _limit_angles(axes[2], own)
    axes[0].set_ylabel('speed along command (µm/s)' if found.definition == 'motion'
                       else 'speed in tables (µm/s)')
    axes[0].set_title(f'{group.kind or "all robots"}, n = {len(group.robots)}', fontsize=8,
                      loc='left')
    top = float(np.nanmax([max(row.plateau.speed.value for row in own) * 1e6,
                           speeds[:, 0].max()]))
    axes[0].set_ylim(min(0.0, 1.05 * min(row.plateau.speed.value for row in own) * 1e6),
                     1.1 * top)
    for axis in axes:
        axis.set_xlim(0, 1.04 * factor * group.levels[-1].level)


def _draw_robot(found: Response, rows: list[Row], axes: Sequence[Axes], label: str) -> None:
    factor = COLUMNS[found.against][1]
    plateaus = sorted((row.plateau for row in rows), key=lambda one: one.level)
    x = np.array([one.level for one in plateaus]) * factor
    style: dict[str, Any] = {'color': _ROBOT, 'lw': 0.5, 'alpha': 0.8}
    speed = np.array([one.speed.value for one in plateaus]) * 1e6
    axes[0].plot(x, speed, **style, label=label or '_')
    if found.against == 'frequency':
        axes[1].plot(x, speed / x, **style)
    else:
        axes[1].plot(x, [one.across.value * 1e6 for one in plateaus], **style)
    # The slip angle of a robot that hardly moves is not determined.
    known = [one for one in plateaus if one.slip.high - one.slip.low < _WIDEST_ANGLE]
    if found.definition == 'motion' and known:
        axes[2].plot(np.array([one.level for one in known]) * factor,
                     np.degrees([one.slip.value for one in known]), '.-', ms=2, **style)


def _limit_angles(axis: Axes, rows: list[Row]) -> None:
    angles = np.degrees([row.plateau.slip.value for row in rows
                         if row.plateau.slip.high - row.plateau.slip.low < _WIDEST_ANGLE])
    if len(angles):
        reach = max(10.0, 1.3 * float(np.quantile(np.abs(angles), 0.95)))
        axis.set_ylim(-reach, reach)


def _draw_law(group: Group, axes: Sequence[Axes]) -> None:
    """Draw the fitted law, its cut-in and its step-out."""
    curve = group.curve
    if curve is None:
        return
    highest = group.common[-1].level
    f = np.linspace(highest / 200, highest, 200)
    axes[0].plot(f, curve.speed(f) * 1e6, '--', color=_LAW, lw=1.1, label='drive_response')
    axes[1].plot(f, curve.speed(f) / f * 1e6, '--', color=_LAW, lw=1.1)
    if np.isfinite(curve.cut_in.high) and curve.cut_in.high < highest:
        axes[0].axvspan(max(curve.cut_in.low, 0.0), curve.cut_in.high, color=_CUT_IN, alpha=0.25,
                        lw=0, label='cut-in, 95 %')
    for index, one in enumerate(group.stepping_out.values()):
        ends = np.array([[one.value - max(one.low, 0.0)], [one.high - one.value]])
        axes[0].errorbar([one.value], [0.97 - 0.05 * index], xerr=ends, fmt='v', ms=3.5, lw=0.8,
                         color=_STEP_OUT, transform=axes[0].get_xaxis_transform(),
                         label='step-out of a robot, 95 %' if index == 0 else '_', clip_on=False)
    if group.steps_out:
        axes[0].axvspan(max(curve.step_out.low, 0.0), curve.step_out.high, color=_STEP_OUT,
                        alpha=0.25, lw=0, label='step-out, 95 %')
        axes[0].axvline(curve.step_out.value, color=_STEP_OUT, lw=0.9)
