"""Pytest plugin that ends what pytest's own time-out does not: a clean-up that waits for ever.

The time-out raises an exception once. A `finally` or a fixture that then waits for a child, which
nothing will end, hangs the suite without a word. So does a thread that a failed test has left
behind, after the last test: what the suite has found is kept then.
"""

from __future__ import annotations

import contextlib
import faulthandler
import os
import sys
import threading
import time
from collections.abc import Iterator
from typing import Any

import psutil
import pytest

GRACE_S = 60.0
"""After the time-out of a test. Choice: four times what a clean-up takes on a busy machine."""


class Hung:
    """Prints where a test hangs and kills its children; after another `grace_s`, the suite.

    A suite that hangs after its last test exits with the status that it has found.
    """

    def __init__(self, grace_s: float = GRACE_S) -> None:
        self._grace_s = grace_s
        self._test = ''
        self._due = float('inf')
        self._warned = False
        self._errors = 0
        self._status = 1

    def pytest_configure(self, config: pytest.Config) -> None:
        """Look on where tests run; who only collects them may start children of its own later."""
        if config.option.collectonly:
            return
        # What is printed is captured only later.
        self._errors = os.dup(sys.__stderr__.fileno() if sys.__stderr__ else 2)
        threading.Thread(target=self._look_on, name='hung', daemon=True).start()

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[Any]:
        """Expect the end of a test in time."""
        marker = item.get_closest_marker('timeout')
        limit = float(marker.args[0] if marker else item.config.getoption('timeout')
                      or item.config.getini('timeout') or 0)
        self._test, self._warned = item.nodeid, False
        self._due = time.monotonic() + limit + self._grace_s if limit else float('inf')
        try:
            return (yield)
        finally:
            self._due = float('inf')

    @pytest.hookimpl(trylast=True)
    def pytest_sessionfinish(self, exitstatus: int) -> None:
        """Expect the end of the process as well; a worker is ended by pytest-xdist."""
        if 'PYTEST_XDIST_WORKER' in os.environ:
            return
        self._status = int(exitstatus)
        self._test, self._due = 'the end of the suite', time.monotonic() + 2 * self._grace_s

    def _look_on(self) -> None:
        while True:
            time.sleep(min(1.0, self._grace_s / 4))
            if time.monotonic() < self._due:
                continue
            with contextlib.suppress(ValueError):  # it is closed
                sys.stdout.flush()
            os.write(self._errors, f'\n{self._test} hangs; its children are killed\n'.encode())
            faulthandler.dump_traceback(self._errors)
            kept = ', '.join(thread.name for thread in threading.enumerate()
                             if not thread.daemon and thread is not threading.main_thread())
            os.write(self._errors, f'threads that keep the process: {kept or "none"}\n'.encode())
            if self._warned:
                os._exit(self._status)
            self._warned, self._due = True, time.monotonic() + self._grace_s
            for child in psutil.Process().children(recursive=True):
                with contextlib.suppress(psutil.Error):  # it has gone by itself
                    child.kill()
