"""The checks of `make lint` that are our own find what they are for."""

import ast
from pathlib import Path

import lint

MODULE = '''
"""A module."""

class Field:
    """A field with a `strength`."""
    def __init__(self, strength, angle):
        pass

def shown(field: int, scale: float) -> int:
    """Show it."""

def bare():
    pass

def listed(one, two, *more):
    """List them.

    Parameters
    ----------
    one, other : float [m]
        Of `more` lengths than two.
    """
'''


def test_what_no_docstring_describes_is_named():
    found = {(where.rpartition(': ')[2], what)
             for where, what in lint.complaints(lint.ROOT / 'made.py', ast.parse(MODULE))}
    section = 'in its Parameters section'
    assert found == {
        ('Field', 'does not describe `angle`'), ('shown', 'does not describe `field`'),
        ('shown', 'does not describe `scale`'), ('bare', 'has no docstring'),
        ('listed', 'has no parameter `other` of its Parameters section'),
        *((where, f'lacks `{name}` {section}') for where, name in (
            ('Field', 'strength'), ('Field', 'angle'), ('shown', 'field'), ('shown', 'scale'),
            ('listed', 'two'), ('listed', 'more'))),
        ('shown', 'lacks a Returns section')}


def test_a_constant_without_an_origin_is_found():
    text = '''
"""A module."""
KNOWN = 1
"""From a paper."""
COUNT, _LIMIT = 2, 3
class Field:
    STEP: float = 0.1  # measured
    _ROOM = 7
Name = int
'''
    assert list(lint.unexplained(text)) == ['COUNT', '_ROOM']


def test_a_circle_is_found():
    assert lint.circle({'a': ['b'], 'b': ['c', 'd'], 'c': [], 'd': ['b']}) == ['b', 'd', 'b']
    assert lint.circle({'a': ['b', 'c'], 'b': ['c'], 'c': []}) == []


def test_imports_of_other_files_are_seen():
    assert 'microbot_ros.common.units' in set(lint.needs('microbot_ros.magnetics.loop'))
    assert sum(len({*lint.needs(name)}) for name in lint.FILES) > len(lint.FILES)


def test_numba_itself_is_found(monkeypatch, tmp_path):
    file = Path(tmp_path, 'made.py')
    monkeypatch.setattr(lint, 'FILES', {'made': file})
    for text, bad in (('import numba', True), ('from numba import njit', True),
                      ('from numba import types', True), ('import numpy', False)):
        file.write_text(text)
        assert list(lint.unshared()) == ['made'] * bad


def test_a_legend_without_a_place_is_found(monkeypatch, tmp_path):
    path = tmp_path / 'made.py'
    monkeypatch.setattr(lint, 'FILES', {'made': path})
    for call, bad in (('.legend()', True), (".legend(loc='best')", True),
                      (".legend(ncols=2, loc='upper left')", False)):
        path.write_text(f'axes{call}\n', encoding='utf-8')
        assert list(lint.unplaced()) == ['made:1'] * bad
