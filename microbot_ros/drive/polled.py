"""Base of drivers for devices that answer only when asked."""

from __future__ import annotations

import threading
import time
from abc import abstractmethod
from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np

from microbot_ros.drive.amplifier import Amplifier
from microbot_ros.drive.errors import NoAnswerError
from microbot_ros.drive.transport import Port
from microbot_ros.errors import InputError

Reply = TypeVar('Reply')

_ATTEMPTS = 2
"""All requests set or ask for absolute values, so a damaged exchange may simply be repeated."""
_INSPECT_S = 0.5
"""How often to ask what is wrong with the device: heat takes seconds, and lines are slow."""


class PolledAmplifier(Amplifier):
    """Asks for the currents after each command and at least every `period_s`."""

    ports = 1
    """How many serial lines it takes."""
    baud = 115_200
    xon_xoff = False
    period_s = 0.02
    reply_s = 0.03
    """How long a device may take to answer: twice what a USB adapter holds bytes back at most."""

    def __init__(self, url: str, full_scale_A: float | Sequence[float]) -> None:
        super().__init__(url, full_scale_A)
        self._urls = url.split(',')
        if len(self._urls) != self.ports:
            raise InputError(url, f'expected {self.ports} serial ports, separated by commas')
        self._lines: list[Port] = []
        self._exchange = threading.RLock()
        self._written = threading.Event()
        self._due_s = self._inspection_s = 0.0

    @abstractmethod
    def _identify(self) -> None:
        """Make sure of the device, arm its watchdog and enable its outputs at zero."""

    @abstractmethod
    def _drive(self, currents_A: np.ndarray) -> None:
        """Send the currents."""

    @abstractmethod
    def _measure(self) -> np.ndarray:
        """Ask for the currents."""

    def _inspect(self) -> str:
        """What the device says is wrong with it; '' where nothing is, or where it cannot tell."""
        return ''

    def _open(self) -> None:
        self._inspection_s = 0.0
        for url in self._urls:
            self._lines.append(Port(url, self.baud, xon_xoff=self.xon_xoff))
        self._identify()

    def _send(self, currents_A: np.ndarray) -> None:
        with self._exchange:
            self._require_lines()
            self._drive(currents_A)
        self.counters.frames_sent += 1
        self._written.set()

    def _receive(self, timeout_s: float) -> list[tuple[float, np.ndarray]]:
        self._require_lines()
        wait_s = self._due_s - time.monotonic()
        if wait_s > 0 and not self._written.wait(min(wait_s, timeout_s)) and wait_s > timeout_s:
            return []
        self._written.clear()
        self._due_s = time.monotonic() + self.period_s
        with self._exchange:
            currents = self._measure()
        measured_s = time.monotonic()
        if measured_s >= self._inspection_s:
            with self._exchange:
                self.fault = self._inspect()
            self._inspection_s = measured_s + _INSPECT_S
        self.counters.frames_received += 1
        return [(measured_s, currents)]

    def _release(self) -> None:
        with self._exchange:
            while self._lines:
                self._lines.pop().close()

    def _require_lines(self) -> None:
        if not self._lines:
            raise NoAnswerError(self.url, 'a connection')

    def _ask(self, requests: Sequence[bytes], parse: Callable[[bytes], Reply | None],
             expected: str) -> list[Reply]:
        """What `parse` makes of the answers to one request on each line, asked side by side.

        `parse` gives None as long as an answer is incomplete. Raises NoAnswerError where nothing
        usable comes back from repeated attempts.
        """
        replies: dict[int, Reply] = {}
        for _ in range(_ATTEMPTS):
            open_lines = [line for line in range(self.ports) if line not in replies]
            for line in open_lines:
                self._lines[line].discard_input()
                self._lines[line].send(requests[line])
            for line in open_lines:
                reply = self._answer(self._lines[line], parse)
                if reply is not None:
                    replies[line] = reply
            if len(replies) == self.ports:
                return [replies[line] for line in range(self.ports)]
        missing = next(line for line in range(self.ports) if line not in replies)
        raise NoAnswerError(self._lines[missing].url, expected)

    def _answer(self, port: Port, parse: Callable[[bytes], Reply | None]) -> Reply | None:
        answer, deadline = b'', time.monotonic() + self.reply_s
        while (left := deadline - time.monotonic()) > 0:
            answer += port.receive(left)
            if (reply := parse(answer)) is not None:
                return reply
        self.counters.crc_errors += bool(answer)
        self.counters.discarded_bytes += len(answer)
        return None
