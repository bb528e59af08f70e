"""The sentinel process, from the side of the driver that it watches."""

from __future__ import annotations

import fcntl
import os
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path

from microbot_ros.drive import sentinel

_SCRIPT = Path(sentinel.__file__)
_SILENCE_S = 0.1
"""How long the driver may be silent: like the watchdogs of devices that have one."""
_FEED_S = 0.02
_LEAVE_S = 1.0
_UNREAD_BYTES = 4096
"""Heartbeats that a sentinel may leave unread before it counts as gone: 82 s of them. The smallest
pipe that Linux makes."""


class LastResort:
    """A sentinel over open lines; `words` are their descriptors and what zeroes their coils."""

    def __init__(self, words: Sequence[tuple[int, bytes]]) -> None:
        self._fed_s = 0.0
        self._process = subprocess.Popen(
            [sys.executable, '-I', '-S', str(_SCRIPT), str(_SILENCE_S),
             *(f'{descriptor}={word.hex()}' for descriptor, word in words)],
            stdin=subprocess.PIPE, pass_fds=[descriptor for descriptor, _ in words],
            start_new_session=True)
        assert self._process.stdin is not None
        self._pipe = self._process.stdin
        self._feed = self._pipe.fileno()
        fcntl.fcntl(self._feed, fcntl.F_SETPIPE_SZ, _UNREAD_BYTES)
        os.set_blocking(self._feed, False)  # a sentinel that hangs must not hold up the driver

    def feed(self) -> bool:
        """Say that all is well; False where the sentinel is gone. Costs nothing if done often."""
        now = time.monotonic()
        if now - self._fed_s >= _FEED_S:
            self._fed_s = now
            return self._say(b'.')
        return True

    def dismiss(self) -> None:
        """Let it end without a word: every line that it holds is confirmed to be at zero."""
        self._say(b'q')
        self._end()

    def abandon(self) -> None:
        """Break off its feed, as no zero is confirmed: it zeroes all lines again and again for
        0.2 s, and ends. Returns at once; a sentinel that hangs is killed.
        """
        threading.Thread(target=self._end, daemon=True).start()

    def _end(self) -> None:
        self._pipe.close()
        try:
            self._process.wait(_LEAVE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _say(self, word: bytes) -> bool:
        try:
            return os.write(self._feed, word) == len(word)
        except OSError:
            return False
