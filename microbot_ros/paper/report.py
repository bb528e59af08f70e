"""Page on the repeated experiment, one file, and its two figures."""

from __future__ import annotations

import base64
import io
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from microbot_ros import __version__
from microbot_ros.paper.repetition import APPROACHES, FIELD, Trial
from microbot_ros.paper.summary import PRINTED

# Okabe and Ito's colours, safe for colour-blind readers; line styles distinguish them in grey.
PARTICLES = ('#0072B2', '#D55E00', '#009E73')
APPROACH = {'own': '#0072B2', 'mean': '#E69F00', 'true': '#666666'}
LABELS = {'own': 'approach 1: own F', 'mean': 'approach 2: mean F', 'true': 'true F and φ'}
_TEMPLATE = Path(__file__).with_name('page.html')
_SOLVERS = {'first_order': 'first-order', 'newton_stokes': 'Newton–Stokes'}
STYLES = {'own': '-', 'mean': '--', 'true': ':'}


def draw_trajectories(trial: Trial) -> Figure:
    """Draw measured paths and the predictions of both approaches, a panel per particle.

    Parameters
    ----------
    trial : Trial
        The trial.

    Returns
    -------
    Figure
        The figure.
    """
    figure = Figure(figsize=(11, 4.2), layout='constrained')
    axes = figure.subplots(1, 3)
    for i, (axis, colour) in enumerate(zip(axes, PARTICLES, strict=True)):
        x, y = trial.measured[:, i].T * 1e6
        axis.plot(
            x, y, '.', color=colour, markersize=3, alpha=0.5, label='measured (simulated rig)')
        for approach in ('own', 'mean'):
            x, y = trial.predicted[approach][:, i].T * 1e6
            axis.plot(x, y, STYLES[approach], color='black', linewidth=1.2, label=LABELS[approach])
        axis.plot(x[0], y[0], 'o', color='black', markerfacecolor='white', label='start')
        axis.set(title=f'particle {i + 1}', xlabel='x (µm)', aspect='equal')
        axis.set_adjustable('datalim')
    axes[0].set_ylabel('y (µm)')
    figure.legend(*axes[0].get_legend_handles_labels(), loc='outside lower center', ncols=4,
                  fontsize=8)
    return figure


def draw_errors(trials: list[Trial]) -> Figure:
    """Draw the error over time (median, middle 80 %) and the RMSE next to the paper's.

    Parameters
    ----------
    trials : list of Trial
        The trials.

    Returns
    -------
    Figure
        The figure.
    """
    figure = Figure(figsize=(11, 4.2), layout='constrained')
    over_time, bars = figure.subplots(1, 2)
    _draw_over_time(over_time, trials)
    _draw_bars(bars, trials)
    return figure


def _draw_over_time(axis: Axes, trials: list[Trial]) -> None:
    frames = min(len(trial.times) for trial in trials)
    t = trials[0].times[:frames]
    for approach in APPROACHES:
        errors = np.concatenate([trial.error(approach)[:frames] for trial in trials], axis=1) * 1e6
        low, middle, high = np.quantile(errors, [0.1, 0.5, 0.9], axis=1)
        if approach != 'true':
            axis.fill_between(t, low, high, color=APPROACH[approach], alpha=0.2, linewidth=0)
        axis.plot(t, middle, STYLES[approach], color=APPROACH[approach], label=LABELS[approach])
    axis.set(xlabel='time (s)', ylabel='distance from measured (µm)', ylim=(0, None),
             title=f'error over time, {len(trials)} repetitions, median and middle 80 %')
    axis.legend(fontsize=8, loc='upper left')


def _draw_bars(axis: Axes, trials: list[Trial]) -> None:
    place, width = np.arange(3), 0.19
    for k, approach in enumerate(('own', 'mean')):
        rmse = np.array([trial.rmse[approach] for trial in trials]) * 1e6
        axis.bar(
            place + (2 * k - 1.5) * width, rmse.mean(axis=0), width, color=APPROACH[approach],
            yerr=rmse.std(axis=0), capsize=3, label=f'{LABELS[approach]}, here')
        axis.bar(
            place + (2 * k - 0.5) * width, PRINTED['rmse_um'][approach], width, color='white',
            edgecolor=APPROACH[approach], hatch='//', label=f'{LABELS[approach]}, the paper')
    axis.set(xticks=place, xticklabels=[f'particle {i + 1}' for i in range(3)],
             ylabel='RMSE (µm)', ylim=(0, 9), title='RMSE over 15 s')
    axis.legend(fontsize=8, ncols=2, loc='upper center')


def png(figure: Figure) -> bytes:
    """Return the figure as a PNG.

    Parameters
    ----------
    figure : Figure
        The figure.

    Returns
    -------
    bytes
        Bytes of the PNG.
    """
    stream = io.BytesIO()
    figure.savefig(stream, format='png', dpi=130)
    return stream.getvalue()


def embedded(picture: bytes) -> str:
    """Return a PNG `picture` as a data address for a self-contained page.

    Parameters
    ----------
    picture : bytes
        Bytes of a PNG.

    Returns
    -------
    str
        Address for `src`.
    """
    return 'data:image/png;base64,' + base64.b64encode(picture).decode()


def page(summary: dict[str, Any], trajectories: bytes, errors: bytes) -> str:
    """Return the page for a `summary.summarise`; `trajectories` and `errors` are PNGs.

    Parameters
    ----------
    summary : dict of str to object
        Result of `summary.summarise`.
    trajectories : bytes
        PNG of `draw_trajectories`.
    errors : bytes
        PNG of `draw_errors`.

    Returns
    -------
    str
        HTML.
    """
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
    template = environment.from_string(_TEMPLATE.read_text(encoding='utf-8'))
    stokes, rotation, _, first = summary['run_time_s'].values()
    return template.render(
        s=summary, c=summary['constants'], m=summary['magnetic_force'],
        own=summary['rmse_um']['first_order']['own'],
        stokes_s=stokes, rotation_s=rotation, first_s=first, labels=LABELS, solvers=_SOLVERS,
        field_mT=f'{FIELD * 1e3:g}', trajectories=embedded(trajectories), errors=embedded(errors),
        version=__version__)
