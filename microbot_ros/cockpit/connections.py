"""Connections of the server before they are pages: few, short, and none excludes others."""

from __future__ import annotations

import asyncio
import itertools
from typing import Any

from uvicorn.protocols.http.h11_impl import H11Protocol

from microbot_ros.common.patience import PATIENCE

MOST = 64
"""Largest number of HTTP connections. Choice: a browser opens six for a page; 16 pages that load
at once need 96 for some 100 ms, and those over the limit are opened again by the browser."""

_order = itertools.count()


class BriefConnection(H11Protocol):
    """HTTP connection that is closed after `Patience.connection_s`, whatever its client sends.

    If there are more than `MOST`, the oldest is closed in favour of the newest: clients that hold
    connections without requests cannot exclude a page, and its STOP. A connection that became a
    socket of a page does not count.
    """

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Register a new connection.

        Parameters
        ----------
        transport : asyncio.Transport
            Its transport.
        """
        super().connection_made(transport)
        self.number = next(_order)
        self._end = self.loop.call_later(PATIENCE.connection_s, self._expire)
        brief = [one for one in self.connections
                 if isinstance(one, BriefConnection) and not one.transport.is_closing()]
        if len(brief) > MOST:
            min(brief, key=lambda one: one.number)._abort()

    def connection_lost(self, exc: Exception | None) -> None:
        """Release a connection that has ended.

        Parameters
        ----------
        exc : Exception or None
            Error that ended it, or None.
        """
        self._end.cancel()
        super().connection_lost(exc)

    def handle_websocket_upgrade(self, event: Any) -> None:
        """Hand the connection over to a socket with its own limits.

        Parameters
        ----------
        event : object
            Request of the connection.
        """
        self._end.cancel()
        super().handle_websocket_upgrade(event)

    def _expire(self) -> None:
        if self.cycle and self.cycle.response_started and not self.cycle.response_complete:
            self._end = self.loop.call_later(PATIENCE.connection_s, self._expire)
        else:
            self._abort()

    def _abort(self) -> None:
        self.transport.abort()
