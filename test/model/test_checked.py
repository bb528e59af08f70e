"""Settings check their types, limits and each other, and name the place of what is wrong."""

from __future__ import annotations

import dataclasses
import datetime
import math
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from microbot_ros.common.checked import Field, PositiveFloat, Settings, SettingsError, checked
from microbot_ros.common.errors import InputError, PackageError
from microbot_ros.common.files import beside, read_yaml


class Inner(Settings):
    size_mm: PositiveFloat
    kind: Literal['round', 'any', 1] = 'round'


class Outer(Settings):
    name: str = Field(default='a', pattern='^[a-z]+$', max_length=3)
    count: int = Field(default=1, ge=0, lt=5)
    pair: tuple[float, float] | None = None
    level: PositiveFloat | Annotated[tuple[PositiveFloat, ...], Field(min_length=1)] = 1.0
    inner: tuple[Inner, ...] = ()
    table: dict[str, float] = Field(default_factory=dict)
    path: Annotated[Path, beside] | None = None
    day: datetime.date | None = None
    on: bool = False

    def __post_init__(self) -> None:
        if self.pair and self.pair[0] > self.pair[1]:
            raise SettingsError('expected the smaller first', 'pair')
        if self.on and not self.inner:
            raise ValueError("expected 'inner' if 'on'")


WRONG: list[tuple[dict[str, Any], tuple[int | str, ...], str]] = [
    ({'nam': 1}, ('nam',), "unknown key 'nam'; expected one of: count, day, inner, level, name"),
    ({'inner': [{}]}, ('inner', 0, 'size_mm'), "expected a key 'inner.0.size_mm'"),
    ({'inner': [{'size_mm': 1}, {'size_mm': 0}]}, ('inner', 1, 'size_mm'),
     "'inner.1.size_mm': expected a number greater than 0; received 0"),
    ({'inner': [{'size_mm': 1e9}]}, ('inner', 0, 'size_mm'), 'expected -10000 to 10000 mm'),
    ({'inner': [{'size_mm': 1, 'kind': True}]}, ('inner', 0, 'kind'), 'one of: round, any, 1'),
    ({'inner': {'size_mm': 1}}, ('inner',), 'expected a list'),
    ({'inner': [3]}, ('inner', 0), r'expected a mapping \(key: value\); received 3'),
    ({'name': 'A'}, ('name',), r'a text that matches \^\[a-z\]\+\$'),
    ({'name': 'abcd'}, ('name',), 'a length of at most 3'),
    ({'name': 3}, ('name',), 'expected a text; received 3'),
    ({'count': -1}, ('count',), 'greater than or equal to 0'),
    ({'count': 5}, ('count',), 'less than 5'),
    ({'count': 1.5}, ('count',), 'a whole number'),
    ({'count': True}, ('count',), 'a whole number'),
    ({'count': '1'}, ('count',), 'a whole number'),
    ({'count': None}, ('count',), 'a whole number'),
    ({'level': [1, -1]}, ('level', 1), "'level.1': expected a number greater than 0"),
    ({'level': []}, ('level',), 'a finite number'),
    ({'level': math.nan}, ('level',), 'a finite number'),
    ({'level': math.inf}, ('level',), 'a finite number'),
    ({'level': 10**400}, ('level',), 'a finite number'),
    ({'pair': [1]}, ('pair',), 'expected 2 values'),
    ({'pair': [2, 1]}, ('pair',), "'pair': expected the smaller first; received"),
    ({'table': {'a': 'b'}}, ('table', 'a'), 'a finite number'),
    ({'table': {1: 2}}, ('table', '1'), 'a key that is a text'),
    ({'path': 3}, ('path',), 'a path'),
    ({'day': 'May'}, ('day',), 'a date'),
    ({'on': 1}, ('on',), 'true or false'),
    ({'on': True}, (), "expected 'inner' if 'on'; received")]


@pytest.mark.parametrize(('content', 'place', 'problem'), WRONG)
def test_what_does_not_fit_is_named_with_its_place(
        content: dict[str, Any], place: tuple[int | str, ...], problem: str) -> None:
    with pytest.raises(SettingsError, match=problem) as caught:
        Outer.from_content(content)
    assert caught.value.place == place


def test_what_fits_is_converted_and_kept() -> None:
    made = Outer(count=2.0, pair=np.array([1, 2]), level=[1, 2], inner=[{'size_mm': 3}],
                 table={'a': 1}, path='b', day=datetime.date(2026, 1, 31))
    assert (type(made.count), made.pair, made.level) == (int, (1.0, 2.0), (1.0, 2.0))
    assert made.inner == (Inner(size_mm=3.0),)
    assert made.path == Path('b')
    assert Outer.from_content({'count': 1, 'day': '2026-01-31'}).day == made.day
    assert made.given == {'count', 'pair', 'level', 'inner', 'table', 'path', 'day'}
    with pytest.raises(dataclasses.FrozenInstanceError):
        made.count = 3  # type: ignore[misc]


def test_content_is_that_of_a_file() -> None:
    made = Outer(count=1, inner=(Inner(size_mm=3.0),), path='b')
    assert Outer.from_content(made.content()) == made
    assert made.content('given') == {'count': 1, 'inner': [{'size_mm': 3.0}], 'path': 'b'}
    assert made.content('changed') == {'inner': [{'size_mm': 3.0}], 'path': 'b'}
    assert 'pair' not in made.content('not none')
    assert Outer.from_content(made) is made


def test_changes_are_checked_and_what_was_not_given_stays_so() -> None:
    made = Outer(count=1)
    changed = made.replaced(name='b')
    assert (changed.count, changed.name, changed.given) == (1, 'b', {'count', 'name'})
    assert made.name == 'a'
    with pytest.raises(SettingsError, match='less than 5'):
        made.replaced(count=7)


def test_paths_are_beside_the_file_only_while_it_is_read(tmp_path: Path) -> None:
    file = tmp_path / 'a.yaml'
    file.write_text('path: b\nlevel: 1e-3\ninner:\n- size_mm: 1\n')
    read = read_yaml(file, Outer)
    assert (read.path, read.level) == (tmp_path / 'b', 1e-3)
    assert Outer(path='b').path == Path('b')
    file.write_text('path: b\ninner:\n- size_mm: 1\n- size_mm: -2\n')
    with pytest.raises(InputError, match=r"a\.yaml:4: 'inner\.1\.size_mm': expected a number gr"):
        read_yaml(file, Outer)
    assert Outer(path='b').path == Path('b')


def test_an_installed_package_is_blamed_and_not_the_file() -> None:
    def refuse(_: object) -> object:
        raise PackageError('package', 'expected another version')

    class Broken(Settings):
        a: Any = None

        def __post_init__(self) -> None:
            refuse(self.a)

    for make in (Broken, lambda: checked(Annotated[int, refuse], 1)):
        with pytest.raises(PackageError, match=r'^package: expected another version'):
            make()


def test_a_number_of_a_union_keeps_its_type() -> None:
    for value in (True, 3, 3.0, '3'):
        found = checked(bool | Annotated[int, Field(le=9)] | float | str, value)
        assert (type(found), found) == (type(value), value)


@given(st.one_of(st.booleans(), st.integers(), st.floats(), st.text(), st.none()))
def test_a_number_is_a_number(value: object) -> None:
    fits = type(value) in (int, float) and -math.inf < value < math.inf  # type: ignore[operator]
    try:
        assert checked(float, value) == value
        assert fits
    except SettingsError:
        assert not fits or isinstance(value, int)
