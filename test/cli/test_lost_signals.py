"""A signal to a command that comes where Python hears no exception."""

import subprocess
import sys

import pytest

pytestmark = pytest.mark.rig

# The command collects an object, has a library call it back, or asks one that clears whatever
# goes wrong, and in there the signal comes.
_COMMAND = """
import ctypes, os, signal, sys, time, types
import click

def signalled(*_):
    os.kill(os.getpid(), signal.{name})
    time.sleep(10)
    return 0

class Collected:
    __del__ = signalled

def called_back():
    two = (ctypes.c_int * 2)()
    like = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p)
    ctypes.CDLL(None).qsort(two, 2, ctypes.sizeof(ctypes.c_int), like(signalled))

class Looked:
    attribute = property(signalled)

def cleared():
    ctypes.pythonapi.PyObject_HasAttrString(ctypes.py_object(Looked()), b'attribute')

@click.command()
def command():
    try:
        for _ in range({times}):
            {where}()
        time.sleep(10)
    finally:
        time.sleep(0.05)
        print('cleaned up')

sys.modules['microbot_ros.cli.info'] = types.SimpleNamespace(command=command)
sys.argv = ['microbot', 'info']
from microbot_ros.cli import script
script()
"""


@pytest.mark.parametrize('times', [1, 3])
@pytest.mark.parametrize('where', ['Collected', 'called_back', 'cleared'])
@pytest.mark.parametrize(('name', 'status'), [('SIGINT', 130), ('SIGTERM', 143), ('SIGHUP', 129)])
def test_a_signal_that_is_lost_comes_again(name, status, where, times):
    code = _COMMAND.format(name=name, where=where, times=times)
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, timeout=25)
    # For Ctrl-C click begins a new line, after the ^C that a terminal shows.
    assert (done.returncode, done.stdout, done.stderr.strip()) == (status, 'cleaned up\n', '')


def test_a_second_signal_does_not_disturb_the_clean_up():
    code = _COMMAND.format(name='SIGTERM', where='Collected', times=1).replace(
        '        time.sleep(0.05)', """
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(0.1)""")
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, timeout=25)
    assert (done.returncode, done.stdout, done.stderr) == (143, 'cleaned up\n', '')
