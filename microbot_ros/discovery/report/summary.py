"""Summary of a discovery for the person who did the experiment."""

from __future__ import annotations

import numpy as np

from microbot_ros.discovery.report.words import listed, number
from microbot_ros.discovery.report.words import words as as_words
from microbot_ros.discovery.result import Discovery, NamedEffect
from microbot_ros.model.effects import EFFECTS

_LIMITS = 'the table “Looked for and not found”'


def summary(found: Discovery) -> str:
    """Summarise a discovery in two sentences: what moves the particles, and what to do.

    Parameters
    ----------
    found : Discovery
        Result of the search.

    Returns
    -------
    str
        Two sentences, without statistics.
    """
    return {'named': _named, 'consistent': _consistent, 'unnamed': _unnamed}[found.verdict](found)


def _named(found: Discovery) -> str:
    effects = [e for e in found.effects if e.status == 'established']
    what = '; '.join(map(_described, effects))
    count = 'one effect' if len(effects) == 1 else f'{len(effects)} effects'
    rivals = sorted({rival for e in effects for rival in e.indistinguishable_from})
    gap = found.gap
    if rivals:
        then = (f'The recording fits {listed(rivals)} as well: record the experiment proposed '
                'below before you rely on the name.')
    elif np.isfinite([gap.before, gap.after]).all():
        then = (f'With model.yaml, predictions {gap.horizon:.3g} s ahead miss by '
                f'{number(gap.after * 1e6)} µm beyond the noise, in place of '
                f'{number(gap.before * 1e6)} µm.')
    else:
        then = 'Use model.yaml, which contains the effects found, for simulation and control.'
    return f'The simple model of speed, angle and diffusion lacks {count}: {what}. {then}'


def _described(effect: NamedEffect) -> str:
    meaning = EFFECTS[effect.id].summary.rstrip('.')
    return f'{as_words(effect.id)} ({meaning[0].lower()}{meaning[1:]})'


def _consistent(found: Discovery) -> str:
    hints = [e.id for e in found.effects]
    hint = f', apart from a weak sign of {listed(hints)}' if hints else ''
    bounded = {one.id for one in found.limits if np.isfinite(one.limit)}
    unseen = list(dict.fromkeys(one.id for one in found.limits if one.id not in bounded))
    if unseen:
        then = (f'It could not have shown {listed(unseen)}: {_LIMITS} names the commands that '
                'would.')
    else:
        then = f'Effects below the limits in {_LIMITS} may still be there.'
    return ('The simple model of speed, angle and diffusion explains this recording'
            f'{hint}. {then}')


def _unnamed(found: Discovery) -> str:
    against = listed([f'“{m.against}”' for m in found.unexplained[:3]])
    then = (found.next_experiment.sentence if found.next_experiment else
            f'look for a cause that depends on {against}')
    return ('Something moves the particles that no known effect explains; it depends on '
            f'{against}. Do not rely on the fitted speeds and angles yet: {then}.')
