"""Learned terms in YAML, in the units of their names."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np

from microbot_ros.common.checked import Field, Settings
from microbot_ros.common.plausible import check_plausible
from microbot_ros.common.units import exact_display, exact_si
from microbot_ros.model.learned_term import (
    AXES,
    PERIODIC,
    VALUES,
    ActsOn,
    Against,
    Frame,
    LearnedTerm,
)

_Row = Annotated[tuple[float, ...], Field(min_length=2)]
"""A row of at least two numbers."""


class LearnedEntry(Settings):
    """One entry of `learned`: knots `at`, values there, and their 95 % band."""

    against: Against
    frame: Frame
    acts_on: ActsOn
    formula: str | None = None
    parameters: dict[str, float] = Field(default_factory=dict)
    at: dict[str, _Row]
    values: dict[str, _Row]
    low_95: dict[str, _Row]
    high_95: dict[str, _Row]
    seen: tuple[bool, ...]

    def __post_init__(self) -> None:
        if (self.frame, self.acts_on) not in VALUES:
            known = ', '.join(f'{frame} and {acts}' for frame, acts in VALUES)
            raise ValueError(f"expected 'frame' and 'acts_on' to be one of: {known}")
        if (self.frame == 'radial') != (self.against == 'neighbour distance'):
            raise ValueError("expected the frame radial for 'neighbour distance', and only there")
        _named(self.at, AXES[self.against], 'at')
        count = 1
        for name, knots in self.at.items():
            check_plausible(name, knots)
            count *= len(knots)
            if not (np.diff(knots) > 0).all() or not np.isfinite(knots).all():
                raise ValueError(f"expected 'at.{name}' to ascend")
        if self.against in PERIODIC:
            step = np.diff(next(iter(self.at.values())))
            if not np.allclose(step, 2 * np.pi / count):
                raise ValueError('expected knots that divide a turn equally')
        for what in ('values', 'low_95', 'high_95'):
            table = getattr(self, what)
            _named(table, VALUES[self.frame, self.acts_on], what)
            for name, row in table.items():
                check_plausible(name, row)
                if len(row) != count or not np.isfinite(row).all():
                    raise ValueError(f"expected {count} finite numbers in '{what}.{name}'")
        if len(self.seen) != count:
            raise ValueError(f"expected {count} times true or false in 'seen'")


def _named(table: Mapping[str, object], names: tuple[str, ...], what: str) -> None:
    if tuple(table) != names:
        raise ValueError(f"expected '{what}' to have: {', '.join(names)}")


def read_term(entry: Mapping[str, Any]) -> LearnedTerm:
    """Make the term of a validated entry.

    Parameters
    ----------
    entry : mapping
        The entry; numbers may be decimals.

    Returns
    -------
    LearnedTerm
        The term, SI.
    """
    names = VALUES[entry['frame'], entry['acts_on']]

    def table(what: str) -> np.ndarray:
        return np.stack([_si(name, entry[what][name]) for name in names], axis=1)

    return LearnedTerm(
        entry['against'], entry['frame'], entry['acts_on'],
        tuple(_si(name, entry['at'][name]) for name in AXES[entry['against']]),
        table('values'), table('low_95'), table('high_95'), np.array(entry['seen'], bool),
        entry.get('formula'),
        {name: float(value) for name, value in (entry.get('parameters') or {}).items()})


def _si(name: str, row: Any) -> np.ndarray:
    return np.array([exact_si(name, value) for value in row])


def write_term(term: LearnedTerm) -> dict[str, Any]:
    """Return the entry of a term.

    Parameters
    ----------
    term : LearnedTerm
        The term.

    Returns
    -------
    dict
        An entry that `read_term` reads back equal.
    """
    names = VALUES[term.frame, term.acts_on]

    def table(values: np.ndarray) -> dict[str, list[Any]]:
        return {name: _shown(name, column) for name, column in zip(names, values.T, strict=True)}

    return {
        'against': term.against, 'frame': term.frame, 'acts_on': term.acts_on,
        'formula': term.formula, 'parameters': dict(term.parameters),
        'at': {name: _shown(name, axis)
               for name, axis in zip(AXES[term.against], term.axes, strict=True)},
        'values': table(term.values), 'low_95': table(term.low), 'high_95': table(term.high),
        'seen': [bool(one) for one in term.seen],
    }


def _shown(name: str, row: np.ndarray) -> list[Any]:
    return [exact_display(name, float(value)) for value in row]
