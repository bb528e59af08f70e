"""Known physics that a learned term resembles, in words: where to look for the cause."""

from __future__ import annotations

import numpy as np

from microbot_ros.discovery.learned.learn import Finding
from microbot_ros.discovery.result import NextExperiment

_ABOUT = {
    'c0 (−y, x)/(r² + a²)': ('a circulation', 'a circulation'),
    'c0 (−y, x) exp(−r²/2a²)': ('a swirl', 'a swirl'),
    'c0 (x, y)/(r² + a²)': ('a source', 'a sink'),
    'c0 (x, y) exp(−r²/2a²)': ('a push away from a spot', 'a pull towards a spot'),
    'c0 (x, y)/(r + a)': ('a push away from a place', 'a trap'),
    'c0 (x, y) about a place': ('a repulsion growing with distance', 'a spring'),
    'c0 + c1 exp(−r²/2a²)': ('a bright or sticky spot', 'a bright or sticky spot'),
    'c0 + c1/(r² + a²)': ('a bright or sticky spot', 'a bright or sticky spot'),
}
"""Formula → what it resembles if its coefficient is positive, and if it is negative."""

_ALONG = {
    '(c0 + c1 s + c2 s²) along, s across': 'a flow through a channel',
    '(c0 cos ks + c1 sin ks) along, s across': 'lanes of flow',
    'c0 exp(−s/a) along': 'a flow beside a wall',
    'c0 + c1 H(s − a)': 'a border between two regions',
    'c0 + c1 exp(−s/a)': 'a layer at a wall',
}
"""Formula of a direction → what it resembles."""

_KIND = {
    'along a line': 'a flow along one line with a speed gradient',
    'without sources': 'a flow without sources or sinks',
    'without circulation': 'a potential that attracts and repels',
}
"""Kind of kernel of a velocity by place → what it resembles."""

_PLAIN = {
    ('time', 'velocity'): 'a flow that changes in time',
    ('time', 'speed'): 'fuel, light or temperature that changes in time',
    ('time', 'heading'): 'a camera or a stage that turns',
    ('time since switch', 'speed'): 'particles that recover slowly from a turn',
    ('time since switch', 'heading'): 'a heading that lags',
    ('command angle', 'speed'): 'unequal coils',
    ('command angle', 'heading'): 'coils that lean, or a nonlinear amplifier',
    ('heading', 'speed'): 'a slope, or a picture with unequal axes',
    ('field strength', 'speed'): 'alignment that depends on the field',
    ('frequency', 'speed'): 'slip, or a step-out',
    ('neighbour distance', 'speed'): 'fuel shared by neighbours',
    ('particle', 'velocity'): 'particles with individual drifts',
}
"""Covariate and acted-on quantity → what the term resembles."""


def looks_like(found: Finding) -> str:
    """Return what known physics a term resembles.

    Parameters
    ----------
    found : Finding
        A learned term.

    Returns
    -------
    str
        A phrase; '' if it resembles nothing known.
    """
    formula, term = found.formula, found.term
    text = formula.formula.text if formula else ''
    if formula and text in _ABOUT:
        x, y = (1e6 * part for part in formula.shape[:2])
        positive, negative = _ABOUT[text]
        return f'{positive if formula.weights[-1] > 0 else negative} about ({x:.0f}, {y:.0f}) µm'
    if formula and text in _ALONG:
        turn = -90 if text.endswith(('across', 'along')) and 'exp' not in text else 0
        angle = (np.degrees(formula.shape[0]) + turn + 180) % 360 - 180
        what = 'along' if term.acts_on == 'velocity' else 'across'
        return f'{_ALONG[text]}, {what} {angle:.0f}°'
    if formula and text.startswith('c0 cos 2πat'):
        return f'a rhythm of {formula.shape[0]:.2g} Hz'
    if formula and 'H(x − a)' in text and term.against == 'time':
        return f'a change at {formula.shape[0]:.1f} s'
    if term.frame == 'radial' and term.acts_on == 'velocity':
        near = term.values[term.seen][:, 0]
        return f'{"repulsion" if near[:max(len(near) // 3, 1)].mean() > 0 else "attraction"} ' \
            'between neighbours'
    if term.against == 'position' and term.acts_on == 'velocity':
        return _KIND.get(found.curve.kind, 'a flow with sources and sinks')
    if term.against == 'position':
        return 'fuel, light or height that varies with position'
    return _PLAIN.get((term.against, term.acts_on), '')


_CONFIRM = {
    'position': 'lead the particles through the same positions in another order, and through '
                'positions not visited before',
    'time': 'record again from the start: an effect of time recurs at the same time, an effect of '
            'position or particle does not',
    'time since switch': 'hold each command twice as long, then half as long',
    'command angle': 'repeat all angles at another field strength',
    'heading': 'drive the same particles along the angles in between',
    'field strength': 'step through the field strengths in another order',
    'frequency': 'step through the frequencies in another order',
    'neighbour distance': 'bring two particles together and apart again, far from all others',
    'particle': 'exchange the positions of the particles and record again',
}
"""Covariate → experiment that would confirm or refute a term."""


def confirmation(found: Finding, minutes: float) -> NextExperiment:
    """Return the recording that would confirm or refute a term.

    Parameters
    ----------
    found : Finding
        A learned term.
    minutes : float
        Duration of the recording [min].

    Returns
    -------
    NextExperiment
        The recording in words.
    """
    return NextExperiment(f'to confirm the learned term, {_CONFIRM[found.term.against]}', minutes)
