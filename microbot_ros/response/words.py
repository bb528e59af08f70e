"""Sentences about a response, for people."""

from __future__ import annotations

import numpy as np

from microbot_ros.common.errors import counted
from microbot_ros.discovery.report.words import number
from microbot_ros.response.plateaus import SETTLE_S, TURN, Against, Measured
from microbot_ros.response.result import Group, Response, Unlike

_LISTED = 4  # choice: step-outs listed one by one; more are given as a range
COLUMNS: dict[Against, tuple[str, float, str]] = {
    'frequency': ('frequency_hz', 1.0, 'Hz'), 'field': ('field_mT', 1e3, 'mT'),
    'tilt': ('tilt_deg', 180 / np.pi, '°')}
"""Column of the level, its factor from SI, and its unit."""


def summary(found: Response) -> str:
    """Return the result in one sentence.

    Parameters
    ----------
    found : Response
        The response.

    Returns
    -------
    str
        The sentence.
    """
    if not found.kinds:
        return 'No plateau of the command was found.'
    return '; '.join(_of_kind(found, group) for group in found.kinds) + '.'


def _of_kind(found: Response, group: Group) -> str:
    _, factor, unit = COLUMNS[found.against]
    first, last = group.common[0], group.common[-1]
    who = counted(len(group.robots), 'robot')
    said = f'{group.kind}, {who}: ' if group.kind else f'{who}: '
    if len(group.common) == 1:
        return f'{said}{_speed(first.speed.value)} µm/s at {first.level * factor:.4g} {unit}'
    ends = (f'{_speed(one.speed.value)} µm/s at {one.level * factor:.4g} {unit}'
            for one in (first, last))
    said += f'speed goes from {" to ".join(ends)}'
    curve = group.curve
    if curve is None:
        return said
    said += f', cut-in {_cut_in(group)}'
    if group.stepping_out:
        single = sorted(group.stepping_out.values(), key=lambda one: one.value)
        where = ('at ' + ', '.join(map(_interval, single)) if len(single) <= _LISTED else
                 f'between {number(single[0].value)} and {number(single[-1].value)}')
        law = f', the law of all at {_interval(curve.step_out)} Hz' if group.steps_out else ''
        return (f'{said}, {len(single)} of {len(group.robots)} robots step out {where} Hz '
                f'(95 %){law}')
    lost = (1 - (last.speed.value / last.level) / (first.speed.value / first.level)
            if first.speed.value > 0 else 0.0)
    slips = (f', while the distance per turn falls by {100 * lost:.0f} %' if lost > 0.1 else '')
    return f'{said}, no step-out up to {last.level:g} Hz{slips}'


def _interval(found: Measured) -> str:
    if not np.isfinite(found.low):
        return f'{number(found.value)} (at most {number(found.high)})'
    return f'{number(found.value)} ({number(found.low)} to {number(found.high)})'


def _cut_in(group: Group) -> str:
    assert group.curve is not None
    found = group.curve.cut_in
    if found.low <= 0:
        return (f'below {number(found.high)} Hz' if np.isfinite(found.high)
                else 'not bounded by these frequencies')
    return f'at {_interval(found)} Hz'


def _speed(value: float) -> str:
    return number(value * 1e6)


def difference(found: Response) -> str:
    """Return why `motion` and `tables` differ, with the numbers of this data; '' without both.

    Parameters
    ----------
    found : Response
        The response.

    Returns
    -------
    str
        The sentence, or ''.
    """
    ratios = [(level, ratio, kind) for kind, of in found.compared.items() for level, ratio in of]
    if not ratios:
        return ''
    _, factor, unit = COLUMNS[found.against]
    parts = []
    for kind, of in found.compared.items():
        if of:
            ends = ', '.join(f'{100 * (ratio - 1):+.0f} % at {level * factor:.4g} {unit}'
                             for level, ratio in (of[0], of[-1]))
            parts.append(f'{kind or "all"} {ends}'.replace('-', '−'))
    return (
        'The tables state the length of the displacement over a window of frames, in every '
        'row of a plateau. The window extends back into rest and turns before a plateau, so '
        'speeds are too low, the more so the shorter the plateau. It also counts sideways '
        'motion and noise as speed, so slow robots seem faster. The motion is measured along '
        f'the command, {SETTLE_S:g} s after each change. Tables compared with motion: '
        f'{"; ".join(parts)}.')


def exclusions(found: Response) -> list[str]:
    """Return sentences on data that were left out or modelled.

    Parameters
    ----------
    found : Response
        The response.

    Returns
    -------
    list of str
        The sentences.
    """
    said = []
    if found.definition == 'motion':
        used = sum(row.plateau.frames for row in found.rows)
        out = sum(row.plateau.left_out for row in found.rows)
        share = 100 * out / max(used + out, 1)
        if out:
            said.append(
                f'{out} of {used + out} frames ({share:.0f} %) are left out: within '
                f'{SETTLE_S:g} s of a change of the drive, or while the direction turned by '
                f'more than {np.degrees(TURN):.0f}° in that time.')
        delays = [delay for delay in found.delays.values() if delay > 0]
        if delays:
            ends = ' to '.join(dict.fromkeys(f'{one:.2f}' for one in (min(delays), max(delays))))
            said.append(f'The motion follows the command with a delay of {ends} s, which is taken '
                        'into account.')
    else:
        said.append('Every row of a plateau counts, including turns and changes, as in the '
                    'tables.')
    for session, notes in found.notes.items():
        said += [f'{session}: {note}.' for note in notes]
    if found.without:
        said.append(f'No plateau in {", ".join(found.without)}.')
    return said


def unlike(one: Unlike) -> str:
    """Return a sentence on a robot that is unlike the others of its kind.

    Parameters
    ----------
    one : Unlike
        The robot.

    Returns
    -------
    str
        The sentence.
    """
    session, particle = one.robot
    of = f' of {one.kind}' if one.kind else ''
    return (f'{session}, robot {particle}, moves at {one.ratio:.2g} times the speed of the '
            f'others{of}: another objective or a wrong pixel size can cause that.')
