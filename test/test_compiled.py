"""The cache of compiled code, under processes that compile at the same moment."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import microbot_ros
from microbot_ros.common.compiled import COMPILES

pytestmark = pytest.mark.rig

PACKAGE = Path(microbot_ros.__file__).parent

FUNCTION = """
from microbot_ros.common.compiled import numba

@numba.njit(cache=True)
def half(x):
    return x / 2
"""

COMPILE = """
import sys

from microbot_ros.common.compiled import COMPILES
import threading
import time
from pathlib import Path
from microbot_ros.common.compiled import numba
from numba.core import caching
from compiled_twice import half

me, other = (Path(name) for name in sys.argv[1:3])
save = caching.IndexDataCacheFile._save_data

def wait_for_the_other(self, name, data):
    # Its index is written: the other has until then to write its own.
    me.touch()
    until = time.monotonic() + 1.0
    while not other.exists() and time.monotonic() < until:
        time.sleep(0.01)
    save(self, name, data)

caching.IndexDataCacheFile._save_data = wait_for_the_other
half(complex(sys.argv[3]) if 'j' in sys.argv[3] else int(sys.argv[3]))
"""

CALL = """
from compiled_twice import half
print(half(3), half(3), half(4 + 2j), half(4 + 2j), *half.stats.cache_hits.values())
"""


END = """
import os
from microbot_ros.common.compiled import numba
from numba.core import caching
from compiled_twice import half

# Between the index and the code that belongs to it.
caching.IndexDataCacheFile._save_data = lambda *_: os._exit(0)
half(8)
"""


def command(program, *words):
    return [sys.executable, '-c', program, *map(str, words)]


def said(folder, program):
    return subprocess.run(command(program), cwd=folder, capture_output=True, text=True,
                          check=True, timeout=60).stdout.split()


def test_two_that_compile_at_once_leave_code_for_both(tmp_path):
    (tmp_path / 'compiled_twice.py').write_text(FUNCTION)
    one, other = tmp_path / 'one', tmp_path / 'other'
    with (subprocess.Popen(command(COMPILE, one, other, '3'), cwd=tmp_path) as first,
          subprocess.Popen(command(COMPILE, other, one, '4+2j'), cwd=tmp_path) as second):
        assert [first.wait(60), second.wait(60)] == [0, 0]
    # Each signature is found, once, and not looked for at every call.
    assert said(tmp_path, CALL) == ['1.5', '1.5', '(2+1j)', '(2+1j)', '1', '1']


def test_code_of_older_sources_is_never_called(tmp_path):
    source = tmp_path / 'compiled_twice.py'
    source.write_text(FUNCTION)
    call = 'from compiled_twice import half; print(half(8))'
    assert said(tmp_path, call) == ['4.0']
    source.write_text(FUNCTION.replace('x / 2', 'x / 4 '))
    assert said(tmp_path, END) == []
    assert said(tmp_path, call) == ['2.0']


DECLARED = """
from compiled_twice import half
from microbot_ros.common.compiled import numba

@numba.njit('(float64,)', cache=True)
def quarter(x):
    return half(half(x)) + numba.uintp(1)
"""

LOAD = """
import sys
from declared import half, quarter
assert 'numba' not in sys.modules
from microbot_ros.common.compiled import load
load()
import declared, numba
assert declared.numba is numba
assert quarter.signatures == [(numba.float64,)]
assert half.stats.cache_path == declared.half.stats.cache_path
print(declared.quarter(8), quarter(4), half(3))
from later import eighth
print(eighth(16))
"""

LATER = """
from declared import quarter
from microbot_ros.common.compiled import numba

@numba.njit()
def eighth(x):
    return quarter(x) / 2
"""


def test_numba_is_loaded_by_the_first_call_and_compiles_what_is_declared(tmp_path):
    (tmp_path / 'compiled_twice.py').write_text(FUNCTION)
    (tmp_path / 'declared.py').write_text(DECLARED)
    (tmp_path / 'later.py').write_text(LATER)
    assert said(tmp_path, LOAD) == ['3.0', '2.0', '1.5', '2.5']
    assert said(tmp_path, 'from declared import quarter; print(quarter(8))') == ['3.0']


TOLD = """
from microbot_ros.common.compiled import tell_of_compiling
tell_of_compiling(print)
from compiled_twice import half
half(8), half(2.5)
"""


def test_it_is_told_once_that_code_is_compiled_and_only_where_it_is(tmp_path):
    (tmp_path / 'compiled_twice.py').write_text(FUNCTION)
    assert ' '.join(said(tmp_path, TOLD)) == COMPILES
    assert said(tmp_path, TOLD) == []
    again = TOLD + 'tell_of_compiling(print)\nhalf(4 + 2j)'
    assert ' '.join(said(tmp_path, again)) == COMPILES


CLONED = """
from microbot_ros.common.compiled import tell_of_compiling
tell_of_compiling(print)
import numpy as np
from microbot_ros.magnetics import loop
out = np.empty((1, 3))
loop.loop_field(np.zeros((1, 3)), np.zeros(3), np.eye(3), 1.0, 1.0, out)
print(loop.__file__, out[0, 2] / (2e-7 * np.pi))
"""


def test_a_clone_compiles_only_what_changed(tmp_path):
    """Also where only a constant of another file changed, which is compiled in."""
    def cloned(name):
        shutil.copytree(PACKAGE, tmp_path / name / 'microbot_ros',
                        ignore=shutil.ignore_patterns('__pycache__'),
                        copy_function=shutil.copyfile)  # with times of their own
        return tmp_path / name

    def run(folder):
        return subprocess.run(
            command(CLONED), cwd=folder, capture_output=True, text=True, check=True, timeout=100,
            env={**os.environ, 'NUMBA_CACHE_DIR': str(tmp_path / 'kept')}).stdout.splitlines()

    first, again, changed = (cloned(name) for name in ('first', 'again', 'changed'))
    *told, field = run(first)
    assert told == [COMPILES]
    assert field.startswith(str(first))
    assert float(field.split()[1]) == pytest.approx(1.0)
    other, = run(again)
    assert other.startswith(str(again))
    units = changed / 'microbot_ros' / 'common' / 'units.py'
    units.write_text(re.sub(r'^MU_0 = .*$', 'MU_0 = 8e-7 * math.pi', units.read_text(),
                            flags=re.MULTILINE))
    *told, field = run(changed)
    assert told == [COMPILES]
    assert float(field.split()[1]) == pytest.approx(2.0)
