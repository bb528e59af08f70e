"""`archive.html`: what an archive says as a whole, for people. One file, pictures inside."""

from __future__ import annotations

from pathlib import Path

import jinja2
import numpy as np

from microbot_ros.archive.conclusions import Conclusions, listed, refused
from microbot_ros.archive.quantities import LABELS, Quantity
from microbot_ros.archive.random_effects import Spread
from microbot_ros.archive.report_figures import draw_parameters, draw_quantities
from microbot_ros.archive.store import REPORT, Archive
from microbot_ros.common.files import write_text
from microbot_ros.discovery.report import words as report_words
from microbot_ros.discovery.report.figures import embedded
from microbot_ros.discovery.report.words import number
from microbot_ros.model.effects import EFFECTS

_TEMPLATE = Path(__file__).with_name('report.html')


def write_report(archive: Archive, found: Conclusions) -> Path:
    """Write the report on what was `found` into an `archive`; its path."""
    write_text(archive.folder / REPORT, page(archive, found))
    return archive.folder / REPORT


def page(archive: Archive, found: Conclusions) -> str:
    """The report on what was `found` in an `archive` as HTML that needs nothing else.

    The same results give the same page.
    """
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    environment.filters |= {'listed': listed} | {
        name: getattr(report_words, name) for name in ('bare', 'chance', 'number', 'words')}
    environment.globals |= {'mean': _mean, 'between': _between}
    template = environment.from_string(_TEMPLATE.read_text(encoding='utf-8'))
    figure = draw_quantities(found.quantities)
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
        grouped=[(one, label) for one in found.quantities for label in LABELS
                 if _several(one, label)],
        versions=report_words.versions())


def _several(one: Quantity, label: str) -> bool:
    """Whether a table of the groups tells more than the figure of the sessions does."""
    return 1 < len(one.groups[label]) <= min(40, len(one.value) - 1)


def _mean(found: Spread | None) -> str:
    """A mean with its 95 % interval."""
    if found is None:
        return '–'
    half = (found.mean_high - found.mean_low) / 2
    digits = min(max(0, 1 - int(np.floor(np.log10(half)))), 9)
    return f'{found.mean:.{digits}f} ± {half:.{digits}f}'.replace('-', '−')


def _between(found: Spread | None) -> str:
    """A standard deviation between sessions, with its 95 % interval."""
    if found is None or found.count < 2:
        return '–'
    return f'{number(found.between)} ({number(found.between_low)} to {number(found.between_high)})'
