"""A report that fails leaves result and model, and the command says in one line what failed."""

import json
from contextlib import nullcontext
from dataclasses import replace
from unittest import mock

import pytest
from command_line import microbot

from microbot_ros.discovery.discover import discover
from microbot_ros.discovery.driven.drive import Driven
from microbot_ros.model.effects.velocity.uniform_drift import UniformDrift
from microbot_ros.model.io.model_file import read_model
from microbot_ros.session import write_session

REPORT = 'microbot_ros.discovery.report.page.page'


@pytest.fixture(name='session', scope='module')
def session_fixture(film):
    return film(10, duration=10.0)[0]


@pytest.fixture(name='found', scope='module')
def found_fixture(session):
    return discover([session])


def _check(folder, found, said, status):
    """The results are whole, and the last line on standard error names the report."""
    assert status == 1
    content = json.loads((folder / 'result.json').read_text())
    assert content['verdict'] == found.verdict
    assert len(read_model(folder / 'model.yaml')[1].ids) == 3
    assert not (folder / 'report.html').exists()
    line = said.err.strip().splitlines()[-1]
    assert f'{folder / "report.html"}: not written, IndexError: too few (' in line
    assert 'Prediction' in said.out


def test_discover(found, session, tmp_path, capsys):
    write_session(tmp_path / 'session', session)
    out = tmp_path / 'out'
    out.mkdir()
    (out / 'report.html').write_text('of other results')
    with mock.patch('microbot_ros.discovery.discover.discover', return_value=found), \
            mock.patch(REPORT, side_effect=IndexError('too few')):
        status = microbot('discover', tmp_path / 'session', '--out', out, '--force',
                          '--json', tmp_path / 'copy.json')
    _check(out, found, capsys.readouterr(), status)
    assert (tmp_path / 'copy.json').read_text() == (out / 'result.json').read_text()


def test_discover_live_publishes_the_verdict_and_goes_on(found, session, tmp_path, capsys):
    nodes, publisher = 'microbot_ros.nodes.client', mock.Mock()
    pages = mock.Mock(side_effect=[IndexError('once'), IndexError('too few')])
    with mock.patch(f'{nodes}.graph_client.GraphClient', return_value=nullcontext()), \
            mock.patch(f'{nodes}.live_session_buffer.LiveSessionBuffer'), \
            mock.patch(f'{nodes}.verdict_publisher.VerdictPublisher', return_value=publisher), \
            mock.patch('microbot_ros.cli.discover.discover._listen', return_value=session), \
            mock.patch('microbot_ros.discovery.discover.discover', return_value=found), \
            mock.patch(REPORT, pages):
        status = microbot('discover', '--live', '--rounds', '2', '--seconds', '10',
                          '--out', tmp_path)
    assert publisher.publish.call_count == 2
    assert (tmp_path / 'look-1' / 'model.yaml').is_file()
    _check(tmp_path / 'look-2', found, capsys.readouterr(), status)


@pytest.fixture(name='rig')
def rig_fixture():
    """Answers in place of a rig's; a function that lets its drive end so."""
    client, driven = 'microbot_ros.nodes.client', 'microbot_ros.discovery.driven.drive.drive'
    with mock.patch(f'{client}.graph_client.GraphClient', return_value=nullcontext()), \
            mock.patch(f'{client}.driven_rig.DrivenRig'), \
            mock.patch('microbot_ros.common.ending.Ending'), mock.patch(driven) as drive:
        yield lambda ended: drive.configure_mock(return_value=ended)


def test_discover_drive_applies_the_model_all_the_same(rig, found, session, tmp_path, capsys):
    named = replace(found, model=found.model.with_effect(UniformDrift(1e-7, 0.0)))
    rig(Driven([session], decided='settled'))
    given = mock.Mock(return_value='')
    with mock.patch('microbot_ros.discovery.driven.conclusion.discovered',
                    return_value=(named, session)), \
            mock.patch('microbot_ros.cli.discover.drive._give', given), \
            mock.patch(REPORT, side_effect=IndexError('too few')):
        status = microbot('discover', '--drive', '--apply', '--out', tmp_path)
    given.assert_called_once()
    _check(tmp_path, found, capsys.readouterr(), status)


def test_discover_drive_that_learns_nothing_leaves_no_earlier_model(rig, session, tmp_path):
    rig(Driven([session]))
    (tmp_path / 'model.yaml').write_text('of another search')
    assert microbot('discover', '--drive', '--force', '--out', tmp_path) == 1
    assert [path.name for path in tmp_path.iterdir()] == ['result.json']
