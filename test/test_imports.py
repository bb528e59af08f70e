"""Imports run one way, file by file: what one file needs of another never leads back to it."""

import ast
from pathlib import Path

import microbot_ros

ROOT = Path(microbot_ros.__file__).parent
FILES = {
    '.'.join(('microbot_ros', *path.relative_to(ROOT).with_suffix('').parts))
    .removesuffix('.__init__'): path for path in sorted(ROOT.rglob('*.py'))}


def at_import(nodes):
    """Import statements that run when the file does: not in functions, nor for type checkers."""
    for node in nodes:
        if isinstance(node, ast.Import | ast.ImportFrom):
            yield node
        elif isinstance(node, ast.If) and 'TYPE_CHECKING' in ast.unparse(node.test):
            yield from at_import(node.orelse)
        elif not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            yield from at_import(ast.iter_child_nodes(node))


def needs(name):
    """The files of the package that a file names in its imports, by module name."""
    tree = ast.parse(FILES[name].read_text(encoding='utf-8'))
    for node in at_import(tree.body):
        assert not getattr(node, 'level', 0), f'{name}: relative import in line {node.lineno}'
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in FILES)
        elif node.module in FILES:
            inside = {f'{node.module}.{alias.name}' for alias in node.names}
            yield from inside & FILES.keys()
            if inside - FILES.keys():
                yield node.module


def circle(graph):
    """The names along one circle of {name: names}; none where there is no circle."""
    done = set()

    def visit(name, path):
        if name in path:
            return [*path[path.index(name):], name]
        if name in done:
            return []
        found = next(filter(None, (visit(other, [*path, name]) for other in graph[name])), [])
        done.add(name)
        return found

    return next(filter(None, (visit(name, []) for name in graph)), [])


def test_a_circle_is_found():
    assert circle({'a': ['b'], 'b': ['c', 'd'], 'c': [], 'd': ['b']}) == ['b', 'd', 'b']
    assert circle({'a': ['b', 'c'], 'b': ['c'], 'c': []}) == []


def test_no_import_leads_back():
    graph = {name: sorted({*needs(name)} - {name}) for name in FILES}
    assert sum(map(len, graph.values())) > 500
    assert circle(graph) == []


def test_what_is_compiled_uses_the_cache_that_many_processes_may_share():
    for name in FILES.keys() - {'microbot_ros.compiled'}:
        for node in ast.walk(ast.parse(FILES[name].read_text(encoding='utf-8'))):
            if isinstance(node, ast.Import):
                assert 'numba' not in {alias.name for alias in node.names}, name
            elif isinstance(node, ast.ImportFrom) and node.module == 'numba':
                assert {alias.name for alias in node.names} <= {'types'}, name
