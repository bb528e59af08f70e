"""Host side of the sentinel process that watches the driver."""

from __future__ import annotations

import fcntl
import os
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path

from microbot_ros.common.patience import PATIENCE
from microbot_ros.drive import sentinel

_SCRIPT = Path(sentinel.__file__)
_SILENCE_S = 0.1
"""Silence of the driver [s] after which the sentinel acts. Choice: that of devices with a
watchdog, 0.1 s."""
_FEED_S = 0.02
"""Interval of the heartbeats [s]. Choice: a fifth of the silence, so that four may be late."""
_UNREAD_BYTES = 4096
"""Heartbeats that a sentinel may leave unread before it counts as lost, 82 s of them: the size of
the smallest pipe that Linux makes."""


class LastResort:
    """A sentinel process that holds open lines.

    Parameters
    ----------
    words : sequence of tuple[int, bytes]
        Descriptor of each line and the bytes that zero its coils.
    """

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
        os.set_blocking(self._feed, False)  # a sentinel that hangs must not block the driver

    def feed(self) -> bool:
        """Send a heartbeat if one is due; frequent calls cost nothing.

        Returns
        -------
        bool
            False if the sentinel is lost.
        """
        now = time.monotonic()
        if now - self._fed_s >= _FEED_S:
            self._fed_s = now
            return self._say(b'.')
        return True

    def dismiss(self) -> None:
        """End the sentinel without a zero: every line that it holds is confirmed to be at zero."""
        self._say(b'q')
        self._forget()
        self._end()

    def abandon(self) -> None:
        """Stop the heartbeats, as no zero is confirmed; return at once.

        The sentinel zeroes all lines repeatedly for 0.2 s and ends. A sentinel that hangs is
        killed.
        """
        self._forget()
        threading.Thread(target=self._end, daemon=True).start()

    def _forget(self) -> None:
        self._feed = -1  # another file may get its number

    def _end(self) -> None:
        self._pipe.close()
        try:
            self._process.wait(PATIENCE.sentinel_s)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _say(self, word: bytes) -> bool:
        try:
            return os.write(self._feed, word) == len(word)
        except OSError:
            return False
