"""STOP: outside every limit of the server, with its own rate."""

from __future__ import annotations

import asyncio
import time

from microbot_ros.cockpit.rig import Answer, Rig

EVERY_S = 0.1
"""Shortest interval [s] between two requests to the driver. Choice: the first is sent at once;
those that come sooner after it share the next, so that a page that floods the server delays no
other by more."""


class Stopping:
    """Sender of STOPs to a rig: none is dropped, and none waits for an answer to another.

    Parameters
    ----------
    rig : Rig
        The rig.
    """

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self._next: asyncio.Task[Answer] | None = None
        self._sent_s = -EVERY_S

    def want(self) -> asyncio.Task[Answer]:
        """Send a request, at once or together with others.

        Returns
        -------
        Task of str
            Its answer.
        """
        if self._next is None:
            self._next = asyncio.create_task(self._send())
            self._next.add_done_callback(_heard)
        return self._next

    async def _send(self) -> Answer:
        wait_s = self._sent_s + EVERY_S - time.monotonic()
        if wait_s > 0:
            await asyncio.sleep(wait_s)
        self._sent_s, self._next = time.monotonic(), None
        return await self._rig.stop()


def _heard(task: asyncio.Task[Answer]) -> None:
    """Retrieve the exception of a request for which no page waits any more."""
    if not task.cancelled():
        task.exception()
