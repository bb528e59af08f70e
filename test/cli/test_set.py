"""`microbot set` from its command line; what nodes answer is tested with them."""

from __future__ import annotations

import pytest
from click.testing import CliRunner

from microbot_ros.cli.rig.set import command
from microbot_ros.common.errors import InputError
from microbot_ros.nodes.client import graph_client


class Graph:
    """Stands in for a running graph: notes what is set."""

    told: dict[str, object]

    def __init__(self, namespace='/'):
        Graph.told = {'namespace': namespace}

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def set(self, node, **values):
        Graph.told |= {'node': node, **values}


@pytest.fixture(autouse=True)
def graph(monkeypatch):
    monkeypatch.setattr(graph_client, 'GraphClient', Graph)


@pytest.mark.parametrize(('given', 'told'), [
    ('found/model.yaml', '{here}/found/model.yaml'), ('/there/model.yaml', '/there/model.yaml'),
    ('../model.yaml', '{above}/model.yaml'), ('', '')])
def test_a_path_is_from_here_wherever_the_node_runs(tmp_path, monkeypatch, given, told):
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(command, ['model', 'model_file', given, '--namespace', 'rig_2'])
    assert done.exit_code == 0, done.output
    assert Graph.told == {'namespace': 'rig_2', 'node': 'model', 'model_file': told.format(
        here=tmp_path, above=tmp_path.parent)}


@pytest.mark.parametrize(('given', 'told'), [
    ('5', 5), ('-5', -5), ('-5.5', -5.5), ('5.5', 5.5), ('true', True),
    ('[1, 2]', [1, 2]), ('waypoint', 'waypoint'),
    ('2026-03-14', '2026-03-14'), ('{a: 1}', '{a: 1}'), ('[', '['), ('9' * 6000, '9' * 6000)])
def test_values_are_what_they_look_like(given, told):
    assert CliRunner().invoke(command, ['controller', 'any', given]).exit_code == 0
    assert Graph.told['any'] == told
    assert type(Graph.told['any']) is type(told)


def test_a_parameter_without_a_name_is_none():
    done = CliRunner().invoke(command, ['model', '', '5'])
    assert isinstance(done.exception, InputError)
