"""Figure of the positions that particles can reach under one field."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from microbot_ros.control.planning.plan import Swarm
from microbot_ros.control.reach import HANDLES, Reach

_COLOURS = ('#0072B2', '#D55E00', '#009E73', '#CC79A7', '#E69F00', '#56B4E9')


def draw(path: Path, swarm: Swarm, goal: np.ndarray, found: Reach,
         beyond: dict[str, np.ndarray], planned: float, seconds: float) -> None:
    """Save to `path` a figure of the reachable set `found` of a `swarm` with a `goal` (N, 2) [m].

    It shows what lag, strength and switching off open in `seconds` (`beyond`, from `opened`), and
    the error after the planned manoeuvre (`planned` [m]).

    Parameters
    ----------
    path : Path
        Image file.
    swarm : Swarm
        The swarm.
    goal : ndarray, shape (N, 2)
        Goals [m].
    found : Reach
        The reachable set.
    beyond : dict of str to ndarray
        Displacements [m] by handle, from `opened`.
    planned : float
        Error after the planned manoeuvre [m].
    seconds : float
        Duration of the commands [s].
    """
    figure = Figure(figsize=(10, 4.6), layout='constrained')
    left, right = figure.subplots(1, 2, width_ratios=(1.2, 1))
    _ways(left, swarm, goal, found)
    _handles(right, found, beyond, planned, seconds)
    figure.savefig(path, dpi=130)


def _ways(axes: Axes, swarm: Swarm, goal: np.ndarray, found: Reach) -> None:
    for i, (z, g, end) in enumerate(zip(
            swarm.position * 1e6, goal * 1e6, found.ends * 1e6, strict=True)):
        colour = _COLOURS[i % len(_COLOURS)]
        axes.annotate('', (end.real, end.imag), (z.real, z.imag),
                      arrowprops={'arrowstyle': '-|>', 'color': colour, 'lw': 1.8})
        axes.plot([end.real, g.real], [end.imag, g.imag], ':', color=colour, lw=1.4)
        axes.plot(z.real, z.imag, 'o', color=colour, ms=8, label=f'particle {i}')
        axes.plot(g.real, g.imag, '*', color=colour, ms=14, mec='black', mew=0.6)
    axes.plot([], [], '*', color='white', mec='black', ms=12, label='goal')
    axes.plot([], [], ':', color='grey', label='left over')
    axes.set(xlabel='x [µm]', ylabel='y [µm]', aspect='equal',
             title=f'Best together: {abs(found.displacement):.1f} s, '
                   f'{found.floor * 1e6:.1f} µm RMS left')
    axes.margins(0.15)
    axes.legend(fontsize=8, loc='upper right', bbox_to_anchor=(-0.15, 1))
    axes.grid(alpha=0.25)


def _handles(axes: Axes, found: Reach, beyond: dict[str, np.ndarray], planned: float,
             seconds: float) -> None:
    count = max(len(next(iter(beyond.values()))), 1)
    width = 0.8 / len(beyond)
    for k, (handle, values) in enumerate(beyond.items()):
        axes.bar(np.arange(len(values)) + (k - 1) * width, values * 1e6, width,
                 color=_COLOURS[k], label=HANDLES[handle])
    axes.axhline(found.floor * 1e6, color='black', lw=1, ls='--', label='first-order floor')
    axes.axhline(planned * 1e6, color='black', lw=1, ls=':', label='after one manoeuvre')
    axes.set(xlabel='direction closed to the first-order model', xticks=np.arange(count),
             xticklabels=[str(k + 1) for k in range(count)],
             ylabel=f'RMS opened in {seconds:g} s [µm]', title='Directions that the model opens')
    axes.set_ylim(0, 1.45 * axes.get_ylim()[1])
    axes.legend(fontsize=8, loc='upper right')
    axes.grid(alpha=0.25, axis='y')
