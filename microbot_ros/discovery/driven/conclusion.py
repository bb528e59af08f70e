"""Result of a search that drives, in the form of every other search."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from microbot_ros.common.records import Session
from microbot_ros.discovery.discover import discover
from microbot_ros.discovery.driven.drive import Driven
from microbot_ros.discovery.driven.joined import join
from microbot_ros.discovery.report.words import words
from microbot_ros.discovery.result import Discovery


def discovered(driven: Driven, report: Callable[[str], None] = lambda _: None,
               ) -> tuple[Discovery, Session] | None:
    """Return the result on all experiments together.

    It is the result of `discover` on the joined session, except for remarks and the next
    experiment.

    Parameters
    ----------
    driven : Driven
        Experiments and looks.
    report : callable, optional
        Receives one line of progress before each stage.

    Returns
    -------
    (Discovery, Session) or None
        Result and joined session; None for too few rows.
    """
    if driven.insight is None:
        return None
    session = join(driven.experiments)
    found = discover([session], report)
    return replace(found, remarks=(*_remarks(driven), *found.remarks),
                   next_experiment=found.next_experiment if found.learned else None), session


def _remarks(driven: Driven) -> tuple[str, ...]:
    remarks = [f'{words(one)} and {words(other)}: no command of this rig distinguishes them.'
               for one, other in driven.twins]
    if driven.reason:
        remarks.append(f'The experiments were stopped: {driven.reason}.')
    if driven.decided == 'out_of_time':
        remarks.append('The time was over before the question was settled.')
    return tuple(remarks)


def as_json(driven: Driven) -> dict[str, Any]:
    """Return the fields of `result.json` that only a search that drives has.

    Parameters
    ----------
    driven : Driven
        Experiments and looks.

    Returns
    -------
    dict
        Ending, duration and odds after each experiment.
    """
    return {
        'decided': driven.decided, 'minutes': driven.seconds / 60,
        'experiments': [
            {'session': f'experiment-{number}', 'plan': look.plan,
             'odds': {name or 'nothing': odds for name, odds in look.odds.items()}}
            for number, look in enumerate(driven.looks, 1)],
    }
