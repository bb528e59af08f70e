"""A scheduler and workers of Dask, each a process started by hand, as on a group's cluster."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil


def until(true: Callable[[], object], seconds: float = 90.0) -> None:
    """Wait until something is `true`; TimeoutError after so many `seconds`."""
    end = time.monotonic() + seconds
    while not true():
        if time.monotonic() > end:
            raise TimeoutError('it never came')
        time.sleep(0.05)


@contextlib.contextmanager
def process(*words: str) -> Iterator[subprocess.Popen[bytes]]:
    """A process of Dask's own command line, ended afterwards with all that it started."""
    with subprocess.Popen([sys.executable, '-m', 'distributed.cli.' + words[0], *words[1:]],
                          env={**os.environ, 'OMP_NUM_THREADS': '1'}, stdout=subprocess.DEVNULL,
                          stderr=subprocess.DEVNULL) as started:
        try:
            yield started
        finally:
            kill_children(started.pid)
            started.kill()


def kill_children(pid: int) -> None:
    """Kill all that the process of that `pid` started, as a machine does that goes down."""
    with contextlib.suppress(psutil.NoSuchProcess):
        for one in psutil.Process(pid).children(recursive=True):
            with contextlib.suppress(psutil.NoSuchProcess):
                one.kill()


@contextlib.contextmanager
def by_hand(folder: Path, workers: int,
            ) -> Iterator[tuple[str, subprocess.Popen[bytes], list[subprocess.Popen[bytes]]]]:
    """Address and process of a scheduler, and the processes of so many `workers`.

    They keep their files in a `folder`.
    """
    file = folder / f'scheduler-{time.monotonic_ns()}.json'
    with contextlib.ExitStack() as stack:
        scheduler = stack.enter_context(process(
            'dask_scheduler', '--host', '127.0.0.1', '--port', '0', '--no-dashboard',
            '--scheduler-file', str(file)))
        until(lambda: file.exists() and file.stat().st_size)
        address = json.loads(file.read_text())['address']
        yield address, scheduler, [stack.enter_context(process(
            'dask_worker', address, '--nthreads', '1', '--no-dashboard', '--local-directory',
            str(folder))) for _ in range(workers)]


def results(archive: Path) -> dict[str, int]:
    """{result: inode} of what is done in an `archive`: what is written again has another one."""
    return {path.name: path.stat().st_ino for path in archive.glob('.microbot/??/*.json')}
