"""`microbot run` without processes: what it starts, says and returns."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar

import pytest
import yaml
from in_process import command

from microbot_ros.cli.rig import run
from microbot_ros.common.errors import InputError


class Children:
    """Stands in for the processes of a rig."""

    killed: ClassVar[list[str]] = []
    statuses: ClassVar[dict[str, int]] = {}
    problem: ClassVar[InputError | None] = None
    signal: ClassVar[int | None] = None
    started: ClassVar[list[str]] = []

    def __init__(self, tell: Any) -> None:
        self.tell = tell

    def __enter__(self) -> Children:
        return self

    def __exit__(self, *_: object) -> None:
        self.tell('controller', 'the last word')

    def start_node(self, name: str, _parameters: Path, namespace: str) -> None:
        assert namespace == '/lab'
        self.started.append(name)

    def wait_ready(self) -> None:
        if self.problem:
            raise self.problem

    def pump(self, _: float) -> None:
        if self.signal:
            os.kill(os.getpid(), self.signal)

    def tell_to_end(self) -> None:
        """Nothing runs."""

    @property
    def count(self) -> int:
        return len(self.started)

    def ended(self) -> dict[str, int]:
        return self.statuses


@pytest.fixture
def children(monkeypatch: pytest.MonkeyPatch) -> type[Children]:
    """The processes of one test."""
    made = type('Children', (Children,), {'started': []})
    monkeypatch.setattr(run, 'Graph', made)
    return made


@pytest.fixture
def config(tmp_path: Path) -> Path:
    """The file of a rig with two nodes."""
    file = tmp_path / 'rig.yaml'
    file.write_text(yaml.safe_dump({
        '/**/model': {'ros__parameters': {}}, '/**/controller': {'ros__parameters': {}}}))
    return file


def _run(config: Path, *words: str) -> tuple[int, str, str]:
    return command('run', '--config', config, '--namespace', 'lab', *words)


@pytest.mark.parametrize(('words', 'nodes'), [
    ((), ['model', 'controller']), (('--cockpit',), ['model', 'controller', 'cockpit'])])
def test_it_ends_when_every_node_has_and_says_which(
        children: type[Children], config: Path, words: tuple[str, ...],
        nodes: list[str]) -> None:
    children.statuses = dict.fromkeys(nodes, 3)
    status, out, error = _run(config, *words)
    assert (status, out) == (0, '')
    assert children.started == nodes
    assert 'microbot: running: model, controller' in error
    for name in children.statuses:
        assert f'{name}: ended with status 3; the other nodes go on' in error
    assert 'controller: the last word' in error


def test_a_node_that_had_to_be_killed_is_one(children: type[Children], config: Path) -> None:
    children.statuses, children.killed = {'model': 0, 'controller': -9}, ['controller']
    assert _run(config)[0] == 1


def test_a_signal_ends_it(children: type[Children], config: Path) -> None:
    children.signal = signal.SIGTERM
    status, _, error = _run(config)
    assert status == 0
    assert 'stopping on SIGTERM' in error


def test_what_a_node_refuses_is_two_and_where_it_stands(
        children: type[Children], config: Path) -> None:
    children.problem = InputError('controller', 'workspace_um must be left, bottom, right, top')
    status, _, error = _run(config)
    assert status == 2
    assert error.splitlines()[-1].startswith(
        f'microbot: {config}:2: controller: workspace_um must be')


@pytest.mark.usefixtures('children')
def test_arming_without_a_driver_is_one(
        config: Path, patience: Callable[..., None]) -> None:
    patience(find_s=0.2)
    status, _, error = _run(config, '--arm')
    assert status == 1
    assert 'coil_driver was not found in the namespace /lab' in error


def test_a_file_without_nodes_is_two(tmp_path: Path) -> None:
    (tmp_path / 'empty.yaml').write_text('{}\n')
    status, _, error = command('run', '--config', tmp_path / 'empty.yaml')
    assert status == 2
    assert 'expected a section for each node to run' in error
