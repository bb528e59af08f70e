"""Shared by all tests: a ROS domain of one's own, the oracles, where the real recordings are."""

from __future__ import annotations

import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import hypothesis
import pytest
from _pytest.runner import runtestprotocol

sys.path.insert(0, str(Path(__file__).parent))

from domains import own_domain
from stolen import Processors

os.environ['ROS_DOMAIN_ID'] = str(own_domain())
os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
os.environ.setdefault('MPLBACKEND', 'Agg')
# As `microbot discover` does: several threads for matrices of a hundred rows make only heat.
os.environ.setdefault('OMP_NUM_THREADS', '1')


# Examples are drawn, but the same every time: what is green here is green elsewhere.
hypothesis.settings.register_profile('seeded', derandomize=True)
hypothesis.settings.load_profile('seeded')

# What tests an extra is left out where that extra is not installed.
_OF_EXTRAS = {'gym/test_steering.py': 'gymnasium', 'gym/test_training_docs.py': 'gymnasium',
              'control/test_policy.py': 'onnx', 'archive/test_batch.py': 'polars',
              'archive/test_cluster.py': 'distributed', 'archive/test_imports.py': 'distributed'}
collect_ignore = [file for file, module in _OF_EXTRAS.items() if find_spec(module) is None]

_TRIES = 4
_TRIED = pytest.StashKey[int]()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What other processes and clocks have a part in comes last, when the machine is idler."""
    items.sort(key=lambda item: item.path.parent.name in ('drive', 'nodes'))


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item: Any, nextitem: Any) -> bool:
    """Try a test again that failed while the host lent the processors to others, or, once, one
    that is `clocked`."""
    tried = item.stash[_TRIED] = item.stash.get(_TRIED, 0) + 1
    item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
    with Processors() as processors:
        reports = runtestprotocol(item, log=False, nextitem=nextitem)
    again = not processors.ours or (tried == 1 and item.get_closest_marker('clocked'))
    if any(report.failed for report in reports) and again and tried < _TRIES:
        print(f'\n{item.nodeid}: tried again, {processors}', flush=True)
        item._initrequest()
        # By the hook once more: what limits its time is wound up anew, and a failure ends it.
        return bool(item.ihook.pytest_runtest_protocol(item=item, nextitem=nextitem))
    for report in reports:
        item.ihook.pytest_runtest_logreport(report=report)
    item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    return True


@pytest.fixture(scope='session')
def real_time() -> bool:
    """Whether the system lets a process run in real time."""
    program = 'import os; os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(10))'
    return not subprocess.run([sys.executable, '-c', program], capture_output=True).returncode


@pytest.fixture(scope='session')
def recordings() -> Path:
    """The folder of real recordings; tests that need it are skipped where it is not."""
    folder = Path(__file__).parents[2] / 'shared' / 'data'
    if not folder.is_dir():
        pytest.skip('the real recordings (../shared/data) are not here')
    return folder
