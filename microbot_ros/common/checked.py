"""Settings that check themselves: frozen dataclasses with types and limits.

A class of settings states each field with its type, and with `Field` its limits. Making one, from
keywords or by `from_content` from what a YAML or JSON file holds, checks all of it; the first
value that does not fit is a SettingsError with its place. Only the standard library is used: the
pydantic of Ubuntu 24.04 is 1.10 (docs/decisions/settings.md).
"""

from __future__ import annotations

import dataclasses
import datetime
import math
import operator
import re
from collections.abc import Callable, Mapping
from functools import cache
from numbers import Integral, Real
from pathlib import Path
from types import UnionType
from typing import (
    Annotated,
    Any,
    ClassVar,
    Literal,
    Self,
    Union,
    dataclass_transform,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np

from microbot_ros.common.errors import PackageError, clipped, shown
from microbot_ros.common.plausible import check_plausible

Key = int | str
Which = Literal['all', 'given', 'changed', 'not none']
"""Fields of settings: all, those that were given, differ from the default, or are not None."""


class SettingsError(ValueError):
    """A value that does not fit its settings.

    Parameters
    ----------
    problem : str
        What was expected, as a phrase; `{key}` in it stands for the place, with dots.
    *place : int or str
        Keys and indices from the whole to the value.
    received : object
        The value; left out of the message if there is none.
    """

    def __init__(self, problem: str, *place: Key, received: Any = dataclasses.MISSING) -> None:
        super().__init__(problem)
        self.problem, self.place, self.received = problem, place, received

    def below(self, *place: Key) -> Self:
        """Prepend the `place` of the whole, and return the error itself.

        Parameters
        ----------
        *place : int or str
            Keys and indices.

        Returns
        -------
        SettingsError
            The error.
        """
        self.place = (*place, *self.place)
        return self

    def __str__(self) -> str:
        key = clipped('.'.join(map(str, self.place)))
        if self.received is dataclasses.MISSING:
            return self.problem.replace('{key}', key)
        where = f"'{key}': " if key else ''
        return f'{where}{self.problem}; received {shown(self.received)}'


@dataclasses.dataclass(frozen=True)
class _Limits:
    """Limits of a number, of the length of a text or sequence, and the pattern of a text."""

    gt: float | None = None
    ge: float | None = None
    lt: float | None = None
    le: float | None = None
    min_length: int | None = None
    max_length: int | None = None
    pattern: str | None = None

    def check(self, value: Any) -> None:
        """Raise SettingsError if `value` is beyond one of the limits."""
        for limit, within, words in (
                (self.gt, operator.gt, 'a number greater than'),
                (self.ge, operator.ge, 'a number greater than or equal to'),
                (self.lt, operator.lt, 'a number less than'),
                (self.le, operator.le, 'a number less than or equal to'),
                (self.min_length, lambda v, n: len(v) >= n, 'a length of at least'),
                (self.max_length, lambda v, n: len(v) <= n, 'a length of at most'),
                (self.pattern, lambda v, p: re.search(p, v), 'a text that matches')):
            if limit is not None and not within(value, limit):
                raise SettingsError(f'expected {words} {limit}', received=value)


def Field(*, default: Any = dataclasses.MISSING, default_factory: Any = dataclasses.MISSING,
          description: str = '', **limits: Any) -> Any:
    """Return a field of settings with its limits, or the limits of a type for `Annotated`.

    Parameters
    ----------
    default : object
        Default value; it is not checked.
    default_factory : callable
        Function that makes the default value.
    description : str
        Meaning for people.
    **limits : object
        `gt`, `ge`, `lt`, `le` of a number, `min_length`, `max_length` of a text or sequence, and
        `pattern` of a text.

    Returns
    -------
    dataclasses.Field
        The field.
    """
    options: dict[str, Any] = {'default': default, 'default_factory': default_factory}
    return dataclasses.field(
        **options, metadata={'limits': _Limits(**limits), 'description': description})


PositiveFloat = Annotated[float, Field(gt=0)]
PositiveInt = Annotated[int, Field(gt=0)]


@dataclass_transform(kw_only_default=True, frozen_default=True, field_specifiers=(Field,))
class Settings:
    """Base of settings: unknown keys, NaN, infinity and implausible numbers are errors.

    A subclass checks in `__post_init__` what several fields have to do with each other, and raises
    ValueError, or SettingsError with the name of the field that is wrong.

    Parameters
    ----------
    **given : object
        Values of the fields.
    """

    _others: ClassVar[bool] = False
    given: ClassVar[frozenset[str]]
    """Names of the fields that were given; set for each instance."""

    def __init_subclass__(cls, others: bool = False) -> None:
        cls._others = others  # whether unknown keys are left alone
        dataclasses.dataclass(frozen=True, kw_only=True, init=False)(cls)

    def __init__(self, /, **given: Any) -> None:
        fields, hints = _fields(type(self)), _hints(type(self))
        if not self._others:
            for key in given.keys() - fields.keys():
                raise SettingsError("unknown key '{key}'; expected one of: "
                                    f'{", ".join(sorted(fields))}', str(key))
        for name, field in fields.items():
            if name in given:
                value = _field(name, hints[name], field, given[name])
            elif (value := _default(field)) is dataclasses.MISSING:
                raise SettingsError("expected a key '{key}'", name)
            object.__setattr__(self, name, value)
        object.__setattr__(self, 'given', frozenset(given.keys() & fields.keys()))
        try:
            self.__post_init__()
        except SettingsError as error:
            error.received = getattr(self, str(error.place[0]), given) if error.place else given
            raise
        except ValueError as error:
            raise _unfit(error, given) from error

    def __post_init__(self) -> None:
        """Check the fields together; a subclass has its own checks here."""

    @classmethod
    def names(cls) -> tuple[str, ...]:
        """Return the names of all fields, in their order.

        Returns
        -------
        tuple of str
            The names.
        """
        return tuple(_fields(cls))

    @classmethod
    def from_content(cls, content: Any) -> Self:
        """Return the settings in the `content` of a file, checked.

        Parameters
        ----------
        content : object
            Mapping as YAML and JSON give it, or settings of this class, which are returned.

        Returns
        -------
        Settings
            The settings.

        Raises
        ------
        SettingsError
            For the first value that does not fit.
        """
        if isinstance(content, cls):
            return content
        if not isinstance(content, Mapping):
            raise SettingsError('expected a mapping (key: value)', received=content)
        return cls(**{str(key): value for key, value in content.items()})

    def replaced(self, **changes: Any) -> Self:
        """Return these settings with `changes`, checked.

        Parameters
        ----------
        **changes : object
            New values of fields.

        Returns
        -------
        Settings
            The new settings.
        """
        return type(self)(**{name: getattr(self, name) for name in self.given} | changes)

    def content(self, which: Which = 'all') -> dict[str, Any]:
        """Return the content of a file with these settings, which `from_content` accepts.

        Parameters
        ----------
        which : str
            Fields that the content has, also those of settings within.

        Returns
        -------
        dict of str to object
            Values of the fields, as YAML and JSON have them.
        """
        fields = _fields(type(self))

        def kept(name: str) -> bool:
            value = getattr(self, name)
            return (name in self.given if which == 'given' else
                    value is not None if which == 'not none' else
                    which == 'all' or value != _default(fields[name]))
        return {name: _plain(getattr(self, name), which) for name in fields if kept(name)}


def checked(kind: Any, content: Any) -> Any:
    """Return `content` as a value of the type `kind`.

    Parameters
    ----------
    kind : type
        Settings, float, int, bool, str, Path, date, Literal, Any, and tuples, lists, dicts, unions
        and Annotated of them. A function in Annotated converts the content before it is checked.
    content : object
        What a file holds.

    Returns
    -------
    object
        The value.

    Raises
    ------
    SettingsError
        For the first value that does not fit.
    """
    origin, arguments = get_origin(kind), get_args(kind)
    if kind is Any:
        return content
    if origin is Annotated:
        return _annotated(arguments[0], arguments[1:], content)
    if origin in (Union, UnionType):
        return _one_of(arguments, content)
    if origin is Literal:
        if not any(content == one and type(content) is type(one) for one in arguments):
            raise SettingsError(f'expected one of: {", ".join(map(str, arguments))}',
                                received=content)
        return content
    if origin in (tuple, list):
        return _sequence(origin, arguments, content)
    if origin is dict:
        return _mapping(arguments[1], content)
    if isinstance(kind, type) and issubclass(kind, Settings):
        return kind.from_content(content)
    words, accepts, convert = _SCALARS[kind]
    if not accepts(content):
        raise SettingsError(f'expected {words}', received=content)
    return convert(content)


def _is_number(value: Any) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float | Real):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:
        return False


