"""`archive.html`: conclusions on an archive for people, in one file with its pictures."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import date
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from microbot_ros.archive.conclusions.conclude import Conclusions, listed, refused
from microbot_ros.archive.conclusions.quantities import LABELS, Quantity
from microbot_ros.archive.conclusions.random_effects import Spread
from microbot_ros.archive.store import REPORT, Archive
from microbot_ros.common.files import write_text
from microbot_ros.discovery.report import words as report_words
from microbot_ros.discovery.report.figures import embedded
from microbot_ros.discovery.report.words import number
from microbot_ros.model.effects import EFFECTS

_TEMPLATE = Path(__file__).with_name('report.html')

_COLOURS = ('#0072B2', '#D55E00', '#009E73', '#CC79A7', '#E69F00', '#56B4E9', '#000000')
"""Palette of Okabe and Ito (2008); rigs are distinguished by markers, too."""
_MARKERS = 'osD^vP*X'


def write_report(archive: Archive, found: Conclusions) -> Path:
    """Write the report of an archive.

    Parameters
    ----------
    archive : Archive
        The archive.
    found : Conclusions
        Conclusions on the archive.

    Returns
    -------
    Path
        Path of the report.
    """
    write_text(archive.folder / REPORT, page(archive, found))
    return archive.folder / REPORT


def page(archive: Archive, found: Conclusions) -> str:
    """Return the report of an archive as self-contained HTML.

    The same results give the same page.

    Parameters
    ----------
    archive : Archive
        The archive.
    found : Conclusions
        Conclusions on the archive.

    Returns
    -------
    str
        HTML.
    """
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    environment.filters |= {'listed': listed} | {
        name: getattr(report_words, name) for name in ('bare', 'chance', 'number', 'words')}
    environment.globals |= {'mean': _mean, 'between': _between}
    template = environment.from_string(_TEMPLATE.read_text(encoding='utf-8'))
    figure = draw_quantities(found.quantities)
    parts = [part for one in found.quantities for part in one.by_kind()]
    drawn = {effect.id: embedded(draw_parameters(found.parameters[effect.id]))
             for effect in found.effects if any(len(q.value) for q in found.parameters[effect.id])}
    unnamed = list(dict.fromkeys(
        row['session'] for row in found.rows if row['verdict'] == 'unnamed'))
    names = {row['path']: row['session'] for row in found.rows}
    links = {names[path]: one['report'] for path, one in archive.results('discover').items()
             if path in names and one.get('report')}
    return template.render(
        found=found, links=links, name=archive.folder.name,
        figure=figure and embedded(figure), drawn=drawn,
        library=EFFECTS, labels=LABELS, refused=refused(archive), unnamed=unnamed,
        parts=parts, grouped=[(one, label) for one in parts for label in LABELS
                              if label != 'particle_kind' and _several(one, label)],
        versions=report_words.versions())


def _several(one: Quantity, label: str) -> bool:
    """Return whether a table of the groups shows more than the figure of the sessions."""
    return 1 < len(one.groups[label]) <= min(40, len(one.value) - 1)


def _mean(found: Spread | None) -> str:
    """Return a mean with its 95 % interval."""
    if found is None:
        return '–'
    half = (found.mean_high - found.mean_low) / 2
    digits = min(max(0, 1 - int(np.floor(np.log10(half)))), 9)
    return f'{found.mean:.{digits}f} ± {half:.{digits}f}'.replace('-', '−')


def _between(found: Spread | None) -> str:
    """Return a standard deviation between sessions, with its 95 % interval."""
    if found is None or found.count < 2:
        return '–'
    return f'{number(found.between)} ({number(found.between_low)} to {number(found.between_high)})'


def draw_quantities(known: Sequence[Quantity]) -> Figure | None:
    """Draw every quantity by day, or by session if no day is known.

    Rigs have colours, batches markers.

    Parameters
    ----------
    known : sequence of Quantity
        Quantities.

    Returns
    -------
    Figure or None
        None for no quantity.
    """
    if not known:
        return None
    figure = Figure(figsize=(11, 2.4 * len(known) + 0.5), layout='constrained')
    axes = figure.subplots(len(known), 1, squeeze=False).ravel()
    for axis, one in zip(axes, known, strict=True):
        _draw(axis, one)
    handles, labels = axes[0].get_legend_handles_labels()
    if len(handles) > 1:
        figure.legend(handles, labels, loc='outside upper right', ncols=6, frameon=False)
    return figure


def draw_parameters(known: Sequence[Quantity]) -> Figure:
    """Draw the parameters of one effect in the sessions that have it, with mean and spread.

    Parameters
    ----------
    known : sequence of Quantity
        Quantities.

    Returns
    -------
    Figure
        The figure.
    """
    figure = Figure(figsize=(11, 2.4 * len(known) + 0.5), layout='constrained')
    for axis, one in zip(figure.subplots(len(known), 1, squeeze=False).ravel(), known,
                         strict=True):
        _draw(axis, one)
    return figure


def _draw(axis: Axes, one: Quantity) -> None:
    kinds, parts = one.kinds(), one.by_kind()
    dated = bool(np.isfinite(one.days).all()) and len(set(one.days.tolist())) > 1 \
        and len(kinds) == 1
    x = one.days if dated else np.empty(len(one.value))
    if not dated:
        x[[k for _, rows in kinds for k in rows]] = np.arange(1.0, len(x) + 1)
    for (kind, rows), part in zip(kinds, parts, strict=True):
        ends = (0.0, 1.0) if len(kinds) == 1 else (x[rows].min() - 0.4, x[rows].max() + 0.4)
        across = axis.get_yaxis_transform() if len(kinds) == 1 else axis.transData
        if (of := part.spread) is not None:
            half = 1.96 * float(np.nan_to_num(of.between))
            axis.fill_between(ends, of.mean - half, of.mean + half, color='#999999', alpha=0.2,
                              lw=0, transform=across)
            axis.plot(ends, [of.mean] * 2, color='#999999', lw=1, transform=across)
        if len(kinds) > 1:
            axis.text(float(np.mean(ends)), 1.0, kind or 'no kind', fontsize=8, ha='center',
                      va='bottom', transform=axis.get_xaxis_transform())
    for group, rows, style in _styles(one):
        axis.errorbar(x[rows], one.value[rows], 1.96 * one.std[rows], ls='none', ms=4,
                      elinewidth=0.7, label=group, **style)
    if dated:
        ticks = np.unique(np.linspace(x.min(), x.max(), 8).round())
        axis.set_xticks(ticks, [date.fromordinal(int(day)).isoformat() for day in ticks])
    else:
        axis.set_xlabel('session, in the order of the table' + (
            ', kind by kind' if len(kinds) > 1 else ''), fontsize=8)
        axis.xaxis.set_major_locator(MaxNLocator(integer=True))
        axis.set_xlim(0.5, len(x) + 0.5)
    axis.set_ylabel(one.title.replace(' of ', '\nof '), fontsize=9)
    axis.tick_params(labelsize=8)
    axis.spines[['top', 'right']].set_visible(False)


def _styles(one: Quantity) -> list[tuple[str, list[int], dict[str, Any]]]:
    """Return name, sessions, colour and marker of each rig and batch, in the order of names."""
    count = len(one.value)
    rigs, batches = (_group_of(one.groups[label], count) for label in ('rig', 'batch'))
    result = []
    for rig, batch in sorted(set(zip(rigs, batches, strict=True))):
        rows = [k for k in range(count) if (rigs[k], batches[k]) == (rig, batch)]
        style = {'color': _COLOURS[sorted(set(rigs)).index(rig) % len(_COLOURS)],
                 'marker': _MARKERS[sorted(set(batches)).index(batch) % len(_MARKERS)]}
        result.append((', '.join(filter(None, (rig, batch))) or 'sessions', rows, style))
    return result


def _group_of(groups: dict[str, list[int]], count: int) -> list[str]:
    """Return the group of each of `count` sessions; '' for none."""
    names = [''] * count
    for name, rows in groups.items():
        for k in rows:
            names[k] = name
    return names
