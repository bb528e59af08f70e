"""Self-describing parameters: a frozen dataclass with name, unit, range and meaning of each.

ROS parameters, the parameters of controllers and the tables in the docs are made from these.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

from microbot_ros.common import units
from microbot_ros.common.errors import clipped, shown


@dataclass(frozen=True)
class About:
    """Meaning and limits of a setting.

    `description` for people; bounds `lower` and `upper`, None if unbounded; `choices`, empty if
    any value is allowed; `read_only` settings are fixed at start-up.
    """

    description: str
    lower: float | None = None
    upper: float | None = None
    choices: tuple[str, ...] = ()
    read_only: bool = False


def setting(
    default: Any,
    description: str,
    *,
    lower: float | None = None,
    upper: float | None = None,
    choices: tuple[str, ...] = (),
    read_only: bool = False,
) -> Any:
    """Return a dataclass field with a default and its limits; the name ends in the unit.

    `default`, `description`, `lower`, `upper` and `choices` as in `About`. `read_only` settings
    are fixed at start-up: safety limits, device names.

    Parameters
    ----------
    default : object
        Default value.
    description : str
        Sentence for people.
    lower : float or None
        Smallest value; None for no limit.
    upper : float or None
        Largest value; None for no limit.
    choices : tuple of str
        Allowed values; empty for any.
    read_only : bool
        Whether the value is fixed at start-up.

    Returns
    -------
    dataclasses.Field
        The field.
    """
    about = About(description, lower, upper, choices, read_only)
    if isinstance(default, list):
        return dataclasses.field(default_factory=lambda: list(default), metadata={'about': about})
    return dataclasses.field(default=default, metadata={'about': about})


def about(settings: type, name: str) -> About:
    """Return the description of the field `name` of the dataclass `settings`.

    Parameters
    ----------
    settings : type
        Dataclass with the settings.
    name : str
        Name of the field.

    Returns
    -------
    About
        The description.
    """
    found: About = settings.__dataclass_fields__[name].metadata['about']  # type: ignore[attr-defined]
    return found


def defaults(settings: type) -> dict[str, Any]:
    """Return the default of each field of a `settings` class, in its order.

    Parameters
    ----------
    settings : type
        Dataclass with the settings.

    Returns
    -------
    dict of str to object
        Default by name.
    """
    return {
        field.name: field.default_factory() if callable(field.default_factory) else field.default
        for field in dataclasses.fields(settings)
    }


def convert(settings: type, name: str, value: Any) -> Any:
    """Return `value` converted to the type of the field `name` of a `settings` class, checked.

    An integer is accepted for a float. Raises ValueError with what was expected for another type,
    NaN, infinity, and a value outside the range or the choices.

    Parameters
    ----------
    settings : type
        Dataclass with the settings.
    name : str
        Name of the field.
    value : object
        The value.

    Returns
    -------
    object
        The converted value.
    """
    default = defaults(settings)[name]
    if isinstance(default, float) and isinstance(value, int) and not isinstance(value, bool):
        value = float(value)
    if isinstance(default, list):
        value = _convert_list(settings, name, value)
    elif type(value) is not type(default):
        kind = {'str': 'a text', 'float': 'a number', 'int': 'a whole number', 'bool': 'a boolean'}
        raise ValueError(f'{name} must be {kind[type(default).__name__]}; received {shown(value)}')
    _check_limits(about(settings, name), name, value)
    return value


def _convert_list(settings: type, name: str, value: Any) -> list[Any]:
    of_texts = settings.__dataclass_fields__[name].type == 'list[str]'  # type: ignore[attr-defined]
    several = hasattr(value, '__iter__') and not isinstance(value, str | dict)
    items = list(value) if several else None
    if items is not None and not of_texts:
        items = [float(v) if isinstance(v, int) and not isinstance(v, bool) else v for v in items]
    if items is None or not all(isinstance(v, str if of_texts else float) for v in items):
        kind = 'texts' if of_texts else 'numbers'
        raise ValueError(f'{name} must be a list of {kind}; received {shown(value)}')
    return items


def _check_limits(allowed: About, name: str, value: Any) -> None:
    for item in value if isinstance(value, list) else [value]:
        if isinstance(item, float) and not math.isfinite(item):
            raise ValueError(f'{name} must be finite; received {item}')
        if allowed.choices and item not in allowed.choices:
            known = ', '.join(allowed.choices)
            raise ValueError(f'{name} must be one of {known}; received {clipped(str(item))}')
        if isinstance(item, int | float) and not isinstance(item, bool):
            low = -math.inf if allowed.lower is None else allowed.lower
            high = math.inf if allowed.upper is None else allowed.upper
            if not low <= item <= high:
                unit = units.symbol(name)
                raise ValueError(f'{name} must be {low:g} to {high:g} {unit}'.rstrip()
                                 + f'; received {item:g}')
