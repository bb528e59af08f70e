"""Effects in YAML, by name and in the units of their names."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from decimal import Decimal
from typing import Annotated, Any

from microbot_ros.common.checked import Field, SettingsError, checked
from microbot_ros.common.plausible import check_plausible
from microbot_ros.common.units import exact_display, exact_si
from microbot_ros.model.effect import Effect
from microbot_ros.model.effects import EFFECTS
from microbot_ros.model.parameter import Parameter


def build_effects(table: Mapping[str, Mapping[str, Decimal | float | str]]) -> tuple[Effect, ...]:
    """Make the effects of a validated table.

    Parameters
    ----------
    table : mapping
        {effect: {parameter: value in the unit of its name}}.

    Returns
    -------
    tuple of Effect
        In the order of the table.
    """
    return tuple(
        EFFECTS[name](**{
            p.field: exact_si(p.name, values[p.name])
            for p in EFFECTS[name].parameters() if p.name in values
        })
        for name, values in table.items()
    )


def write_effects(effects: Iterable[Effect]) -> dict[str, dict[str, float]]:
    """Return the table of effects, in rounded numbers.

    Parameters
    ----------
    effects : iterable of Effect
        The effects.

    Returns
    -------
    dict
        {effect: {parameter: value in the unit of its name}}.
    """
    return {effect.id: {p.name: p.display_units(value) for p, value in effect.values().items()}
            for effect in effects}


def read_effects(table: Any) -> tuple[Effect, ...]:
    """Make the effects of a table that has not been validated.

    Parameters
    ----------
    table : object
        {effect: {parameter: value in the unit of its name}}.

    Returns
    -------
    tuple of Effect
        In the order of the table.

    Raises
    ------
    ValueError
        If the table is not valid; the message names the key and the error.
    """
    return build_effects(_checked(table))


def _checked(content: Any) -> dict[str, dict[str, float]]:
    """Return the table with numbers; SettingsError for unknown, missing and wrong values."""
    table = checked(dict[str, dict[str, Any]], content)
    for name, given in table.items():
        if name not in EFFECTS:
            raise SettingsError(f'unknown effect; known are {", ".join(EFFECTS)}', name,
                                received=name)
        try:
            table[name] = _parameters(EFFECTS[name], given)
        except SettingsError as error:
            raise error.below(name) from None
    return table


def _parameters(effect: type[Effect], given: dict[str, Any]) -> dict[str, float]:
    known = {p.name: p for p in effect.parameters()}
    for name in given:
        if name not in known:
            raise SettingsError(f'unknown parameter of {effect.id}; known are {", ".join(known)}',
                                name, received=name)
    for name, p in known.items():
        if name not in given and p.field not in effect.defaults():
            raise SettingsError("expected a key '{key}'", name)
    return {name: _number(known[name], value) for name, value in given.items()}


def _number(p: Parameter, value: Any) -> float:
    if p.inverse and value == math.inf:
        return math.inf
    low, high = (float(exact_display(p.name, bound)) for bound in (p.low, p.high))
    try:
        number: float = checked(Annotated[float, Field(ge=low, le=high)], value)
        check_plausible(p.name, number)
    except SettingsError as error:
        raise error.below(p.name) from None
    except ValueError as error:
        raise SettingsError(str(error), p.name, received=value) from None
    return number


EffectTable = Annotated[Any, _checked]
"""Type of a settings field that holds effects: {effect: {parameter: value}}.

Unknown names, missing parameters and values out of range are errors that name the key and what is
known. `build_effects` makes the effects.
"""
