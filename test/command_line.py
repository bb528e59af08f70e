"""The command line without the start of a process, where that is not what is tested."""

from __future__ import annotations

import sys
from unittest import mock

import pytest

from microbot_ros.cli import main


def microbot(*words: object) -> int:
    """The exit status of a command; what it says is said by this process."""
    with mock.patch.object(sys, 'argv', ['microbot', *map(str, words)]), \
            pytest.raises(SystemExit) as done:
        main()
    return int(done.value.code or 0)
