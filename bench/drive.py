"""The safety case in figures: gate, codecs, dead-man, a day of faults."""

from __future__ import annotations

import json
import multiprocessing
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from bench import (
    _day,
    _dead_man,
    _ends,
    _fuzz,
    _gate_sweep,
    _left_over,
    _lines,
    _matrix,
    _mutants,
)
from bench.figure import FULL, Figure, sized

_ISSUE, _SAFETY, _MATRIX = 6, 14, 32
_GATE = 'microbot_ros.drive.gate'
_GATE_TESTS = Path('test/drive/test_gate.py')
_SWEPT = sized(10_000_000, 1_000_000)
_FUZZ_S = sized(60, 10)
_DAY_H = sized(24, 2)
_TRIES = sized(50, 8)
_HOST_TRIES = sized(10, 2)
"""Each starts a host anew, for each protocol, delay and way to end."""
_END_TRIES = sized(3, 1)
"""Of each protocol, way to end and phase: 72 hosts a try, some two seconds each."""
_WITHOUT_DRIVER_S, _WITH_DRIVER_S = 0.2, 0.1
_JOYSTICK_S = 0.35
"""The joystick's own 0.25 s, and what a command may outlive its giver."""


def figures() -> Iterator[Figure]:
    """All figures; in full some eighty minutes on two cores, half of them for the mutants."""
    with ProcessPoolExecutor(2, multiprocessing.get_context('spawn')) as pool:
        day = pool.submit(_day.run, float(_DAY_H))
        swept = pool.submit(_gate_sweep.values_outside, _SWEPT)
        tally = pool.submit(_fuzz.run, _FUZZ_S)
        yield from _sweep_figures(*swept.result())
        yield from _codec_figures(tally.result())
        yield from _day_figures(day.result())
    # The mutants fork: before the dead-man brings the middleware's threads into this process.
    yield from _gate_figures()
    yield _left_over_figure()
    yield _matrix_figure()
    yield from _line_figures()
    yield from _dead_man_figures()


def _dead_man_figures() -> list[Figure]:
    return [_spent(name, spent, _limit_s(name))
            for name, spent in _dead_man.spent_s(_TRIES).items()]


def _limit_s(name: str) -> float:
    if 'joystick' in name:
        return _JOYSTICK_S
    gone = any(word in name for word in ('kill -9 of coil_driver', 'stopped driver', 'line'))
    return _WITHOUT_DRIVER_S if gone else _WITH_DRIVER_S


def _matrix_figure() -> Figure:
    """Print the fault matrix; its worst cell."""
    found = [*_matrix.cells(), *_ends.cells(_END_TRIES)]
    print('\n'.join(_matrix.table(found)), flush=True)
    wrong = sum(len(cell.wrong) for *_, cell in found)
    worst_s = max(max(cell.spent_s) for *_, cell in found)
    return Figure(_MATRIX, f'fault matrix, {len(found)} cells, {wrong} untrue answers: longest '
                  'current after a fault, of coils that can be reached', 1e3 * worst_s, 'ms',
                  f'<= {1e3 * _matrix.BOUND_S:g}', 'none',
                  all(cell.ok for *_, cell in found))


def _line_figures() -> list[Figure]:
    """The host's end is timed from then on, silence from the last command."""
    return [_spent(f'{protocol}, answers {delay} ms late, {what}', spent,
                   _WITH_DRIVER_S if what == 'commands' else _WITHOUT_DRIVER_S)
            for (protocol, delay, what), spent in _lines.spent_s(_TRIES, _HOST_TRIES).items()]


def _spent(name: str, spent: list[float], limit_s: float) -> Figure:
    return Figure(_SAFETY, f'last good command to zero, {name}, worst of {len(spent)} (median '
                  f'{1e3 * statistics.median(spent):.0f})', 1e3 * max(spent), 'ms',
                  f'<= {1e3 * limit_s:g}', 'none', max(spent) <= limit_s)


def _sweep_figures(wrong: int, passed: int) -> list[Figure]:
    return [Figure(_ISSUE, f'{_SWEPT:g} values through the gate, {passed} affirmed, outside '
                   'limits', wrong, 'values', '0', 'none', wrong == 0 and passed > _SWEPT / 4)]


def _gate_figures() -> list[Figure]:
    covered = _branch_coverage()
    return [Figure(_ISSUE, 'gate, lines and branches covered', covered, '%', '100', 'coverage.py',
                   covered == 100.0), *map(_mutant_figure, _mutated())]


def _mutated() -> list[str]:
    """Modules whose mutants are tried in full; `make soak` tries them all as well."""
    return list(_mutants.TESTS) if FULL else []


def _mutant_figure(module: str) -> Figure:
    found = _mutants.survey(module)
    return Figure(
        _ISSUE if module == 'drive.gate' else _SAFETY,
        f'{module}, survivors of {found.total} mutants ({found.explained} explained)',
        len(found.survived), 'mutants', '0', 'none', not found.survived)


def _branch_coverage() -> float:
    with tempfile.TemporaryDirectory() as folder:
        data, report = Path(folder) / 'data', Path(folder) / 'report.json'
        coverage = [sys.executable, '-m', 'coverage']
        subprocess.run([*coverage, 'run', '--branch', f'--data-file={data}', f'--source={_GATE}',
                        '-m', 'pytest', '-q', str(_GATE_TESTS)],
                       check=True, stdout=subprocess.DEVNULL)
        subprocess.run([*coverage, 'json', '-q', f'--data-file={data}', '-o', report], check=True)
        return float(json.loads(report.read_text())['totals']['percent_covered'])


def _codec_figures(tally: _fuzz.Tally) -> list[Figure]:
    bad = tally.raised + tally.accepted
    return [Figure(_ISSUE, f'codecs, {tally.cases} fuzzed cases in {_FUZZ_S:g} s: raised or '
                   'accepted though bad', bad, 'cases', '0', 'none', bad == 0)]


def _day_figures(day: _day.Day) -> list[Figure]:
    return [
        Figure(_ISSUE, f'{_DAY_H} h, {day.commands} commands, {day.faults} faults, '
               f'{day.trips} trips: wrong currents', day.wrong, 'commands', '0', 'none',
               day.wrong == 0 and day.trips > 0),
        Figure(_ISSUE, f'{_DAY_H} h: memory grown in the second half', day.resident_growth_kB,
               'kB', '<= 1024', 'none', day.resident_growth_kB <= 1024),
    ]


def _left_over_figure() -> Figure:
    left = _left_over.left_over()
    return Figure(_ISSUE, 'threads and descriptors left after 30 unplugged sessions', left,
                  'of both', '0', 'none', left == 0)
