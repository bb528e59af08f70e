"""A page at the other end of a socket, which is sent only the newest of everything."""

from __future__ import annotations

import asyncio
import json
import struct
import time
from collections import deque
from collections.abc import Mapping
from typing import Any

from starlette.websockets import WebSocket, WebSocketDisconnect

from microbot_ros.cockpit.steering import Steering

_OWED = 2
"""Largest number of pictures that a page has not acknowledged. Choice: one on its way and one
being drawn; more would delay the picture of a slow page."""
_SIGN_OF_LIFE_S = 1.0
"""Interval [s] at which a page that does not acknowledge still receives the state. Choice: half
loads a link that is full already, twice delays what a person sees."""
_ANSWERS = 100
"""Number of unread answers after which a page counts as lost. Choice: far more than a page has
requests in work."""
_SLOW_S = 5.0
"""Time [s] after which a page that does not accept a message counts as lost. Choice: the buffers
between hold some seconds."""


class Page:
    """One page.

    A picture and the particles in it wait in one place, in which the next replaces them, until the
    page has acknowledged all but one of the pictures that it was sent.

    Parameters
    ----------
    socket : WebSocket
        Its socket.
    number : int
        Its number.
    """

    def __init__(self, socket: WebSocket, number: int) -> None:
        self.number = number
        self.in_work = 0
        """Number of verbs that are being performed."""
        self.stops = 0
        """Number of STOPs whose answer it waits for."""
        self.heard_s = time.monotonic()
        """Time [s] of its last message."""
        self.steering = Steering()
        self._socket = socket
        self._owed: deque[int] = deque()
        self._picture: tuple[int, bytes] | None = None
        self._particles: str | None = None
        self.events = 0
        """Number of the last event that it was sent."""
        self._state: str | None = None
        self._known: dict[str, str] = {}
        self._told_s = 0.0
        self._answers: deque[str] = deque()
        self._news = asyncio.Event()
        self._ended = False

    def picture(self, stamp: int, jpeg: bytes) -> None:
        """Send a picture in place of one that waits.

        Parameters
        ----------
        stamp : int
            Stamp of the picture [ns].
        jpeg : bytes
            The picture.
        """
        self._picture = stamp, jpeg
        self._particles = None
        self._news.set()

    def particles(self, text: str) -> None:
        """Send particles in place of some that wait.

        Parameters
        ----------
        text : str
            The message.
        """
        self._particles = text
        self._news.set()

    def state(self, parts: Mapping[str, str], now_s: float) -> None:
        """Send the parts of the state that are new to the page.

        Parameters
        ----------
        parts : mapping of str to str
            Parts by name, each as JSON.
        now_s : float
            Present time [s] of the monotonic clock.
        """
        if len(self._owed) >= _OWED and now_s - self._told_s < _SIGN_OF_LIFE_S:
            return
        if self._state is not None:
            return  # the socket is full; the changes are sent later
        new = {name: part for name, part in parts.items() if self._known.get(name) != part}
        self._known |= new
        self._told_s = now_s
        self._state = ','.join(
            ['{"kind":"state"', *(f'"{name}":{part}' for name, part in new.items())]) + '}'
        self._news.set()

    def tell(self, message: dict[str, Any]) -> None:
        """Send a message that must not be lost, such as an answer or a greeting.

        Parameters
        ----------
        message : dict of str to object
            The message.
        """
        self._answers.append(json.dumps(message, ensure_ascii=False, allow_nan=False))
        self._news.set()

    def seen(self, stamp: int) -> None:
        """Register that the page has drawn or skipped a picture and all before it.

        Parameters
        ----------
        stamp : int
            Stamp of the picture [ns].
        """
        if stamp in self._owed:
            while self._owed.popleft() != stamp:
                pass
            self._news.set()

    def end(self) -> None:
        """End the connection: another page takes its place."""
        self._ended = True
        self._news.set()

    async def send(self) -> None:
        """Send the newest messages as soon as the page can accept them, until it is lost."""
        try:
            while len(self._answers) <= _ANSWERS and not self._ended:
                await self._news.wait()
                self._news.clear()
                async with asyncio.timeout(_SLOW_S):
                    while self._answers:
                        await self._socket.send_text(self._answers.popleft())
                    await self._send_newest()
        except (WebSocketDisconnect, RuntimeError, TimeoutError):
            pass  # it is gone; its receiver ends too

    async def _send_newest(self) -> None:
        if self._picture is not None and len(self._owed) < _OWED:
            (stamp, jpeg), self._picture = self._picture, None
            self._owed.append(stamp)
            await self._socket.send_bytes(struct.pack('>Q', stamp) + jpeg)
        if self._particles is not None and self._picture is None:
            text, self._particles = self._particles, None
            await self._socket.send_text(text)
        if self._state is not None:
            text, self._state = self._state, None
            await self._socket.send_text(text)
