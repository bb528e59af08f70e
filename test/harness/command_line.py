"""The command line without the start of a process, where that is not what is tested."""

from __future__ import annotations

import inspect
import sys
from unittest import mock

import pytest
from click.testing import CliRunner

from microbot_ros.cli import main


def microbot(*words: object) -> int:
    """The exit status of a command; what it says is said by this process.

    A library that is not installed stays an ImportError, which skips the test.
    """
    with mock.patch.object(sys, 'argv', ['microbot', *map(str, words)]), \
            mock.patch('microbot_ros.cli.extras.advice', return_value=None), \
            pytest.raises(SystemExit) as done:
        main()
    return int(done.value.code or 0)


def runner() -> CliRunner:
    """Of a command alone, with its two outputs apart: click 8.1 does that only when asked."""
    mixes = 'mix_stderr' in inspect.signature(CliRunner).parameters
    return CliRunner(mix_stderr=False) if mixes else CliRunner()
