"""The bench: one group that fails leaves the others, and a figure says where it is from."""

from __future__ import annotations

import importlib
import json
import statistics
import time
from dataclasses import dataclass
from pathlib import Path

import pytest

from bench import __main__ as main
from bench._kept import run_kept
from bench.figure import Figure, Timing, seconds

GOOD = """
from bench.figure import Figure, Timing
def figures():
    return [Figure(1, 'good', Timing(2.0, 0.25), 's', '≥ 1', 'none', True),
            Figure(1, 'unknown', float('nan'), 's', '≥ 1', 'none', True)]
"""
PARTLY = """
import time
from bench.figure import Figure
def figures():
    yield Figure(1, 'first', 1.0, 's', '≥ 1', 'none', True)
    time.sleep(600)
"""


@pytest.fixture
def groups(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A bench of four groups in a folder of its own."""
    package = tmp_path / 'bench'
    package.mkdir()
    for file in ('__init__', '__main__', 'figure'):
        source = Path(main.__file__).with_name(f'{file}.py')
        (package / source.name).write_text(source.read_text('utf-8'), 'utf-8')
    (package / 'good.py').write_text(GOOD)
    (package / 'partly.py').write_text(PARTLY)
    (package / 'raises.py').write_text('def figures():\n    raise RuntimeError\n')
    (package / 'sleeps.py').write_text('import time\ndef figures():\n    time.sleep(600)\n')
    monkeypatch.chdir(tmp_path)


@pytest.mark.rig
@pytest.mark.usefixtures('groups')
def test_a_group_that_fails_or_takes_too_long_leaves_the_others() -> None:
    begin = time.monotonic()
    good, unknown, raised, slept, first, cut, late = (
        entry for group, limit in (('good', 60.0), ('raises', 60.0), ('sleeps', 5.0),
                                   ('partly', 20.0), ('good', 0))
        for entry in main.run(group, limit))
    assert time.monotonic() - begin < 120
    assert (good['value'], good['spread'], good['ok']) == (2.0, 0.25, True)
    assert unknown['value'] is None
    assert [one['ok'] for one in (raised, slept, cut, late)] == [False] * 4
    assert 'ended with status 1' in raised['name']
    assert 'had not ended' in slept['name']
    assert (first['name'], first['ok']) == ('first', True)
    assert 'had not ended' in cut['name']
    assert 'no time was left' in late['name']
    for entry in (good, raised):
        assert {'group', 'commit', 'machine', 'load', 'peer', 'target'} <= entry.keys()
    json.dumps([good, raised], allow_nan=False)


def test_a_time_has_the_spread_of_its_rounds_and_a_ratio_of_both(
        monkeypatch: pytest.MonkeyPatch) -> None:
    spent = iter([1.0, 2.0, 3.0, 4.0, 5.0])
    clock = [0.0]
    monkeypatch.setattr(time, 'perf_counter', lambda: clock[0])
    calls = [0]

    def call() -> None:
        calls[0] += 1
        if calls[0] > 1:  # the first only warms up
            clock[0] += next(spent)

    (found,) = seconds(call, rounds=5)
    low, _, high = statistics.quantiles([1.0, 2.0, 3.0, 4.0, 5.0], n=4)
    assert (found, found.spread) == (3.0, (high - low) / 2)
    assert (found / Timing(3.0, 0.0)).spread == pytest.approx(found.spread / 3)
    assert (found / found).spread == pytest.approx(2**0.5 * found.spread / 3)
    assert (1e3 * found, (1e3 * found).spread) == (3e3, 1e3 * found.spread)
    assert main._entry(Figure(1, 'x', found / 2, '', '', '', True))['spread'] == found.spread / 2


@dataclass(frozen=True)
class Squared:
    of: int
    square: int


def square(number: int) -> Squared:
    return Squared(number, number**2)


@pytest.mark.rig
def test_an_outcome_is_kept_under_its_own_case_and_each_is_judged_once(tmp_path: Path) -> None:
    path = tmp_path / 'squares.jsonl'
    expected = [Squared(number, number**2) for number in range(5)]
    assert run_kept(path, range(5), square, lambda told: Squared(**told)) == expected
    lines = [json.loads(line) for line in path.read_text('utf-8').splitlines()]
    assert sorted((line['case'], line['outcome']['of']) for line in lines) == [
        (str(number), number) for number in range(5)]
    assert run_kept(path, range(5), square, lambda told: Squared(**told)) == expected
    assert len(path.read_text('utf-8').splitlines()) == 5


@pytest.mark.rig
@pytest.mark.parametrize('group', main.GROUPS)
def test_every_group_can_be_loaded(group: str) -> None:
    assert callable(importlib.import_module(f'bench.{group}').figures)
