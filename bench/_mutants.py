"""A mutation tester for small modules: does a test fail for every way to break them?

Each mutant is a module with one operator, constant, call or statement changed, run against the
module's own tests in a forked process. What survives is a hole in the tests; those that no test
can tell, or that do no harm, are listed in `mutants.txt`, by the text of their line, and not
tried. `python -m bench._mutants [MODULE...]` lists the survivors.
"""

from __future__ import annotations

import ast
import copy
import importlib
import io
import itertools
import os
import sys
import types
from collections.abc import Iterator
from contextlib import redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

_SWAPPED: dict[type, tuple[type, ...]] = {
    ast.Lt: (ast.LtE, ast.GtE), ast.LtE: (ast.Lt, ast.Gt), ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt), ast.Eq: (ast.NotEq,), ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,), ast.IsNot: (ast.Is,), ast.Add: (ast.Sub,), ast.Sub: (ast.Add,),
    ast.Mult: (ast.Div,), ast.Div: (ast.Mult,), ast.And: (ast.Or,), ast.Or: (ast.And,),
}
TESTS = {
    'drive.gate': (['test_gate', 'test_lateness'], ''),
    'drive.self_check': (['test_self_check', 'test_lateness'], ''),
    'drive.coil_driver': (['test_coil_driver', 'test_sabertooth', 'test_coil_driver_thread',
                           'test_lateness'], 'not scpi'),
    'drive.heat': (['test_heat'], ''),
    'drive.adapter': (['test_adapter'], ''),
    'drive.amplifier': (['test_amplifiers', 'test_lines', 'test_adapter', 'test_sabertooth',
                         'test_serial_transfer_driver'], ''),
    'drive.polled': (['test_polled', 'test_amplifiers', 'test_lines', 'test_modbus', 'test_scpi',
                      'test_roboclaw', 'test_channels'], ''),
    'drive.last_resort': (['test_sentinel'], ''),
    'drive.sentinel': (['test_sentinel'], ''),
    'drive.amplifiers.serial_transfer.driver': (
        ['test_amplifiers', 'test_lines', 'test_serial_transfer_driver', 'test_coil_driver'],
        'serial_transfer or from_before_the_zero or over_a_network'),
    'drive.amplifiers.roboclaw.driver': (
        ['test_roboclaw', 'test_amplifiers', 'test_lines'], 'roboclaw'),
    'drive.amplifiers.sabertooth.driver': (['test_sabertooth'], ''),
    'drive.amplifiers.modbus.driver': (['test_modbus', 'test_amplifiers', 'test_lines'], 'modbus'),
    'drive.amplifiers.roboteq.driver': (
        ['test_roboteq', 'test_amplifiers', 'test_lines'], 'roboteq'),
    'drive.amplifiers.scpi.driver': (['test_scpi', 'test_amplifiers', 'test_lines'], 'scpi'),
    'nodes.coil_driver': (['test_coil_driver', 'test_rolling_field'], ''),
}
"""Module that can leave current on → its tests in the room's folder, and the -k that chooses
those of a protocol."""

_EXPLAINED = Path(__file__).with_name('mutants.txt')
_IMPORTING = ('microbot_ros', 'test', 'conftest', 'bench')
_HANGS_S = 30
_QUICKLY = ['-x', '-q', '--assert=plain', '--tb=no', '-p', 'no:xdist',
            '--timeout', str(_HANGS_S), '--timeout-method', 'thread']
_WORKERS = min(os.cpu_count() or 1, 2)
_RENAMED = {'min': 'max', 'max': 'min', 'all': 'any', 'any': 'all', 'abs': 'float'}


def mutants(source: str) -> Iterator[tuple[str, str]]:
    """Every mutant of a module's source, after the function, the line and the change it makes."""
    tree, lines = ast.parse(source), source.splitlines()
    places = {id(part): function.name for function in ast.walk(tree)
              if isinstance(function, ast.FunctionDef) for part in ast.walk(function)}
    # `strict` of zip only repeats what the types of both sides say: no test can tell.
    told_by_types = {id(keyword.value) for keyword in ast.walk(tree)
                     if isinstance(keyword, ast.keyword) and keyword.arg == 'strict'}
    for index, node in enumerate(ast.walk(tree)):
        if id(node) in told_by_types:
            continue
        for variant in range(4):
            if not _change(copy.deepcopy(node), variant):
                continue
            mutant = copy.deepcopy(tree)
            chosen = next(itertools.islice(ast.walk(mutant), index, None))
            before = ast.unparse(node).splitlines()[0]
            after = _change(chosen, variant)
            line = lines[getattr(node, 'lineno', 1) - 1].partition('  #')[0].strip()
            if ast.dump(node) != ast.dump(chosen):
                place = places.get(id(node), '')
                yield f'{place}: {line}  ::  {before}  →  {after}', ast.unparse(mutant)


def _change(node: ast.AST, variant: int) -> str | None:
    """Break the node in its variant-th way, in place; None where it has no such way."""
    if isinstance(node, ast.Compare):
        return _swap(node, 'ops', node.ops, variant)
    if isinstance(node, ast.BinOp | ast.BoolOp):
        return _swap(node, 'op', [node.op], variant)
    if variant:
        return None
    if isinstance(node, ast.Constant) and isinstance(node.value, bool | int | float):
        node.value = not node.value if isinstance(node.value, bool) else node.value + 1
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        node.op = ast.UAdd()
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        node.operand = ast.UnaryOp(ast.Not(), node.operand)
    elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load) and node.id in _RENAMED:
        node.id = _RENAMED[node.id]
    elif isinstance(node, ast.If | ast.IfExp):
        node.test = ast.UnaryOp(ast.Not(), node.test)
    else:
        return _delete(node)
    ast.fix_missing_locations(node)
    return ast.unparse(node).splitlines()[0]


