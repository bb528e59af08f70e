"""Particles whose identity is uncertain, and how far off they would be."""

from __future__ import annotations

import re
from collections.abc import Iterable

import numpy as np

from microbot_ros.tracking.link.assign import Pairs
from microbot_ros.tracking.link.motion import Motion
from microbot_ros.tracking.link.states import UNNAMED, TrackStates

_OF_ONE = re.compile(r'particle (\d+) (.*)')
_NAMED = 5
"""Choice: particles listed if the same is reported of many."""

_SURE = 0.05
"""Choice: probability of being another particle up to which an identity counts as certain."""


def note_doubt(states: TrackStates, pairs: Pairs) -> None:
    """Record in `states` which of the `pairs`, whose tracks are rows of it, may be wrong.

    Parameters
    ----------
    states : TrackStates
        States of the particles.
    pairs : Pairs
        The pairs.
    """
    new = (pairs.doubt > _SURE) & (states.id[pairs.track] != UNNAMED)
    rows = pairs.track[new]
    states.doubt[rows] = np.maximum(states.doubt[rows], pairs.doubt[new])
    states.astray[rows] = np.maximum(states.astray[rows], pairs.astray[new])
    states.unsure[rows] = 0.0


def grow_doubt(states: TrackStates, frames: float, motion: Motion) -> None:
    """Increase the uncertainty of particles in doubt after `frames` intervals, by their `motion`.

    A swapped particle moved independently since: ⟨r²⟩ = S t + V t² per coordinate.

    Parameters
    ----------
    states : TrackStates
        States of the particles.
    frames : float
        Number of intervals that have passed.
    motion : Motion
        Motion of the particles.
    """
    unsure = states.doubt > 0
    before = states.unsure[unsure]
    states.unsure[unsure] = after = before + frames
    states.astray[unsure] += (motion.random_step * frames
                              + motion.velocity_step * (after**2 - before**2))


def settle_doubt(states: TrackStates, patience: int) -> None:
    """Accept identities of visible particles that were in doubt for over `patience` frames.

    By then a controller that follows one has learned its behaviour anew.

    Parameters
    ----------
    states : TrackStates
        States of the particles.
    patience : int
        Number of frames.
    """
    settled = (states.unsure > patience) & (states.missed == 0)
    for value in (states.doubt, states.unsure, states.astray):
        value[settled] = 0.0


def doubt_told(states: TrackStates) -> dict[str, str]:
    """Return a sentence for each named particle in doubt: kind of remark → sentence.

    Parameters
    ----------
    states : TrackStates
        States of the particles.

    Returns
    -------
    dict of str to str
        Sentence by kind of remark.
    """
    return {f'doubt {name}': f'particle {name} may be two: it was lost, or met one like it'
            for name in states.id[(states.doubt > 0) & (states.id != UNNAMED)].tolist()}


def together(sentences: Iterable[str]) -> dict[str, list[int]]:
    """Merge `sentences` that say the same of several particles, in order.

    Returns the merged sentences, each with the positions of its sources, counted from 0.

    Parameters
    ----------
    sentences : iterable of str
        The sentences.

    Returns
    -------
    dict of str to list of int
        Positions by merged sentence.
    """
    said: dict[str, list[tuple[int, str]]] = {}
    for place, sentence in enumerate(sentences):
        one = _OF_ONE.fullmatch(sentence)
        said.setdefault(one[2] if one else sentence, []).append((place, one[1] if one else ''))
    return {_of_all([name for _, name in of], what): [place for place, _ in of]
            for what, of in said.items()}


def _of_all(names: list[str], what: str) -> str:
    if len(names) < 2:
        return f'particle {names[0]} {what}' if names[0] else what
    more = f' and {len(names) - _NAMED} more' if len(names) > _NAMED else ''
    return f'each of the particles {", ".join(names[:_NAMED])}{more} {what}'
