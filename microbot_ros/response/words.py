"""The response in sentences, for people."""

from __future__ import annotations

import numpy as np

from microbot_ros.discovery.report_words import number
from microbot_ros.response.plateaus import SETTLE_S, TURN, Against
from microbot_ros.response.result import Group, Response, Unlike

COLUMNS: dict[Against, tuple[str, float, str]] = {
    'frequency': ('frequency_hz', 1.0, 'Hz'), 'field': ('field_mT', 1e3, 'mT'),
    'tilt': ('tilt_deg', 180 / np.pi, '°')}
"""Column of the level, its factor from SI, and its unit."""


def summary(found: Response) -> str:
    """What was found, in one sentence."""
    if not found.kinds:
        return 'No plateau of what was commanded was found.'
    return '; '.join(_of_kind(found, group) for group in found.kinds) + '.'


def _of_kind(found: Response, group: Group) -> str:
    _, factor, unit = COLUMNS[found.against]
    first, last = group.levels[0], group.levels[-1]
    who = f'{group.kind}, {len(group.robots)}' if group.kind else f'{len(group.robots)}'
    said = f'{who} robot{"" if len(group.robots) == 1 else "s"}: '
    if len(group.levels) == 1:
        return f'{said}{_speed(first.speed.value)} µm/s at {first.level * factor:g} {unit}'
    said += (f'speed goes from {_speed(first.speed.value)} µm/s at {first.level * factor:g} {unit} '
             f'to {_speed(last.speed.value)} µm/s at {last.level * factor:g} {unit}')
    curve = group.curve
    if curve is None:
        return said
    said += f', cut-in {_cut_in(group)}'
    if curve.steps_out(last.level):
        return (f'{said}, step-out at {number(curve.step_out.value)} Hz '
                f'({number(curve.step_out.low)} to {number(curve.step_out.high)})')
    lost = 1 - (last.speed.value / last.level) / (first.speed.value / first.level)
    slips = (f', while the distance per turn falls by {100 * lost:.0f} %' if lost > 0.1 else '')
    return f'{said}, no step-out up to {last.level:g} Hz{slips}'


def _cut_in(group: Group) -> str:
    assert group.curve is not None
    found = group.curve.cut_in
    if found.low <= 0:
        return (f'below {number(found.high)} Hz' if np.isfinite(found.high)
                else 'not bounded by these frequencies')
    return f'at {number(found.value)} Hz ({number(found.low)} to {number(found.high)})'


def _speed(value: float) -> str:
    return number(value * 1e6)


def difference(found: Response) -> str:
    """Why `motion` and `tables` differ, with the numbers of this data; '' where neither holds."""
    ratios = [(level, ratio, kind) for kind, of in found.compared.items() for level, ratio in of]
    if not ratios:
        return ''
    _, factor, unit = COLUMNS[found.against]
    parts = []
    for kind, of in found.compared.items():
        if of:
            (first, low), (last, high) = of[0], of[-1]
            parts.append(f'{kind or "all"}: {100 * (low - 1):+.0f} % at {first * factor:g} {unit}, '
                         f'{100 * (high - 1):+.0f} % at {last * factor:g} {unit}'.replace('-', '−'))
    return (
        'The tables state the length of the displacement over a window of frames, in every row of '
        'a plateau. The window reaches back into rest and turns before a plateau, so that speeds '
        'are too low, the more the shorter the plateau; it counts what is across and the noise as '
        'speed, so that slow robots seem faster. The motion is measured along the command, '
        f'{SETTLE_S:g} s after each change. Tables beside motion: {"; ".join(parts)}.')


def exclusions(found: Response) -> list[str]:
    """What was left out or modelled."""
    said = []
    if found.definition == 'motion':
        used = sum(row.plateau.frames for row in found.rows)
        out = sum(row.plateau.left_out for row in found.rows)
        share = 100 * out / max(used + out, 1)
        said.append(
            f'{out} of {used + out} frames ({share:.0f} %) are left out: within {SETTLE_S:g} s of '
            f'a change of the drive, or while the direction turned by more than '
            f'{np.degrees(TURN):.0f}° in that time.')
        delays = [delay for delay in found.delays.values() if delay > 0]
        if delays:
            said.append(f'The motion follows the command with a delay of {min(delays):.2f} to '
                        f'{max(delays):.2f} s, which is taken into account.')
    else:
        said.append('Every row of a plateau counts, turns and changes too, as in the tables.')
    for session, notes in found.notes.items():
        said += [f'{session}: {note}.' for note in notes]
    if found.without:
        said.append(f'No plateau in {", ".join(found.without)}.')
    return said


def unlike(one: Unlike) -> str:
    """A sentence on a robot that is unlike the others of its kind."""
    session, particle = one.robot
    return (f'{session}, robot {particle}, moves at {one.ratio:.2g} times the speed of the others '
            f'{f"of {one.kind}" if one.kind else ""}: another objective or a wrong pixel size '
            'would do that.').replace('  ', ' ')
