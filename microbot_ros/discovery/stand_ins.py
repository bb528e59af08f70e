"""Names that together are but a series for one field of place that has no name.

A spot, a flow and a drift explain much of a vortex between them, and each passes alone, since
without it the other two leave something that it explains better than any map. So they are asked
together: is there one formula of place, of fewer numbers, that explains more than all of them?
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from microbot_ros.discovery.learned.learn import finish, learn_term, with_term
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
    """The fields of place of a `fit` where one formula explains more with fewer numbers.

    Of what is there no other formula is likelier with fewer numbers, but by chance. None where
    none is. `report` is told what is being done.
    """
    names, rest = fields_of_place(fit.model), fit
    if not names:
        return None
    for name in names:
        rest = without(rest, name)
    found = learn_term(rest, report)
    if found is None or found.term.against != 'position':
        return None
    found = finish(found)
    numbers = len(fit.model.vector()) - len(rest.model.vector())
    better = found.formula is not None and found.formula.size < numbers and (
        with_term(rest, found.term).log_likelihood > fit.log_likelihood)
    return StandIns(names, rest) if better else None
