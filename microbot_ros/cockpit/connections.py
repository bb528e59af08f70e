"""Connections of the server before they are pages: few, short, and none that locks others out."""

from __future__ import annotations

import asyncio
import itertools
from typing import Any

from uvicorn.protocols.http.h11_impl import H11Protocol

MOST = 64
"""HTTP connections at once. A browser opens six for a page; 16 pages that load at once need 96 for
some 100 ms, and those over the limit are opened again by the browser."""
LONGEST_S = 30.0
"""Longest life of an HTTP connection that is not in the middle of an answer: a page loads in less
than 1 s, a recording in minutes."""

_order = itertools.count()


class BriefConnection(H11Protocol):
    """HTTP connection that is closed after `LONGEST_S`, whatever its client sends.

    Where there are more than `MOST`, the oldest is closed in favour of the newest: clients that
    hold connections without asking for anything cannot keep a page, and its STOP, out. A
    connection that became a socket of a page is none of these.
    """

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Take in a new connection by its `transport`."""
        super().connection_made(transport)
        self.number = next(_order)
        self._end = self.loop.call_later(LONGEST_S, self._expire)
        brief = [one for one in self.connections
                 if isinstance(one, BriefConnection) and not one.transport.is_closing()]
        if len(brief) > MOST:
            min(brief, key=lambda one: one.number)._abort()

    def connection_lost(self, exc: Exception | None) -> None:
        """Let go of a connection that has ended, by an error `exc` or None."""
        self._end.cancel()
        super().connection_lost(exc)

    def handle_websocket_upgrade(self, event: Any) -> None:
        """Hand the connection over, by its request `event`, to a socket with limits of its own.
        """
        self._end.cancel()
        super().handle_websocket_upgrade(event)

    def _expire(self) -> None:
        if self.cycle and self.cycle.response_started and not self.cycle.response_complete:
            self._end = self.loop.call_later(LONGEST_S, self._expire)
        else:
            self._abort()

    def _abort(self) -> None:
        self.transport.abort()
