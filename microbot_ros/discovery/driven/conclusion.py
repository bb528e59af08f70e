"""What was found by driving, as every other search tells it: numbers, model, page."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from microbot_ros.common.records import Session
from microbot_ros.discovery.check.input_checks import check_sessions
from microbot_ros.discovery.discover import conclude
from microbot_ros.discovery.driven.drive import Driven
from microbot_ros.discovery.driven.joined import join
from microbot_ros.discovery.driven.questions import LOOKALIKE
from microbot_ros.discovery.report.words import words
from microbot_ros.discovery.result import Discovery


def discovered(driven: Driven, report: Callable[[str], None] = lambda _: None,
               ) -> tuple[Discovery, Session] | None:
    """The result on all experiments, and these as one session; None where nothing was learned.

    The model is the one that was taken in the end, and what is established was decided while
    driving: no p-value is asked again about data that ended when it suited. `report` is told what
    is being done.
    """
    insight = driven.insight
    if insight is None:
        return None
    session = join(driven.experiments)
    _, remarks = check_sessions([session])
    found = conclude(insight.known, insight.judgement, (*_remarks(driven), *remarks), report)
    if not found.learned:
        found = replace(found, next_experiment=None)
    return found, session


def _remarks(driven: Driven) -> tuple[str, ...]:
    remarks = [f'{words(one)} and {words(other)}: no command of this rig tells them apart.'
               for one, other in driven.twins]
    if driven.insight:
        remarks += [f'{words(name)}: seen for less than {LOOKALIKE[name]:.0f} s, in '
                    'which something else that differs from place to place, or in time, may look '
                    'like it.' for name in driven.insight.judgement.early]
    if driven.reason:
        remarks.append(f'The experiments were stopped: {driven.reason}.')
    if driven.decided == 'out_of_time':
        remarks.append('Time was out before the question was settled.')
    return tuple(remarks)


def as_json(driven: Driven) -> dict[str, Any]:
    """The fields of `result.json` that only a search that drives has."""
    return {
        'decided': driven.decided, 'minutes': driven.seconds / 60,
        'experiments': [
            {'session': f'experiment-{number}', 'plan': look.plan,
             'odds': {name or 'nothing': odds for name, odds in look.odds.items()}}
            for number, look in enumerate(driven.looks, 1)],
    }
