"""Dask cluster of a run: a local one, or a running one of the same version."""

from __future__ import annotations

import hashlib
import logging
import signal
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from microbot_ros.archive.work import Job, VersionError, do
from microbot_ros.common.errors import InputError, RigError, counted
from microbot_ros.common.extras import require
from microbot_ros.common.patience import PATIENCE

if TYPE_CHECKING:
    from distributed import Client

_CHECKED = ('python', 'microbot_ros', 'distributed', 'dask', 'cloudpickle', 'msgpack', 'numpy',
            'scipy', 'numba')
"""Packages that must be equal, so that messages are understood and numbers agree to the last
bit."""

DASHBOARD = '127.0.0.1:8787'
"""Address of the dashboard, the default port of Dask."""


class ClusterError(RigError):
    """Error of a scheduler that was lost during the work."""


@contextmanager
def cluster(workers: int | None = None, scheduler: str | None = None) -> Iterator[Client]:
    """Provide a client of a cluster.

    No other machine can reach the local cluster.

    Parameters
    ----------
    workers : int or None
        Number of workers on this machine; None for its cores.
    scheduler : str or None
        Address of a Dask scheduler to use instead; None for none.

    Yields
    ------
    Client
        The client.

    Raises
    ------
    InputError
        If the scheduler does not answer, if it or a worker has other versions, or if Dask is not
        installed.
    """
    require('dask')
    with _local(workers) if scheduler is None else _remote(scheduler) as client:
        yield client


@contextmanager
def _local(workers: int | None) -> Iterator[Client]:
    import dask
    from distributed import Client, LocalCluster

    # Dask's profile of a worker grows with every job, and takes a thirtieth of the processor.
    unprofiled = dask.config.set({'distributed.worker.profile.enabled': False})
    # Dask takes another port if this one is in use, and reports it.
    with _quietly():
        with unprofiled, _interrupts_ignored():
            local = LocalCluster(
                n_workers=workers, threads_per_worker=1, processes=True, host='127.0.0.1',
                dashboard_address=DASHBOARD, silence_logs=logging.CRITICAL)
        with local, Client(local, set_as_default=False) as client:
            yield client


@contextmanager
def _remote(scheduler: str) -> Iterator[Client]:
    from distributed import Client
    from distributed.comm.addressing import parse_address, parse_host_port

    with _quietly():
        try:
            # A client without address would complain again when it is deleted.
            parse_host_port(parse_address(scheduler)[1])
            client = Client(scheduler, timeout=PATIENCE.scheduler_s, set_as_default=False)
        except (OSError, ValueError, TypeError) as error:
            raise InputError(
                scheduler, 'expected the address of a running Dask scheduler, such as '
                           f'tcp://host:8786 ({_first_line(error)})') from None
        try:
            check_versions(client)
            yield client
        finally:
            with suppress(Exception):  # the scheduler may be gone
                client.close(timeout=2)


def _first_line(error: BaseException) -> str:
    return (str(error) or type(error).__name__).strip().splitlines()[0]


@contextmanager
def _interrupts_ignored() -> Iterator[None]:
    """Make processes started meanwhile ignore Ctrl-C, which a terminal sends to all of them."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


@contextmanager
def _quietly() -> Iterator[None]:
    """Suppress Dask's messages on ports, versions and connections, which are reported here."""
    loggers = [logging.getLogger(name) for name in [*logging.root.manager.loggerDict]
               if name.split('.')[0] in ('distributed', 'tornado')]
    before = [one.level for one in loggers]
    for one in loggers:
        one.setLevel(logging.CRITICAL)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter('ignore')
            yield
    finally:
        for one, level in zip(loggers, before, strict=True):
            one.setLevel(level)


def check_versions(client: Client) -> None:
    """Compare the versions of scheduler and workers with those of a client.

    Parameters
    ----------
    client : Client
        Client of the cluster.

    Raises
    ------
    InputError
        If any differs; it names both.
    """
    found: Any = client.get_versions(packages=['microbot_ros', 'scipy', 'numba'])
    ours = _versions(found['client'])
    others = {'the scheduler': found['scheduler']} | {
        f'worker {name}': one for name, one in found['workers'].items()}
    for who, one in others.items():
        theirs = _versions(one)
        for name in _CHECKED:
            # A scheduler only passes messages on.
            if who == 'the scheduler' and name in ('microbot_ros', 'scipy', 'numba', 'numpy'):
                continue
            if theirs.get(name) != ours.get(name):
                raise InputError(who, f'expected {name} {ours.get(name)} as here, found '
                                      f'{theirs.get(name) or "none"}')


def _versions(told: dict[str, Any]) -> dict[str, str]:
    python = '.'.join(told['host']['python'].split('.')[:2])
    return {**told['packages'], 'python': python}


def introduced(client: Client) -> str:
    """Return a sentence on the workers of a client, and on Dask's dashboard.

    Parameters
    ----------
    client : Client
        Client of the cluster.

    Returns
    -------
    str
        The sentence.
    """
    count = len(client.scheduler_info(n_workers=-1)['workers'])
    who = counted(count, 'worker') if count else (
        'no workers yet; waiting for one')
    if find_spec('bokeh') is None:
        return f'{who}; Dask’s dashboard needs bokeh (pip install bokeh)'
    return f'{who}; dashboard {client.dashboard_link}'


def run_jobs(client: Client, jobs: Sequence[Job], report: Callable[[Job, str], None]) -> None:
    """Run jobs, each as soon as a worker is free.

    Finished jobs stay finished if an error ends the run.

    Parameters
    ----------
    client : Client
        Client of the cluster.
    jobs : sequence of Job
        Jobs with different keys.
    report : callable
        Function that is called with each finished job, and '' or a sentence on why its worker
        failed.

    Raises
    ------
    OSError
        If the disk is full.
    InputError
        If a worker has another version.
    ClusterError
        If the scheduler is lost.
    """
    from distributed import as_completed

    # Another archive may run the same job on the same scheduler.
    of = {f'{job.key}-{hashlib.sha256(str(job.archive).encode()).hexdigest()[:8]}': job
          for job in jobs}
    waiting = as_completed(client.map(do, list(of.values()), key=list(of)), loop=client.loop)
    for done, future in enumerate(waiting):
        if future.status in ('cancelled', 'lost'):
            raise ClusterError(
                f'lost the scheduler after {done} of {len(of)} files; finished files are kept, '
                'and the same command continues from there')
        error = future.exception()
        if isinstance(error, VersionError):
            raise InputError('a worker', f'expected the same version, found {error}')
        if isinstance(error, OSError):
            raise error
        report(of[future.key], '' if error is None else _sentence(error))


def _sentence(error: BaseException) -> str:
    if type(error).__name__ == 'KilledWorker':
        return 'its worker died repeatedly, probably from lack of memory'
    return f'{type(error).__name__}: {_first_line(error)}'
