"""Pytest plugin that runs each failed test again, alone, and keeps a ledger of the retries.

A failed test is held back until all other tests have ended. Then it runs in a process of its own,
up to `--retries` times, until it passes. Every retry is printed at the end and kept in
`out/retries.json`. A test that never passes is reported with its first failure.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from _pytest.runner import runtestprotocol
from stolen import Processors

LEDGER = Path('out/retries.json')

_BUDGET_S = 1200.0
"""For all retries. Choice: what the suite may take; where more fails, something is broken."""


class Retries:
    """Reruns of failed tests, at most `most` of each."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._ran = 0
        self._left_s = _BUDGET_S
        self._held: list[tuple[pytest.Item, list[pytest.TestReport], str]] = []
        self._ledger: list[dict[str, Any]] = []

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_protocol(self, item: Any, nextitem: Any) -> bool:
        """Run a test, and hold its reports back if one of them failed."""
        self._ran += 1
        item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
        with Processors() as processors:
            reports = runtestprotocol(item, log=False, nextitem=nextitem)
        if any(report.failed for report in reports):
            self._held.append((item, reports, str(processors)))
        else:
            _log(item, reports)
        item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
        return True

    @pytest.hookimpl(wrapper=True)
    def pytest_runtestloop(self, session: pytest.Session) -> Iterator[None]:
        """Run the held tests again, or report them as failed where the run was interrupted."""
        retry = False
        try:
            result = yield
            retry = True
        finally:
            for item, reports, machine in self._held:
                passed = retry and self._passes(item, reports, machine)
                _log(item, [_passed(item)] if passed else reports)
        self._keep(session.config.rootpath / LEDGER)
        return result

    def _passes(self, item: pytest.Item, reports: list[pytest.TestReport], machine: str) -> bool:
        first = next(report for report in reports if report.failed)
        self._note(item, 1, False, first.duration, machine, first)
        for number in range(2, self._most + 2):
            if self._left_s < 0:
                self._note(item, number, False, 0.0, '', 'no time is left to run it again')
                break
            begin = time.monotonic()
            with Processors() as processors:
                status, last = _alone(item)
            # A test that is skipped the second time has not passed.
            passed = status == 0 and ' passed' in f' {last}'
            spent_s = time.monotonic() - begin
            self._left_s -= spent_s
            self._note(item, number, passed, spent_s, str(processors), last)
            if passed:
                return True
        return False

    def _note(self, item: pytest.Item, number: int, passed: bool, seconds: float, machine: str,
              told: object) -> None:
        self._ledger.append({
            'test': item.nodeid, 'run': number, 'passed': passed, 'seconds': round(seconds, 1),
            'machine': machine, 'said': _reason(told)})

    def _keep(self, file: Path) -> None:
        file.parent.mkdir(exist_ok=True)
        tests = sorted({entry['test'] for entry in self._ledger})
        file.write_text(json.dumps(
            {'tests': self._ran, 'retried': len(tests), 'runs': self._ledger}, indent=1) + '\n')

    def pytest_terminal_summary(self, terminalreporter: Any) -> None:
        """Print the ledger."""
        terminalreporter.section('retries')
        for entry in self._ledger:
            outcome = 'passed' if entry['passed'] else 'FAILED'
            terminalreporter.write_line(
                '{test}: run {run} {} after {seconds} s, {machine}: {said}'.format(
                    outcome, **entry))
        retried = len({entry['test'] for entry in self._ledger})
        terminalreporter.write_line(
            f'{retried} of {self._ran} tests were run again; ledger: {LEDGER}')


def _alone(item: pytest.Item) -> tuple[int, str]:
    """Run a test in a process of its own; its status and the last line that it printed.

    It prints to a file: a pipe has no end while a grandchild that was left behind holds it.
    """
    with tempfile.TemporaryFile('w+') as printed:
        status = subprocess.call(
            [sys.executable, '-m', 'pytest', '-m', '', '-p', 'no:xdist', item.nodeid],
            cwd=item.config.rootpath, stdout=printed, stderr=subprocess.DEVNULL,
            env={**os.environ, 'PYTEST_ADDOPTS': ''})
        printed.seek(0)
        return status, printed.read().rstrip().rpartition('\n')[2]


def _log(item: pytest.Item, reports: list[pytest.TestReport]) -> None:
    for report in reports:
        item.ihook.pytest_runtest_logreport(report=report)


def _passed(item: pytest.Item) -> pytest.TestReport:
    return pytest.TestReport(item.nodeid, item.location, dict.fromkeys(item.keywords, 1),
                             'passed', None, 'call')


def _reason(told: object) -> str:
    """The line that says why a test failed, or the last line of pytest."""
    crash = getattr(getattr(told, 'longrepr', None), 'reprcrash', None)
    text = crash.message if crash is not None else str(getattr(told, 'longrepr', told))
    return text.strip().partition('\n')[0][:200]