def _is_whole(value: Any) -> bool:
    return _is_number(value) and (isinstance(value, Integral) or float(value).is_integer())


def _date(value: Any) -> datetime.date | None:
    """Return a date that YAML gives as such, or as a text in quotes; None for all else."""
    if isinstance(value, str):
        try:
            return datetime.date.fromisoformat(value)
        except ValueError:
            return None
    return value if type(value) is datetime.date else None


_SCALARS: dict[Any, tuple[str, Callable[[Any], bool], Callable[[Any], Any]]] = {
    float: ('a finite number', _is_number, float),
    int: ('a whole number', _is_whole, int),
    bool: ('true or false', lambda value: isinstance(value, bool), bool),
    str: ('a text', lambda value: isinstance(value, str), str),
    Path: ('a path', lambda value: isinstance(value, str | Path), Path),
    datetime.date: ('a date such as 2026-03-14', lambda value: _date(value) is not None,
                    _date)}
"""Type → what is expected in words, whether a value is of it, and its conversion."""


def _annotated(kind: Any, notes: tuple[Any, ...], content: Any) -> Any:
    for convert in filter(callable, notes):
        try:
            content = convert(content)
        except (SettingsError, PackageError):
            raise
        except ValueError as error:
            raise _unfit(error, content) from error
    value = checked(kind, content)
    for note in notes:
        if isinstance(note, dataclasses.Field):
            note.metadata['limits'].check(value)
    return value


