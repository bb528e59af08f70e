"""Ending: what is to be done at once is done before whoever was interrupted cleans up."""

from __future__ import annotations

import subprocess
import sys

import pytest

pytestmark = pytest.mark.rig

PROGRAM = """
import os, signal, threading, time
from microbot_ros.common.ending import Ending, Stopped
done = []
held = threading.Lock()

def at_once():
    with held:
        time.sleep(0.02)  # where it lets go of the interpreter, another could keep it for long
        done.append('at once')

try:
    with Ending(at_once) as ending, ending.interrupts():
        held.acquire() if {locked} else None
        try:
            os.kill(os.getpid(), signal.{name})
            time.sleep(10)
        finally:
            done.append('interrupted')
            held.release() if {locked} else None
except Stopped:
    print(*done, sep=', ')
"""


def _order(name: str, locked: bool) -> str:
    program = PROGRAM.format(name=name, locked=locked)
    return subprocess.run([sys.executable, '-c', program], capture_output=True, text=True,
                          timeout=60, check=True).stdout.strip()


def test_what_is_to_be_done_at_once_comes_before_the_clean_up() -> None:
    for name in ('SIGINT', 'SIGTERM', 'SIGHUP'):
        assert _order(name, locked=False) == 'at once, interrupted'


WITHOUT_DESCRIPTOR = """
import errno, os, signal, subprocess, sys, time
from microbot_ros.common.ending import Ending

def refused(*_):
    raise OSError({number}, 'refused')
os.pidfd_open = refused
launcher = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(60)'])
done = []
with Ending(lambda: done.append('at once'), launcher.pid) as ending:
    time.sleep(0.3)
    assert not ending.due
    if {signalled}:
        os.kill(os.getpid(), signal.SIGTERM)
    else:
        launcher.kill()
        launcher.wait()
    deadline = time.monotonic() + 10.0
    while not ending.due and time.monotonic() < deadline:
        time.sleep(0.01)
launcher.kill()
print(*done)
"""


@pytest.mark.parametrize('number', ['errno.ENOSYS', 'errno.EPERM', 'errno.EMFILE'])
@pytest.mark.parametrize('signalled', [True, False])
def test_an_end_is_noticed_where_no_descriptor_of_the_launcher_is_to_be_had(
        number: str, signalled: bool) -> None:
    program = WITHOUT_DESCRIPTOR.format(number=number, signalled=signalled)
    assert subprocess.run([sys.executable, '-c', program], capture_output=True, text=True,
                          timeout=60, check=True).stdout.strip() == 'at once'


def test_a_lock_that_the_interrupted_holds_keeps_nobody_from_the_end() -> None:
    assert _order('SIGTERM', locked=True) == 'interrupted, at once'
