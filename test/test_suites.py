"""The three suites, and the retries of one of them: no failure is hidden, no skip unnoticed."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
TESTS = """
from pathlib import Path
import pytest

def runs(name):
    with Path(name).open('a') as file:
        file.write('x')
    return len(Path(name).read_text())

def test_passes():
    pass

def test_fails_once():
    assert runs('once') > 1

def test_fails_always():
    assert runs('always') < 0, 'the reason'

def test_fails_and_then_skips():
    if runs('skips') > 1:
        pytest.skip('no luck')
    raise RuntimeError

@pytest.fixture
def broken():
    yield
    assert runs('teardown') > 2

def test_fails_twice_at_its_end(broken):
    pass
"""
CONFTEST = f"""
import sys
sys.path.insert(0, {str(HERE / 'harness')!r})
from retries import Retries

def pytest_addoption(parser):
    parser.addoption('--retries', type=int, default=0)

def pytest_configure(config):
    if config.getoption('--retries'):
        config.pluginmanager.register(Retries(config.getoption('--retries')))
"""


def run(folder: Path, *words: str, **variables: str) -> subprocess.CompletedProcess[str]:
    kept = {name: value for name, value in os.environ.items()
            if name not in ('CI', 'MICROBOT_MAY_SKIP')}
    return subprocess.run([sys.executable, '-m', 'pytest', '-p', 'no:cacheprovider', *words],
                          cwd=folder, env={**kept, **variables}, capture_output=True, text=True)


@pytest.mark.rig
def test_a_failed_test_is_run_again_and_only_one_that_passes_then_has_passed(
        tmp_path: Path) -> None:
    (tmp_path / 'test_some.py').write_text(TESTS)
    (tmp_path / 'conftest.py').write_text(CONFTEST)
    done = run(tmp_path, '-q', '--retries', '3', 'test_some.py')
    assert done.returncode == 1
    assert done.stdout.splitlines()[-1].startswith('2 failed, 3 passed')
    assert '4 of 5 tests were run again' in done.stdout
    ledger = json.loads((tmp_path / 'out' / 'retries.json').read_text())
    assert (ledger['tests'], ledger['retried']) == (5, 4)
    runs = {name: [entry['passed'] for entry in ledger['runs'] if entry['test'].endswith(name)]
            for name in ('once', 'always', 'skips', 'end')}
    assert runs == {'once': [False, True], 'always': [False] * 4, 'skips': [False] * 4,
                    'end': [False, False, True]}
    assert any('the reason' in entry['said'] for entry in ledger['runs'])
    (tmp_path / 'always').write_text('')
    assert run(tmp_path, 'test_some.py::test_passes', '--retries', '3').returncode == 0
    assert run(tmp_path, 'test_some.py::test_fails_always').returncode == 1


SKIPS = """
import pytest

def test_named():
    pytest.skip('no recordings here')

@pytest.fixture(scope='module')
def nothing():
    pytest.skip('no browser here')

def test_fixture(nothing):
    pass

@pytest.mark.xfail
def test_expected_to_fail():
    raise RuntimeError
"""


@pytest.mark.rig
@pytest.mark.parametrize(('variables', 'summary'), [
    ({}, '2 skipped, 1 xfailed'), ({'CI': 'true'}, '1 failed, 1 xfailed, 1 error'),
    ({'CI': 'true', 'MICROBOT_MAY_SKIP': 'recordings,Aravis'}, '1 skipped, 1 xfailed, 1 error'),
    ({'CI': 'true', 'MICROBOT_MAY_SKIP': 'recordings,browser'}, '2 skipped, 1 xfailed')])
def test_where_all_should_be_there_a_skip_is_a_failure(
        tmp_path: Path, variables: dict[str, str], summary: str) -> None:
    (tmp_path / 'test_some.py').write_text(SKIPS)
    done = run(tmp_path, '-q', '-p', 'conftest', 'test_some.py', PYTHONPATH=str(HERE), **variables)
    assert done.stdout.splitlines()[-1].startswith(summary), done.stdout
    assert done.returncode == ('skipped' not in summary or 'error' in summary)


HANGS = """
import subprocess
import sys
import pytest

@pytest.fixture
def waits():
    child = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(600)'])
    yield
    child.wait()

@pytest.mark.timeout(0.5)
def test_hangs_at_its_end(waits):
    raise RuntimeError

def test_is_reached():
    pass
"""
HANGING = f"""
import sys
sys.path.insert(0, {str(HERE / 'harness')!r})
from hung import Hung

def pytest_configure(config):
    config.pluginmanager.register(Hung(1.0))
"""


@pytest.mark.rig
def test_a_clean_up_that_hangs_is_told_and_ended(tmp_path: Path) -> None:
    """Pytest prints no stacks after an exception, and its time-out raises one only once."""
    file = tmp_path / 'test_some.py'
    file.write_text(HANGS)
    (tmp_path / 'conftest.py').write_text(HANGING)
    done = run(tmp_path, '-q', '--timeout', '60', 'test_some.py')
    assert done.stdout.splitlines()[-1].startswith('1 failed, 1 passed')
    assert 'test_hangs_at_its_end hangs; its children are killed' in done.stderr
    assert 'line 10 in waits' in done.stderr
    # What is no child's fault ends the suite.
    file.write_text(HANGS.replace('child.wait()', 'import time; time.sleep(600)'))
    done = run(tmp_path, '-q', '--timeout', '60', 'test_some.py')
    assert done.returncode == 1
    assert done.stderr.count('line 10 in waits') == 2


LEFT = """
import threading

def test_leaves_a_thread():
    threading.Thread(target=threading.Event().wait, name='left').start()
"""


@pytest.mark.rig
@pytest.mark.parametrize('failure', ['', '    raise RuntimeError'])
def test_a_thread_that_is_left_keeps_no_suite_from_ending(tmp_path: Path, failure: str) -> None:
    (tmp_path / 'test_some.py').write_text(LEFT + failure)
    (tmp_path / 'conftest.py').write_text(HANGING)
    done = run(tmp_path, '-q', '--timeout', '60', 'test_some.py')
    assert done.returncode == bool(failure)
    assert done.stdout.splitlines()[-1].startswith('1 failed' if failure else '1 passed')
    assert done.stderr.splitlines()[-1] == 'threads that keep the process: left'


def test_who_only_collects_tests_is_not_looked_on(tmp_path: Path) -> None:
    """The survey of mutants collects once and runs its children for hours."""
    (tmp_path / 'conftest.py').write_text(HANGING)
    (tmp_path / 'test_some.py').write_text('def test_some(): pass')
    done = subprocess.run([sys.executable, '-c', (
        'import pytest, threading; pytest.main(["--collect-only", "-q", "test_some.py"]);'
        'print("hung" in [one.name for one in threading.enumerate()])')],
        cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == 'False'