def _one_of(kinds: tuple[Any, ...], content: Any) -> Any:
    """Return the content as its own type if the union has that, else as the first that it fits.

    If it fits none, the error is that of the type for which the wrong value lies deepest.
    """
    errors = []
    for kind in sorted(kinds, key=lambda kind: kind is not type(content)):
        if kind is type(None):
            if content is None:
                return None
            continue
        try:
            return checked(kind, content)
        except SettingsError as error:
            errors.append(error)
    raise max(errors, key=lambda error: len(error.place))


def _sequence(origin: type, arguments: tuple[Any, ...], content: Any) -> Any:
    if isinstance(content, np.ndarray):
        content = content.tolist()
    if not isinstance(content, tuple | list):
        raise SettingsError('expected a list', received=content)
    if origin is list or arguments[-1] is Ellipsis:
        kinds = [arguments[0]] * len(content)
    elif len(arguments) == len(content):
        kinds = list(arguments)
    else:
        raise SettingsError(f'expected {len(arguments)} values', received=content)
    return origin(_inside(index, kind, value)
                  for index, (kind, value) in enumerate(zip(kinds, content, strict=True)))


def _mapping(kind: Any, content: Any) -> dict[str, Any]:
    if not isinstance(content, Mapping):
        raise SettingsError('expected a mapping (key: value)', received=content)
    for key in content:
        if not isinstance(key, str):
            raise SettingsError('expected a key that is a text', str(key), received=key)
    return {key: _inside(key, kind, value) for key, value in content.items()}


def _inside(part: Key, kind: Any, value: Any) -> Any:
    try:
        return checked(kind, value)
    except SettingsError as error:
        raise error.below(part) from None


def _field(name: str, kind: Any, field: dataclasses.Field[Any], given: Any) -> Any:
    try:
        value = checked(kind, given)
        if 'limits' in field.metadata and value is not None:
            field.metadata['limits'].check(value)
        check_plausible(name, value)
    except SettingsError as error:
        raise error.below(name) from None
    except PackageError:
        raise
    except ValueError as error:
        raise _unfit(error, given).below(name) from error
    return value


def _default(field: dataclasses.Field[Any]) -> Any:
    """Return the default of a field, MISSING if it has none."""
    if field.default_factory is not dataclasses.MISSING:
        return field.default_factory()
    return field.default


def _unfit(error: ValueError, received: Any) -> SettingsError:
    """Return an error of other code about a value, unless it is about an installed package."""
    if isinstance(error, PackageError):
        raise error
    return SettingsError(str(error), received=received)


_fields: Callable[[Any], dict[str, dataclasses.Field[Any]]] = cache(
    lambda settings: {field.name: field for field in dataclasses.fields(settings)})
_hints: Callable[[Any], dict[str, Any]] = cache(
    lambda settings: get_type_hints(settings, include_extras=True))


def _plain(value: Any, which: Which) -> Any:
    if isinstance(value, Settings):
        return value.content(which)
    if isinstance(value, tuple | list):
        return [_plain(one, which) for one in value]
    if isinstance(value, dict):
        return {key: _plain(one, which) for key, one in value.items()}
    return str(value) if isinstance(value, Path | datetime.date) else value
