"""The part of the report on the experiments: plans in words, and odds over time."""

from __future__ import annotations

from pathlib import Path

import jinja2
from matplotlib.figure import Figure

from microbot_ros.discovery.driven.drive import Driven, Look
from microbot_ros.discovery.report.figures import FLOOR, embedded
from microbot_ros.discovery.report.words import words

_TEMPLATE = Path(__file__).with_name('page.html')
"""Template of this part of the report."""

_SHOWN = 0.05
"""Probability that an effect must once have had to be drawn. Choice: more lines hide the likely
ones."""

_ENDINGS = {
    'settled': 'The question was settled.',
    'undecidable': 'No command of this rig settles the question.',
    'out_of_time': 'The time was over before the question was settled.',
    'stopped': 'The experiments were stopped',
}
"""How a search ended, as sentences."""


def section(driven: Driven) -> str:
    """Return the experiments as HTML, for `report.write_report`.

    Parameters
    ----------
    driven : Driven
        Experiments and looks.

    Returns
    -------
    str
        HTML.
    """
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    environment.filters['likeliest'] = likeliest
    figure = draw_odds(driven)
    return environment.from_string(_TEMPLATE.read_text(encoding='utf-8')).render(
        driven=driven, ending=_ending(driven), figure=figure and embedded(figure),
        saved=sum(look.saved for look in driven.looks) / 60)


def _ending(driven: Driven) -> str:
    if driven.reason:
        return f'{_ENDINGS[driven.decided]}: {driven.reason}.'
    left = driven.insight.judgement.left if driven.insight else ()
    if driven.decided == 'settled' and left:
        return ('The question was settled: no effect of the library explains the data. The '
                f'residuals depend on {left[0].against}.')
    return _ENDINGS[driven.decided]


def likeliest(look: Look) -> list[tuple[str, float]]:
    """Return the two likeliest explanations at a look.

    Parameters
    ----------
    look : Look
        A look.

    Returns
    -------
    list of (str, float)
        Name in words and probability.
    """
    ranked = sorted(look.odds.items(), key=lambda one: -one[1])[:2]
    return [(words(name) or 'nothing', share) for name, share in ranked]


def draw_odds(driven: Driven) -> Figure | None:
    """Draw the probabilities of explanations over time.

    Parameters
    ----------
    driven : Driven
        Experiments and looks.

    Returns
    -------
    Figure or None
        Explanations that were ever likely; None if nothing was known.
    """
    looks = [look for look in driven.looks if look.odds]
    names = sorted({name for look in looks for name, share in look.odds.items()
                    if share > _SHOWN})
    if not names:
        return None
    figure = Figure(figsize=(8, 3), layout='constrained')
    axis = figure.subplots()
    minutes = [look.seconds / 60 for look in looks]
    for k, name in enumerate(names):
        axis.plot(minutes, [look.odds.get(name, 0.0) for look in looks],
                  color=f'C{k % 10}' if name else FLOOR, marker='osv^D'[k % 5], ms=4,
                  ls='-' if name else '--', label=words(name) or 'nothing')
    axis.set_xlim(0, None)
    axis.set_ylim(-0.02, 1.02)
    axis.set_xlabel('minutes')
    axis.set_ylabel('probability')
    axis.spines[['top', 'right']].set_visible(False)
    figure.legend(loc='outside right upper', frameon=False)
    return figure
