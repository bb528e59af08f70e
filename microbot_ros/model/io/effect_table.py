"""Effects in YAML, by name and in the units of their names."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from decimal import Decimal
from functools import cache
from typing import Annotated, Any, cast

import pydantic
from pydantic_core import InitErrorDetails, PydanticCustomError, ValidationError

from microbot_ros.common.files import Settings
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
    try:
        return build_effects(_check(table))
    except ValidationError as error:
        first = error.errors()[0]
        key = '.'.join(str(part) for part in first['loc'])
        raise ValueError(f'{key}: {first["msg"]}') from None


def _known_only(what: str) -> Any:
    def check(cls: type[pydantic.BaseModel], content: Any) -> Any:
        for key in content if isinstance(content, dict) else ():
            if key not in cls.model_fields:
                known = ', '.join(cls.model_fields)
                problem = PydanticCustomError('unknown', f'unknown {what}; known are {known}')
                details = InitErrorDetails(type=problem, loc=(str(key),), input=key)
                raise ValidationError.from_exception_data(cls.__name__, [details])
        return content

    return pydantic.model_validator(mode='before')(cast('Any', classmethod(check)))


def _number(p: Parameter, default: Any) -> Any:
    low, high = (float(exact_display(p.name, bound)) for bound in (p.low, p.high))
    return float, pydantic.Field(default, ge=low, le=high, allow_inf_nan=p.inverse)


def _settings_of(effect: type[Effect]) -> type[Settings]:
    optional = effect.defaults()
    fields: dict[str, Any] = {
        p.name: _number(p, optional.get(p.field, ...)) for p in effect.parameters()
    }
    checks = {'known': _known_only(f'parameter of {effect.id}')}
    return pydantic.create_model(effect.id, __base__=Settings, __validators__=checks, **fields)


@cache
def _library_settings() -> type[Settings]:
    return pydantic.create_model(
        'effects', __base__=Settings, __validators__={'known': _known_only('effect')},
        **cast('dict[str, Any]', {name: (_settings_of(e), None) for name, e in EFFECTS.items()}),
    )


def _check(content: Any) -> dict[str, dict[str, float]]:
    return _library_settings().model_validate(content).model_dump(exclude_unset=True)


EffectTable = Annotated[dict[str, dict[str, float]], pydantic.PlainValidator(_check)]
"""Type of a settings field that holds effects: {effect: {parameter: value}}.

Unknown names, missing parameters and values out of range are errors that name the key and what is
known. `build_effects` makes the effects.
"""
