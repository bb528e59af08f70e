"""On real workers: killed ones, a killed scheduler, other versions, nobody there."""

import os
import signal
import subprocess
import sys
from unittest import mock

import dask
import psutil
import pytest
from laboratories import fill

from bench._dask_by_hand import by_hand, kill_children, results, until
from microbot_ros.archive import batch, cluster, read_table
from microbot_ros.archive.cluster import ClusterError
from microbot_ros.common.errors import InputError
from microbot_ros.session.spreadsheets.sheets import Answers

# On a machine that is lent to others new workers take their time.
pytestmark = [pytest.mark.rig, pytest.mark.timeout(400)]

SETTINGS = {'exposure_s': 0.0, 'answers': vars(Answers())}


@pytest.fixture(scope='module')
def many(tmp_path_factory):
    """Thirty sessions, and a place for archives."""
    folder = fill(tmp_path_factory.mktemp('many') / 'laboratory', 30)
    return folder, tmp_path_factory.mktemp('cluster')


@pytest.fixture(scope='module')
def here(many):
    """What two workers on this machine reported, where they could be reached, their archive."""
    folder, place = many
    report, shown = [], set()

    def reported(progress):
        report.append(progress)
        if progress.done == 3:
            shown.update(listening())

    summary, _ = batch.run_batch('fit', [folder], place / 'here', SETTINGS, workers=2,
                                 report=reported)
    assert (summary.done, summary.failed) == (30, {})
    return report, shown, place / 'here'


def test_workers_here_say_how_far_they_are_and_listen_to_nobody_else(here):
    report, shown, _ = here
    assert shown == {'127.0.0.1'}
    [note] = [one.note for one in report if one.note]
    assert note.startswith('2 workers; dashboard http://127.0.0.1:')
    last = [one for one in report if one.total][-1]
    assert (last.done, last.total) == (30, 30)
    assert last.rate > 0
    assert last.seconds_left == 0


def test_workers_here_keep_no_profile_that_grows_with_every_job():
    with cluster.cluster(1) as client:
        kept = client.run(dask.config.get, 'distributed.worker.profile.enabled')
    assert [*kept.values()] == [False]


def test_the_same_by_workers_by_hand_whoever_is_killed(many, here):
    folder, place = many
    known = {}

    def kill(progress):
        if progress.done in (5, 12, 20) and not known.get(progress.done):
            known[progress.done] = results(place / 'there')
            # The nanny starts another one in its place.
            kill_children(workers[len(known) % 2].pid)

    with by_hand(place, 2) as (address, _, workers):
        summary, _ = batch.run_batch('fit', [folder], place / 'there', SETTINGS,
                                     scheduler=address, report=kill)
    assert (summary.done, summary.failed) == (30, {})
    assert len(known) == 3
    final = results(place / 'there')
    assert len(final) == 30
    for before in known.values():
        assert before.items() <= final.items()
    assert read_table(here[2]).equals(read_table(place / 'there'))


def listening():
    """The addresses at which this process and its workers can be reached."""
    me = psutil.Process()
    return {one.laddr.ip for some in (me, *me.children(recursive=True))
            for one in some.net_connections('tcp') if one.status == psutil.CONN_LISTEN}


def test_a_scheduler_that_dies_loses_nothing(many):
    folder, place = many
    out = place / 'lost'
    with by_hand(place, 1) as (address, scheduler, _):
        def kill(progress):
            if progress.done == 10:
                scheduler.kill()

        with pytest.raises(ClusterError, match='the same command continues from there'):
            batch.run_batch('fit', [folder], out, SETTINGS, scheduler=address, report=kill)
    before = results(out)
    assert 10 <= len(before) < 30
    with by_hand(place, 1) as (address, _, _):
        summary, found = batch.run_batch('fit', [folder], out, SETTINGS, scheduler=address)
    assert summary.done == 30 - len(before)
    assert found['sessions'] == 30
    assert before.items() <= results(out).items()
    assert len(results(out)) == 30


def test_nobody_there_and_other_versions(many, patience):
    folder, place = many
    patience(scheduler_s=1.0)
    with pytest.raises(InputError, match='expected the address of a running Dask scheduler'):
        batch.run_batch('fit', [folder], place / 'no', SETTINGS, scheduler='tcp://127.0.0.1:9')
    with pytest.raises(InputError, match='expected the address of a running Dask scheduler'):
        batch.run_batch('fit', [folder], place / 'no', SETTINGS, scheduler='nonsense')
    assert not results(place / 'no')


@pytest.mark.parametrize(('package', 'theirs', 'problem'), [
    ('microbot_ros', '0.0.9', r'worker tcp://w: expected microbot_ros 0\.1\.0 as here, found '
                              r'0\.0\.9'),
    ('microbot_ros', None, 'expected microbot_ros 0.1.0 as here, found none'),
    ('numpy', '1.0', 'worker tcp://w: expected numpy'), (None, '', None)])
def test_both_versions_are_named(package, theirs, problem):
    def told(**other):
        return {'host': {'python': '3.12.1.final.0'}, 'packages': {
            'python': '3.12.1.final.0', 'microbot_ros': '0.1.0', 'numpy': '2.0', 'dask': '1',
            'distributed': '1', 'msgpack': '1', 'cloudpickle': '1', 'scipy': '1', 'numba': '1'}
            | other}

    client = mock.Mock()
    client.get_versions.return_value = {
        'client': told(), 'scheduler': told(microbot_ros=None),
        'workers': {'tcp://w': told(**({package: theirs} if package else {}))}}
    if problem is None:
        cluster.check_versions(client)
        return
    with pytest.raises(InputError, match=problem):
        cluster.check_versions(client)


def test_ctrl_c_leaves_what_was_done(many):
    folder, place = many
    out = place / 'stopped'
    with subprocess.Popen(
            [sys.executable, '-m', 'microbot_ros.cli', 'batch', 'fit', str(folder), '--out',
             str(out), '--workers', '1'], stderr=subprocess.PIPE, text=True,
            start_new_session=True) as running:
        until(lambda: len(results(out)) > 5)
        # As a terminal does: to all of them.
        os.killpg(running.pid, signal.SIGINT)
        said = running.stderr.read()
        assert running.wait(60) == 130
    assert 'Traceback' not in said
    done = len(set(read_table(out).to_pandas().session))
    assert 5 < done <= len(results(out)) < 30
