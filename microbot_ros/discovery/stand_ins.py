"""Names that together are but a series for one field of place that has no name.

A spot, a flow and a drift explain much of a vortex between them, and each passes alone, since
without it the other two leave something that it explains better than any map. So they are asked
together: what is learned of place instead must not foretell rows it has not seen better than they
fit the rows they have.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from microbot_ros.discovery.learned.learn import CONVINCING, foretells, learn_term
from microbot_ros.discovery.stepwise_selection import without
from microbot_ros.estimation.model_fit import ModelFit
from microbot_ros.model.model import Model


@dataclass(frozen=True)
class StandIns:
    """Effects, by `names`, that stand in for a field of place beside the `rest` of a fit."""

    names: tuple[str, ...]
    rest: ModelFit


def fields_of_place(model: Model) -> tuple[str, ...]:
    """Effects of a `model` that may be a series for a field of place: steady drifts, two or more.

    One of them at least depends on place; () where there are fewer.
    """
    drifts = [e for e in model.effects if e.overrides('drift') and e.time_invariant]
    several = len(drifts) > 1 and any(e.needs_position for e in drifts)
    return tuple(e.id for e in drifts) if several else ()


def series_for_a_field(fit: ModelFit,
                       report: Callable[[str], None] = lambda _: None) -> StandIns | None:
    """The fields of place of a `fit` where a learned one is better than all of them together.

    Their likelihood is the largest there is, that of the learned one is of rows it was not learned
    from: by CONVINCING it is only above where they are not what is there. None where it is not.
    `report` is told what is being done.
    """
    names, rest = fields_of_place(fit.model), fit
    if not names:
        return None
    for name in names:
        rest = without(rest, name)
    found = learn_term(rest, report)
    named = fit.log_likelihood - rest.log_likelihood
    if found is None or found.term.against != 'position' or (
            foretells(found.moments) < named + CONVINCING):
        return None
    return StandIns(names, rest)
