"""Every sentence that a fault can say, from the code, with its cause and its cure."""

from __future__ import annotations

import ast
import inspect
from collections.abc import Iterator
from enum import Enum
from pathlib import Path

import microbot_ros
from made.text import MADE, table
from microbot_ros.cockpit.faults import catalogue
from microbot_ros.control import contract, deadline_worker
from microbot_ros.control.contract import Result
from microbot_ros.drive import errors
from microbot_ros.drive.gate import Reason

_PACKAGE = Path(microbot_ros.__file__).parent

_PARTS: dict[str, tuple[str, ...]] = {
    'The gate and arming': (
        'drive/gate.py', 'drive/coil_driver.py', 'drive/self_check.py', 'nodes/coil_driver.py'),
    'The amplifier and its line': (
        'drive/errors.py', 'drive/amplifier.py', 'drive/polled.py', 'drive/transport.py',
        'drive/amplifiers/*/driver.py'),
    'The controller': (
        'control/**/*.py', 'loop/controller.py', 'loop/allocation.py', 'nodes/controller.py',
        'nodes/base/messages.py'),
    'Camera, tracker and model': (
        'nodes/camera.py', 'cameras/stream.py', 'nodes/tracker.py', 'tracking/**/*.py',
        'nodes/model.py', 'estimation/online/track_faults.py', 'estimation/online/monitor.py',
        'estimation/online/estimator.py', 'estimation/online/jumps.py',
        'nodes/virtual_rig.py'),
    'Every node, recorder and player': (
        'nodes/base/lifecycle.py', 'nodes/recorder.py', 'session/mcap/recorder.py',
        'nodes/player.py'),
}
"""Part of the rig → the files that can say what is wrong with it."""

_SAYS = ('complain', '_refuse', 'trip', 'Outcome', 'set_result', 'request_zero', 'SwitchResult',
         'Detector', '_note', '_tell', 'append')
"""Functions whose argument is a sentence for whoever drives the rig."""

_ANSWERS = ('arm', '_choose_commander', '_silence', '_diagnosis', '_stray', '_inspect', '_problem',
            '_changes', '_duplicates', '_clock', '_of_restless', '_of_held',
            'sentences')
"""Functions that return such a sentence."""

_NAMES = ('fault', 'complaint', 'problem', 'detail', '_trouble', '_finished', 'why', '_fault',
          'remark', 'stray', 'said', 'told')
"""Variables that hold one."""

_ERRORS = {kind.__name__ for module in (errors, contract, deadline_worker)
           for _, kind in inspect.getmembers(module, inspect.isclass)
           if issubclass(kind, Exception)} | {'FrameError', 'MessageError', 'HangingError'}
"""Errors whose text is one."""


_ALSO = {
    'manager.py': 'ValueError', 'allocation.py': 'ValueError',
    'stream.py': 'InputError', 'deadline_worker.py': 'RuntimeError'}
"""File → an error of Python's, or of input, that is one there."""

_WORDS: dict[str, type[Enum]] = {
    'Faults of the gate: the words before the colon': Reason,
    'Results of a controller: `result`': Result}
"""Part of the rig → the words by which it names its faults."""


def sentences() -> dict[str, list[str]]:
    """Part of the rig → what can be said of it, '…' for what is filled in."""
    found = {part: [str(word.value) for word in words if word is not Result.OK]
             for part, words in _WORDS.items()}
    for part, patterns in _PARTS.items():
        told = [sentence for pattern in patterns for path in sorted(_PACKAGE.glob(pattern))
                for sentence in _of_module(path)]
        found[part] = list(dict.fromkeys(told))
    return found


def _of_module(path: Path) -> Iterator[str]:
    errors_here = _ERRORS | {_ALSO.get(path.name, '')}
    for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
        for expression in _told(node, errors_here):
            yield from (text for text in _templates(expression) if ' ' in text.strip('… ;:'))


def _told(node: ast.AST, raised: set[str]) -> Iterator[ast.expr]:
    """The expressions in a node of the syntax tree that become sentences; so does the text of
    the errors in `raised`.
    """
    if isinstance(node, ast.FunctionDef) and node.name in _ANSWERS:
        yield from (found.value for found in ast.walk(node)
                    if isinstance(found, ast.Return) and found.value)
    elif isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
        if ast.unparse(node.exc.func).rpartition('.')[2] in raised:
            yield from node.exc.args
    elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute | ast.Name):
        name = ast.unparse(node.func).rpartition('.')[2]
        if name in _SAYS or ast.unparse(node.func) == 'super().__init__':
            yield from node.args
    elif isinstance(node, ast.Return) and isinstance(node.value, ast.Tuple) and node.value.elts:
        if ast.unparse(node.value.elts[0]) in ('WARN', 'ERROR'):
            yield node.value.elts[1]
    elif isinstance(node, ast.Assign | ast.AugAssign):
        target = node.target if isinstance(node, ast.AugAssign) else node.targets[-1]
        if ast.unparse(target).partition('[')[0].rpartition('.')[2] in _NAMES:
            yield node.value


def _templates(expression: ast.expr) -> Iterator[str]:
    """The texts that an expression can be."""
    if isinstance(expression, ast.Constant) and isinstance(expression.value, str):
        yield expression.value
    elif isinstance(expression, ast.JoinedStr):
        yield ''.join(str(part.value) if isinstance(part, ast.Constant) else '…'
                      for part in expression.values)
    elif isinstance(expression, ast.IfExp):
        yield from (*_templates(expression.body), *_templates(expression.orelse))
    elif isinstance(expression, ast.BoolOp | ast.Dict):
        for part in expression.values:
            yield from _templates(part)
    elif isinstance(expression, ast.Tuple | ast.List):
        for part in expression.elts:
            yield from _templates(part)
    elif isinstance(expression, ast.ListComp | ast.GeneratorExp):
        yield from _templates(expression.elt)
    elif isinstance(expression, ast.Call) and ast.unparse(expression.func) == 'tuple':
        yield from _templates(expression.args[0])


def page() -> str:
    """`when_something_trips.md`."""
    remedies = catalogue()
    parts = [
        f'# When something trips\n\n{MADE} It lists every sentence that a fault can print, its '
        'cause, and what to do. … stands for a value that is filled in. By symptom: '
        '[what can go wrong](what_can_go_wrong.md).\n\n'
        'A fault of the gate sends zero to the coils and is kept until the next `microbot arm`. '
        'Read the sentence on `/diagnostics` or in the terminal of `microbot run`. That of the '
        'coil driver is `disarmed, WHY (PARAMETERS): DETAIL; ZERO`:\n\n'
        + table(('part', 'meaning'), [
            ['`WHY`', 'the reason: the first table below'],
            ['`PARAMETERS`', 'the parameters of the limit'],
            ['`DETAIL`', 'the value and the limit'],
            ['`ZERO`', '*zero, confirmed by a reading*, *zero sent, not confirmed*, or *not '
             'reachable*: then switch the amplifier off by hand']])
        + '\nAn error in a file or an option, with exit status 2, states where it is and what '
        'was expected. Such errors are not listed here.\n']
    for part, told in sentences().items():
        rows = [[sentence, *remedies.get(part, {}).get(sentence, ('?', '?'))]
                for sentence in told]
        parts.append(f'## {part}\n\n' + table(('message', 'cause', 'what to do'), rows))
    return '\n'.join(parts)
