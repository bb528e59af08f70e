"""Setup of all tests: the ROS domain, the hypothesis profile, skips and retries."""

from __future__ import annotations

import atexit
import gc
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import hypothesis
import pytest

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parent / 'harness'))

from domains import own_domain
from hung import Hung
from retries import Retries
from warm import CACHE

from microbot_ros.common.errors import InputError
from microbot_ros.common.extras import advice
from microbot_ros.common.patience import PATIENCE
from microbot_ros.control.registry import PluginError

# All that is imported and collected stays until the end: there is no garbage to look for.
gc.disable()

os.environ['NUMBA_CACHE_DIR'] = str(CACHE)
os.environ['ROS_DOMAIN_ID'] = str(own_domain())
os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
# The heat of coils that a test drives is none of this user's.
os.environ['XDG_STATE_HOME'] = tempfile.mkdtemp(prefix='microbot_state_')
atexit.register(shutil.rmtree, os.environ['XDG_STATE_HOME'], ignore_errors=True)
os.environ.setdefault('MPLBACKEND', 'Agg')

# `nohup` ignores SIGHUP, and a script SIGINT for what it runs in the background. Children inherit
# what is ignored, but no handler.
for number in (signal.SIGHUP, signal.SIGINT):
    if signal.getsignal(number) is signal.SIG_IGN:
        signal.signal(number, lambda *_: None)

# The same examples on every run, and no deadline: how long one takes depends on the machine.
hypothesis.settings.register_profile(
    'seeded', derandomize=True, deadline=None,
    suppress_health_check=[hypothesis.HealthCheck.too_slow])
hypothesis.settings.load_profile('seeded')

COMPLETE = os.environ.get('CI', '') not in ('', '0', 'false')
"""Whether this machine should have all that any test needs, so that a skip is a failure."""

_MAY_SKIP = tuple(filter(None, os.environ.get('MICROBOT_MAY_SKIP', '').split(',')))
"""Words of the reasons for which a test may be skipped even there."""

# Tests of an extra are not collected where the extra is not installed.
_OF_EXTRAS = {'gym/test_steering.py': 'gymnasium', 'gym/test_training_docs.py': 'gymnasium',
              'control/test_policy.py': 'onnx', 'archive/test_batch.py': 'polars',
              'archive/test_cluster.py': 'distributed', 'archive/test_imports.py': 'distributed',
              'control/test_effects.py': 'osqp', 'control/test_predictive.py': 'osqp',
              'drive/test_channels.py': 'pymodbus', 'drive/test_modbus.py': 'pymodbus'}
collect_ignore = [] if COMPLETE else [
    file for file, module in _OF_EXTRAS.items() if find_spec(module) is None]


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add `--retries`."""
    parser.addoption('--retries', type=int, default=0, metavar='N',
                     help='run a failed test again, alone, up to N times, and keep a ledger')


def pytest_configure(config: pytest.Config) -> None:
    """End what hangs; retry where that is asked for."""
    config.pluginmanager.register(Hung())
    if most := config.getoption('--retries'):
        config.pluginmanager.register(Retries(most))


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip what is tested of the amplifier `modbus` where its library is not installed."""
    if not COMPLETE and find_spec('pymodbus') is None:
        for item in items:
            if re.search(r'\[.*modbus', item.name):
                item.add_marker(pytest.mark.skip("pip install 'microbot_ros[modbus]'"))


def pytest_collection_finish() -> None:
    """Exclude modules and collected tests from garbage collection, which takes 0.5 s with them."""
    gc.freeze()
    gc.enable()


def pytest_sessionfinish() -> None:
    """Let what lives until the end of the process be freed in order."""
    gc.unfreeze()


@contextmanager
def _skipped_without_its_extra() -> Iterator[None]:
    """Context in which a library of an extra that is not installed skips the test by name."""
    try:
        yield
    except (ImportError, InputError, PluginError) as error:
        missing = advice(error) if isinstance(error, ImportError) else str(error)
        if not COMPLETE and missing and "pip install 'microbot_ros[" in missing:
            pytest.skip(missing)
        raise


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup() -> Iterator[None]:
    """Skip a test whose fixtures lack the library of an extra."""
    with _skipped_without_its_extra():
        return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call() -> Iterator[None]:
    """Skip a test that lacks the library of an extra."""
    with _skipped_without_its_extra():
        return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Iterator[None]:
    """Fail a test that is skipped where everything should be installed."""
    return _unless_expected((yield))


def pytest_exception_interact(call: pytest.CallInfo[Any]) -> None:
    """Let go of what a test that failed had, such as nodes, which later tests would meet."""
    if call.excinfo:
        traceback.clear_frames(call.excinfo.tb)


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report() -> Iterator[None]:
    """Fail a module that is skipped where everything should be installed."""
    return _unless_expected((yield))


def _unless_expected(report: Any) -> Any:
    if COMPLETE and report.skipped and not hasattr(report, 'wasxfail'):
        reason = str(report.longrepr[2])
        if not any(word in reason for word in _MAY_SKIP):
            report.outcome = 'failed'
            report.longrepr = f'{report.nodeid}: {reason} (nothing may be skipped where CI is set)'
    return report


@pytest.fixture(scope='session')
def real_time() -> bool:
    """Whether the system lets a process run in real time."""
    program = 'import os; os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(10))'
    return not subprocess.run([sys.executable, '-c', program], capture_output=True).returncode


@pytest.fixture
def patience(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Changes how long is waited for what others do, by the names in `Patience`."""
    def change(**seconds: float | tuple[float, ...]) -> None:
        for name, value in seconds.items():
            monkeypatch.setattr(PATIENCE, name, value)
    return change


@pytest.fixture(scope='session')
def recordings() -> Path:
    """The folder of real recordings; tests that need it are skipped where it is not."""
    folder = Path(__file__).parents[2] / 'shared' / 'data'
    if not folder.is_dir():
        pytest.skip('the real recordings (../shared/data) are not here')
    return folder
