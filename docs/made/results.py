"""The fields of the files that commands write for programs, from the code that writes them."""

from __future__ import annotations

import ast
import importlib
import inspect
from collections.abc import Iterator
from pathlib import Path

import yaml

from made.text import MADE, code, table

MEANING = Path(__file__).with_name('results.yaml')
"""File → field → its meaning."""

_WRITERS = {
    'result.json': ('microbot_ros.discovery.result', 'microbot_ros.discovery.driven.conclusion'),
    'fit.json': ('microbot_ros.estimation.report',),
    'summary.json': ('microbot_ros.cli.demo.results', 'microbot_ros.cli.demo.demo'),
}
"""File → the modules in whose functions named here its fields stand."""

_FUNCTIONS = ('as_json', '_leg', 'summarise', '_estimates', '_look_back')

_WRITTEN_BY = {'result.json': 'microbot discover', 'fit.json': 'microbot fit',
               'summary.json': 'microbot demo'}


def fields(file: str) -> list[str]:
    """The fields of a `file`, in the order in which the code has them."""
    found: list[str] = []
    for module in _WRITERS[file]:
        tree = ast.parse(inspect.getsource(importlib.import_module(module)))
        for function in ast.walk(tree):
            if isinstance(function, ast.FunctionDef) and function.name in _FUNCTIONS:
                found += _keys(function)
    return list(dict.fromkeys(found))


def _keys(node: ast.AST) -> Iterator[str]:
    """The keys of the dictionaries in a `node`, each followed by those within its value."""
    if isinstance(node, ast.Dict):
        for key, value in zip(node.keys, node.values, strict=True):
            if isinstance(key, ast.Constant):
                yield str(key.value)
            yield from _keys(value)
        return
    if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Subscript):
        yield from (str(part.value) for part in [node.targets[0].slice]
                    if isinstance(part, ast.Constant))
    for part in ast.iter_child_nodes(node):
        yield from _keys(part)


def page() -> str:
    """`results.md`."""
    meaning = yaml.safe_load(MEANING.read_text(encoding='utf-8'))
    parts = [f'# Files of results\n\n{MADE} Names end in their unit. null means not known. '
             'Files of a session: [sessions](sessions.md).\n']
    for file, command in _WRITTEN_BY.items():
        rows = [[code(name), meaning[file][name]] for name in fields(file)]
        parts.append(f'## `{file}`\n\nWritten by `{command}`.\n\n'
                     + table(('field', 'meaning'), rows))
    return '\n'.join(parts)
