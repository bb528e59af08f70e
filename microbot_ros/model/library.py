"""Discovery of effects: built-in ones, and entry points of the group `microbot_ros.effects`."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from importlib.metadata import EntryPoint, entry_points

from microbot_ros.common.errors import PackageError
from microbot_ros.model.effect import STAGES, Effect

GROUP = 'microbot_ros.effects'
"""Group of the entry points."""

_SAID = ('summary', 'required_excitation', 'confounded_with')
"""Texts that every effect must have."""


class Library(Mapping[str, type[Effect]]):
    """Effects by name: built-in ones, then those of other packages.

    Ordered by stage; within a stage, those of other packages act after the built-in ones, in
    alphabetical order. An effect that cannot be used raises PackageError, not a warning: nobody
    would notice a missing hypothesis in the result of a search.

    Parameters
    ----------
    built_in : sequence of type of Effect
        Built-in effects, in the order in which they act.
    """

    def __init__(self, built_in: Sequence[type[Effect]]) -> None:
        self._built_in = {effect.id: effect for effect in built_in}

    def __getitem__(self, name: str) -> type[Effect]:
        return self._effects[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._effects)

    def __len__(self) -> int:
        return len(self._effects)

    @cached_property
    def _effects(self) -> dict[str, type[Effect]]:
        """All effects, searched once: this reads the metadata of every installed package."""
        points = sorted(entry_points(group=GROUP), key=lambda point: point.name)
        effects, origin = dict(self._built_in), dict.fromkeys(self._built_in, 'microbot_ros')
        for point in points:
            if point.name in effects:
                raise PackageError(_place(point), f'expected a name of its own; '
                                 f'{origin[point.name]} has an effect of that name')
            effects[point.name], origin[point.name] = _load(point), _package(point)
        for point in points:
            for other in effects[point.name].confounded_with:
                if other not in effects:
                    raise PackageError(_place(point), f"'confounded_with': no effect '{other}' is "
                                     f'known; expected some of: {", ".join(effects)}')
        return dict(sorted(effects.items(), key=lambda item: STAGES.index(item[1].stage)))


def _load(point: EntryPoint) -> type[Effect]:
    try:
        found = point.load()
    except Exception as error:
        reason = ' '.join(f'{type(error).__name__}: {error}'.split())
        raise PackageError(
            _place(point), f"expected '{point.value}' to load; {reason}") from error
    if not (isinstance(found, type) and issubclass(found, Effect)):
        raise PackageError(
            _place(point), f"expected '{point.value}' to be a class that derives from Effect")
    missing = _missing(found, point.name)
    if missing:
        raise PackageError(_place(point), f'expected {missing}')
    return found


def _missing(found: type[Effect], name: str) -> str:
    """Return what a class lacks to be an effect called `name`, or ''."""
    if getattr(found, 'id', None) != name:
        return f"the 'id' {name}, as in the entry point; received {getattr(found, 'id', None)!r}"
    if getattr(found, 'stage', None) not in STAGES:
        return f"a 'stage' that is one of: {', '.join(STAGES)}"
    for what in _SAID:
        if getattr(found, what, None) is None:
            return f"a '{what}'"
    made = vars(found).get('__dataclass_params__')
    if made is None or not made.frozen:
        return 'a frozen dataclass'
    fields = dataclasses.fields(found)
    if not fields or any('parameter' not in field.metadata for field in fields):
        return 'one field or more, each declared with parameter(...)'
    for field in fields:
        if field.metadata['parameter'].field != field.name:
            expected = field.metadata['parameter'].field
            return f"the field '{field.name}' to be called '{expected}', its name without the unit"
    return ''


def _package(point: EntryPoint) -> str:
    return f'{point.dist.name} {point.dist.version}' if point.dist else 'an unknown package'


def _place(point: EntryPoint) -> str:
    return f"effect '{point.name}' of {_package(point)}"
