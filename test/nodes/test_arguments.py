"""What the nodes that commands start are given."""

import pytest
from click.testing import CliRunner

from microbot_ros.cli import microbot
from microbot_ros.nodes import process
from microbot_ros.nodes.process import make

TRACKS = 't_s,particle,x_um,y_um\n' + ''.join(f'{k / 10},0,{k},0\n' for k in range(30))


@pytest.mark.parametrize('name', ['20261129', 'true', '1e3', 'a: b', "it's", 'plain'])
def test_a_session_may_have_any_name(tmp_path, monkeypatch, ros, name):
    folder = tmp_path / name
    folder.mkdir()
    (folder / 'tracks.csv').write_text(TRACKS)
    given = []
    monkeypatch.setattr(process, 'run', lambda _, words: given.append(words))
    monkeypatch.chdir(tmp_path)
    CliRunner().invoke(microbot, ['replay', name, '--rate', 'inf', '--topic', 'particles'],
                       catch_exceptions=False)
    graph = ros({})
    player = graph.nodes['player'] = make('player', given[0])
    player.trigger_configure()
    assert player.settings.session == name
    assert player.settings.topics == ['particles']
    assert player.settings.rate == 0.0
