"""A signal to a command that comes where Python hears no exception."""

import signal
import subprocess
import sys

import pytest

pytestmark = pytest.mark.rig

_COMMAND = """
import os, signal, sys, time, types
import click
from microbot_ros import cli

class Collected:
    def __del__(self):
        os.kill(os.getpid(), signal.{name})

@click.command()
def command():
    Collected()
    time.sleep(60)

cli._CLEAN_UP_S = 1
sys.modules['microbot_ros.cli.info'] = types.SimpleNamespace(command=command)
sys.argv = ['microbot', 'info']
cli.script()
"""


@pytest.mark.parametrize('name', ['SIGTERM', 'SIGHUP'])
def test_a_command_ends_though_nobody_hears_of_its_signal(name: str) -> None:
    done = subprocess.run([sys.executable, '-c', _COMMAND.format(name=name)],
                          capture_output=True, timeout=50)
    assert done.returncode == -signal.SIGALRM
