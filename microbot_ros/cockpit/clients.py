"""A page on the other end of a socket: it is sent what is newest, never a queue of old things."""

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
"""Pictures that a page may have without having said that it has seen them."""
_SIGN_OF_LIFE_S = 1.0
"""How often a page that owes is told the state all the same."""
_ANSWERS = 100
"""A page that reads none of so many answers is gone."""
_SLOW_S = 5.0
"""So is one that does not take a message within this: the buffers between hold some seconds."""


class Page:
    """One page on its `socket`; `number` is its name.

    A picture, and what is seen in it, waits in one place, in which the next replaces it, until
    the page has said `seen` to all but one of those it was sent.
    """

    def __init__(self, socket: WebSocket, number: int) -> None:
        self.number = number
        self.in_work = 0
        """Verbs that are being performed."""
        self.stops = 0
        """STOPs whose answer it waits for."""
        self.heard_s = time.monotonic()
        """When it last sent something."""
        self.steering = Steering()
        self._socket = socket
        self._owed: deque[int] = deque()
        self._picture: tuple[int, bytes] | None = None
        self._particles: str | None = None
        self.events = 0
        """The number of the last event that it was sent."""
        self._state: str | None = None
        self._known: dict[str, str] = {}
        self._told_s = 0.0
        self._answers: deque[str] = deque()
        self._news = asyncio.Event()
        self._ended = False

    def picture(self, stamp: int, jpeg: bytes) -> None:
        """Have a picture of a `stamp` [ns], a `jpeg`, sent in place of one that waits."""
        self._picture = stamp, jpeg
        self._particles = None
        self._news.set()

    def particles(self, text: str) -> None:
        """Have particles, a message as `text`, sent in place of some that wait."""
        self._particles = text
        self._news.set()

    def state(self, parts: Mapping[str, str], now_s: float) -> None:
        """Have the `parts` of the state, each as JSON, sent as far as they are new to the page at
        `now_s` [s]."""
        if len(self._owed) >= _OWED and now_s - self._told_s < _SIGN_OF_LIFE_S:
            return
        if self._state is not None:
            return  # the socket is full: what is new now will still be new later
        new = {name: part for name, part in parts.items() if self._known.get(name) != part}
        self._known |= new
        self._told_s = now_s
        self._state = ','.join(
            ['{"kind":"state"', *(f'"{name}":{part}' for name, part in new.items())]) + '}'
        self._news.set()

    def tell(self, message: dict[str, Any]) -> None:
        """Have a `message` sent that must not be lost: an answer, a greeting."""
        self._answers.append(json.dumps(message, ensure_ascii=False, allow_nan=False))
        self._news.set()

    def seen(self, stamp: int) -> None:
        """The page has the picture of a `stamp` [ns], and those before it, behind it."""
        if stamp in self._owed:
            while self._owed.popleft() != stamp:
                pass
            self._news.set()

    def end(self) -> None:
        """Let it go: another takes its place."""
        self._ended = True
        self._news.set()

    async def send(self) -> None:
        """Send what is newest, as soon as the page can take it, until it is gone."""
        try:
            while len(self._answers) <= _ANSWERS and not self._ended:
                await self._news.wait()
                self._news.clear()
                async with asyncio.timeout(_SLOW_S):
                    while self._answers:
                        await self._socket.send_text(self._answers.popleft())
                    await self._send_newest()
        except (WebSocketDisconnect, RuntimeError, TimeoutError):
            pass  # it has gone; who receives from it notices too

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
