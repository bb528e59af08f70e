"""`microbot discover --drive` as a child process, started and ended by the cockpit."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import sys
import time
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import Any

from microbot_ros.cockpit.rig import Answer, RefusedError
from microbot_ros.common import units
from microbot_ros.common.ending import PARENT
from microbot_ros.common.errors import clipped, one_line

_PATIENCE_S = 10.0
"""Time [s] in which a discovery must write its results when it is ended. Choice: writing takes
less on a slow disk."""


def default_folder() -> Path:
    """Return the folder of results that have no other place, in the data folder of this user.

    Returns
    -------
    Path
        The folder.
    """
    home = os.environ.get('XDG_DATA_HOME') or Path.home() / '.local' / 'share'
    return Path(home) / 'microbot_ros' / 'discoveries'


class Discovery:
    """Discovery that drives a rig to find what the model lacks; each run has a new folder.

    The child process is the head of its own process group, and ends with this process, however
    this one ends.

    Parameters
    ----------
    namespace : str
        Namespace of the rig.
    folder : Path
        Folder of the results.
    """

    def __init__(self, namespace: str, folder: Path) -> None:
        self._namespace, self._folder = namespace, folder
        self._process: asyncio.subprocess.Process | None = None
        self._reader: asyncio.Task[None] | None = None
        self._out = folder
        self._told = ''
        self._result: dict[str, Any] = {}
        self._odds: dict[str, float] = {}
        self._until_s = self._seconds = 0.0
        self._turn = asyncio.Lock()
        """Held from the check whether a discovery runs until its process exists, or was told to
        end: two simultaneous requests start one process."""
        self._over = False

    @property
    def running(self) -> bool:
        """Whether it drives now."""
        return self._process is not None

    def state(self, elsewhere: dict[str, Any]) -> dict[str, Any] | None:
        """Return the state for the page.

        Parameters
        ----------
        elsewhere : dict of str to object
            Result of a discovery started elsewhere, shown before the first run.

        Returns
        -------
        dict of str to object or None
            None if there is nothing to show.
        """
        if not self._told:
            return {'running': False, 'sentence': 'another discovery beside the rig',
                    **summary(elsewhere)} if elsewhere else None
        found = summary(self._result)
        left_s = round(max(self._until_s - time.monotonic(), 0.0)) if self.running else None
        name = self._out.name
        report = f'/discoveries/{name}/report.html' if self.report(name) else None
        return {'running': self.running, 'sentence': self._told, **found,
                'odds': found['odds'] or self._odds, 'left_s': left_s, 'of_s': self._seconds,
                'folder': str(self._out), 'report': report}

    def report(self, name: str) -> Path | None:
        """Return the report of a discovery.

        Parameters
        ----------
        name : str
            Name of the discovery.

        Returns
        -------
        Path or None
            Its path; None if there is none.
        """
        known = Path(name).name == name != '..'
        path = self._folder / name / 'report.html'
        return path if known and path.is_file() else None

    async def start(self, minutes: float, rig: str | None) -> Answer:
        """Drive a rig.

        Parameters
        ----------
        minutes : float
            Longest duration [min].
        rig : str or None
            State of the rig.

        Returns
        -------
        Answer
            Answer for the page.

        Raises
        ------
        RefusedError
            If a discovery runs, or if the rig is not armed.
        """
        async with self._turn:
            if self.running:
                raise RefusedError('discovery is already driving')
            if self._over:
                raise RefusedError('the cockpit is ending')
            if rig != 'armed':
                raise RefusedError('the rig is not armed; discovery drives the rig: arm it first')
            self._out = self._folder / f'{datetime.now():%Y-%m-%d_%H-%M-%S}'
            self._result, self._odds, self._told = {}, {}, 'starting'
            self._seconds = 60 * minutes
            self._until_s = time.monotonic() + self._seconds
            self._process = await asyncio.create_subprocess_exec(
                sys.executable, '-m', 'microbot_ros.cli', 'discover', '--drive', '--minutes',
                f'{minutes:g}', '--out', str(self._out), '--namespace', self._namespace,
                stdin=asyncio.subprocess.DEVNULL, stdout=asyncio.subprocess.PIPE,
                stderr=asyncio.subprocess.STDOUT, start_new_session=True,
                env={**os.environ, PARENT: str(os.getpid()), 'PYTHONUNBUFFERED': '1',
                     'COLUMNS': '1000'})
            self._reader = asyncio.create_task(self._follow(self._process))
        return f'driving for at most {minutes:g} min; results in {self._out}'

    async def stop(self) -> Answer:
        """End the discovery, which writes its results.

        Returns
        -------
        Answer
            Answer for the page.

        Raises
        ------
        RefusedError
            If none runs.
        """
        async with self._turn:
            if self._process is None:
                raise RefusedError('discovery is not driving')
            self._signal(signal.SIGTERM)
        return 'stopped on request'

    async def end(self) -> None:
        """End the child process when the server ends."""
        async with self._turn:
            self._over = True
        if self._reader is None or self._process is None:
            return
        self._signal(signal.SIGTERM)
        await asyncio.wait([self._reader], timeout=_PATIENCE_S)
        self._signal(signal.SIGKILL)
        await asyncio.wait([self._reader], timeout=_PATIENCE_S)

    def _signal(self, number: int) -> None:
        if self._process is not None:
            with suppress(ProcessLookupError):
                os.killpg(self._process.pid, number)

    def _written(self, name: str) -> dict[str, Any]:
        """Return the content of a file of results; empty if it is not there or not whole."""
        with suppress(OSError, ValueError):
            content = json.loads((self._out / name).read_text())
            return content if isinstance(content, dict) else {}
        return {}

    async def _follow(self, process: asyncio.subprocess.Process) -> None:
        """Keep the last line that the process prints, and at its end the result."""
        assert process.stdout is not None
        while data := await process.stdout.readline():
            if line := one_line(data.decode(errors='replace').strip()):
                self._told = clipped(line) if len(line) > 300 else line
            self._odds = self._written('progress.json').get('odds', {})
        status = await process.wait()
        self._result = self._written('result.json')
        if status:
            self._told = f'ended with status {status}: {self._told}'
        self._process = None


def summary(result: dict[str, Any]) -> dict[str, Any]:
    """Return the part of a result that a page shows.

    Parameters
    ----------
    result : dict of str to object
        Content of `result.json`.

    Returns
    -------
    dict of str to object
        Values by name; None for missing ones.
    """
    effects = result.get('effects') or [{}]
    gap = result.get('gap') or {}
    experiments = result.get('experiments') or [{}]
    return {
        'verdict': result.get('verdict'), 'decided': result.get('decided'),
        'effect': effects[0].get('id'), 'sizes': _sizes(effects[0].get('parameters') or {}),
        'gap_um': gap.get('after_um', gap.get('before_um')),
        'odds': experiments[-1].get('odds', {}), 'minutes': result.get('minutes'),
        'next': result.get('next_experiment'),
        'learned': [{'sentence': one.get('sentence'), 'arrows': one.get('arrows') or []}
                    for one in result.get('learned') or []]}


def _sizes(parameters: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the parameters of an effect, with half their 95 % intervals, in their units."""
    return [{'name': units.bare(name), 'unit': units.symbol(name),
             'value': found['value'], 'half': (found['high_95'] - found['low_95']) / 2
             if None not in (found['high_95'], found['low_95']) else None}
            for name, found in parameters.items()]
