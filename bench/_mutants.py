"""A mutation tester for one small module: does a test fail for every way to break it?

Each mutant is the module with one operator, constant, call or statement changed, run against the
module's own tests in a forked process. `python -m bench._mutants` lists the survivors.
"""

from __future__ import annotations

import ast
import copy
import importlib
import itertools
import os
import sys
import types
from collections.abc import Iterator
from pathlib import Path

import pytest

_SWAPPED: dict[type, tuple[type, ...]] = {
    ast.Lt: (ast.LtE, ast.GtE), ast.LtE: (ast.Lt, ast.Gt), ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt), ast.Eq: (ast.NotEq,), ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,), ast.IsNot: (ast.Is,), ast.Add: (ast.Sub,), ast.Sub: (ast.Add,),
    ast.Mult: (ast.Div,), ast.Div: (ast.Mult,), ast.And: (ast.Or,), ast.Or: (ast.And,),
}
_WORKERS = os.cpu_count() or 1
_RENAMED = {'min': 'max', 'max': 'min', 'all': 'any', 'any': 'all', 'abs': 'float'}


def mutants(source: str) -> Iterator[tuple[str, ast.Module]]:
    """Every mutant of a module's source, with the line and the change it makes."""
    tree = ast.parse(source)
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
            line = getattr(node, 'lineno', 0)
            yield f'line {line}: {before}  →  {_change(chosen, variant)}', mutant


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
    return None


def survivors(module: str, tests: Path) -> tuple[int, list[str]]:
    """How many mutants there are, and what the tests did not notice."""
    path = importlib.import_module(module).__file__
    found = list(mutants(Path(path or '').read_text(encoding='utf-8')))
    running: dict[int, str] = {}
    alive: list[str] = []
    waiting = list(reversed(found))
    while waiting or running:
        while waiting and len(running) < _WORKERS:
            what, mutant = waiting.pop()
            running[_try(module, mutant, tests)] = what
        child, status = os.wait()
        what = running.pop(child)
        if os.waitstatus_to_exitcode(status) == 0:
            alive.append(what)
    return len(found), alive


def _try(module: str, mutant: ast.Module, tests: Path) -> int:
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
        replaced = types.ModuleType(module)
        sys.modules[module] = replaced
        exec(compile(mutant, module, 'exec'), replaced.__dict__)
        code = int(pytest.main(['-x', '-q', '--timeout', '60', '-p', 'no:xdist', str(tests)]))
    finally:
        os._exit(code)


if __name__ == '__main__':
    total, alive = survivors('microbot_ros.drive.gate', Path('test/drive/test_gate.py'))
    print(f'{total} mutants, {len(alive)} survive', *alive, sep='\n')
