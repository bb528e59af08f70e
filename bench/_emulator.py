"""An emulated amplifier in a process of its own, and when its coils came to zero."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path

FULL_SCALE_A = 2.0


class Emulator:
    """Speaks a protocol at `url` until the end of the context; `fault` lets one happen."""

    def __init__(self, folder: Path, protocol: str, *options: str) -> None:
        link, log = folder / f'{protocol}-line', folder / f'{protocol}.jsonl'
        self._process = subprocess.Popen(
            [sys.executable, '-m', 'microbot_ros.cli', 'emulate', protocol, '--link', str(link),
             '--log', str(log), '--full-scale-A', str(FULL_SCALE_A), '--fault', '-', *options],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self._process.stdout is not None
        *_, places = self._process.stdout.readline().partition(' at ')
        self.url = ','.join(places.split())
        self._log = log.open()
        self._unfinished = ''
        self.changes: list[tuple[float, bool]] = []
        """When the currents changed [s, monotonic], and whether all were zero from then on."""
        self.flowed: list[tuple[float, tuple[float, ...]]] = []
        """When the currents changed [s, monotonic], and what they were from then on [A]."""

    def __enter__(self) -> Emulator:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.terminate()
        self._process.communicate()
        self._log.close()

    def read(self) -> None:
        """Bring `changes` up to date."""
        *lines, self._unfinished = (self._unfinished + self._log.read()).split('\n')
        for entry in map(json.loads, lines):
            self.changes.append((entry['t_monotonic_s'], not any(entry['currents_A'])))
            self.flowed.append((entry['t_monotonic_s'], tuple(entry['currents_A'])))

    def zero_after(self, moment_s: float, patience_s: float) -> float:
        """When the currents came to zero for good after a moment; TimeoutError if not so soon."""
        deadline = time.monotonic() + patience_s
        self.read()
        while not self.changes[-1][1] or self.changes[-1][0] < moment_s:
            if time.monotonic() > deadline:
                raise TimeoutError('the coils never came to zero')
            time.sleep(0.002)
            self.read()
        return self.changes[-1][0]

    def fault(self, text: str) -> None:
        """Let a fault happen from now on."""
        assert self._process.stdin is not None
        self._process.stdin.write(text + '\n')
        self._process.stdin.flush()