def _swap(node: ast.AST, name: str, operators: list[ast.AST], variant: int) -> str | None:
    ways = [(place, other) for place, operator in enumerate(operators)
            for other in _SWAPPED.get(type(operator), ())]
    if variant >= len(ways):
        return None
    place, other = ways[variant]
    changed = [other() if i == place else operator for i, operator in enumerate(operators)]
    setattr(node, name, changed if name == 'ops' else changed[0])
    return ast.unparse(node).splitlines()[0]


def _delete(node: ast.AST) -> str | None:
    """Empty the statement: an assignment to an object, a call, an answer."""
    if isinstance(node, ast.Return) and node.value is not None:
        node.value = ast.Constant(None)
        return 'return None'
    if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Attribute):
        node.targets = [ast.Name('_', ast.Store())]
        ast.fix_missing_locations(node)
        return 'nothing'
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
        node.value = ast.Constant(None)
        ast.fix_missing_locations(node)
        return 'nothing'
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Yield | ast.YieldFrom):
        node.value = ast.YieldFrom(ast.Tuple([], ast.Load()))  # nothing, yet still a generator
        ast.fix_missing_locations(node)
        return 'nothing'
    return None


@dataclass(frozen=True)
class Survey:
    """What became of the mutants of one module."""

    total: int
    explained: int
    """Those that `mutants.txt` says keep no current on and let no wrong one through: not tried."""
    survived: list[str]
    """Those that a test should have killed."""


def survey(module: str) -> Survey:
    """Try the mutants of a module of `TESTS`.

    Raises RuntimeError where the tests fail without a mutant, as they then tell nothing, and for
    an explanation of what is not there any more.
    """
    names, chosen = TESTS[module]
    folder_of_tests = Path('test') / module.partition('.')[0]
    tests = [*(str(folder_of_tests / f'{name}.py') for name in names), '-k', chosen]
    _load(tests)  # first of all: it says where numba keeps compiled code
    full_name = f'microbot_ros.{module}'
    source = Path(importlib.import_module(full_name).__file__ or '').read_text('utf-8')
    found = list(mutants(source))
    explained = _explained().get(module, set())
    if gone := explained - {what for what, _ in found}:
        raise RuntimeError(f'explained and not there: {module}: {gone}')
    tried = [(what, mutant) for what, mutant in found if what not in explained]
    with TemporaryDirectory() as folder:
        if all(_end(_try(full_name, source, tests, folder)) for _ in range(3)):
            raise RuntimeError(f'the tests of {module} fail as it is')
        survived = list(_survivors(full_name, tried, tests, folder))
    return Survey(len(found), len(found) - len(tried), survived)


def _survivors(module: str, found: list[tuple[str, str]], tests: list[str],
               folder: str) -> Iterator[str]:
    running: dict[int, str] = {}
    waiting = list(reversed(found))
    while waiting or running:
        while waiting and len(running) < _WORKERS:
            what, mutant = waiting.pop()
            running[_try(module, mutant, tests, folder)] = what
        child, status = os.wait()
        what = running.pop(child)
        if os.waitstatus_to_exitcode(status) == 0:
            print(f'{module}: survived: {what}', file=sys.stderr, flush=True)
            yield what


def _load(tests: list[str]) -> None:
    """Load what the tests import, so that not every mutant has to."""
    with redirect_stdout(io.StringIO()):
        pytest.main([*_QUICKLY, '--collect-only', *tests])


def _try(module: str, mutant: str, tests: list[str], folder: str) -> int:
    """Run the tests with the mutant in the module's place, in a process that ends with 0 if all
    pass; its id.
    """
    child = os.fork()
    if child:
        return child
    code = 1
    try:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        os.dup2(1, 2)
        for loaded in [name for name in sys.modules if name.startswith(_IMPORTING)]:
            del sys.modules[loaded]  # what imported the module is to import the mutant
        replaced = types.ModuleType(module)
        path = Path(folder) / f'{os.getpid()}.py'  # a file, for what is started as a script
        path.write_text(mutant, encoding='utf-8')
        replaced.__file__ = str(path)
        sys.modules[module] = replaced
        package, _, name = module.rpartition('.')
        setattr(importlib.import_module(package), name, replaced)
        exec(compile(mutant, path, 'exec'), replaced.__dict__)
        code = int(pytest.main([*_QUICKLY, *tests]))
    finally:
        os._exit(code)


def _end(child: int) -> int:
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def _explained() -> dict[str, set[str]]:
    """Module → the mutants that need no test: lines under `# MODULE` and `## REASON`."""
    found: dict[str, set[str]] = {}
    for line in _EXPLAINED.read_text(encoding='utf-8').splitlines():
        if line.startswith('# '):
            module = found.setdefault(line[2:], set())
        elif found and line and not line.startswith('## '):
            module.add(line)
    return found


if __name__ == '__main__':
    for name in sys.argv[1:] or TESTS:
        result = survey(name)
        print(f'{name}: {result.total} mutants, {result.explained} explained, '
              f'{len(result.survived)} survive', flush=True)
