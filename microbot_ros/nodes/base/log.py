"""Log of the inputs of a node, in order, on `loop/log`."""

from __future__ import annotations

import functools
import json
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from rclpy.publisher import Publisher
from std_msgs.msg import String

from microbot_ros.control.deadline_worker import DeadlineWorker
from microbot_ros.control.recorded_worker import IN_TIME, NotingWorker
from microbot_ros.nodes.base.messages import to_nanoseconds
from microbot_ros.session.replay.log import PARAMETERS

if TYPE_CHECKING:
    from microbot_ros.nodes.base.lifecycle import RigNode

_MOST = 200
"""Entries after which a line is written without a frame, so that no line grows without bound while
no frame arrives. Choice: at half or twice that, lines are shorter or longer; nothing is lost."""


class Log:
    """Lines of one node in the log of the loop, one for each frame that it receives.

    A recorder receives the same messages at other times and in another order, so that a recording
    of topics alone does not determine the inputs of an answer. `session.replay.log` describes the
    format. Nothing is published while there is no listener.

    Parameters
    ----------
    node : RigNode
        The node.
    """

    def __init__(self, node: RigNode) -> None:
        self._node = node
        self._publisher: Publisher | None = None
        self._turn = 0
        self._taken: list[list[Any]] = []
        self._calls = ''

    def begin(self) -> None:
        """Start anew, with a node that is being configured."""
        self._turn, self._taken, self._calls = 0, [], ''
        self._publisher = self._node.publisher(String, 'loop/log')

    def keeping(self, topic: str, callback: Callable[[Any], None]) -> Callable[[Any], None]:
        """Return a callback that also records its messages.

        Parameters
        ----------
        topic : str
            Name of the topic.
        callback : callable
            Function that is called with each message.

        Returns
        -------
        callable
            The callback.
        """
        @functools.wraps(callback)
        def take(message: Any) -> None:
            if hasattr(message, 'header'):
                self.note(topic, to_nanoseconds(message.header.stamp))
            else:
                self.note(topic, message.data)
            try:
                callback(message)
            finally:
                self.close(topic == self._node.frame)
        return take

    def note(self, name: str, what: Any) -> None:
        """Record an input of the node, received now.

        Parameters
        ----------
        name : str
            Name of the input.
        what : object
            Its stamp [ns] or its content.
        """
        self._node.now_ns = self._node.get_clock().now().nanoseconds
        self._taken.append([name, what, self._node.now_ns])

    def take(self, values: dict[str, Any], take: Callable[[], str]) -> str:
        """Record parameters that are being set, and return the result.

        A refusal is recorded, without the values, only if controllers were called for it.

        Parameters
        ----------
        values : dict of str to object
            New values by name.
        take : callable
            Function that sets them and returns why they are refused, '' if they are not.

        Returns
        -------
        str
            Result of `take`.
        """
        self.note(PARAMETERS, values)
        entry = self._taken[-1]
        refusal = take()
        if refusal:
            entry[1] = None
        if refusal and not self._calls:
            self._taken.remove(entry)
        self.close()
        return refusal

    def worker(self, patience: float) -> DeadlineWorker:
        """Return a worker that records whether calls finished in time.

        Parameters
        ----------
        patience : float
            Patience of the worker [s].

        Returns
        -------
        DeadlineWorker
            The worker.
        """
        def called(letter: str) -> None:
            self._calls += letter
        return NotingWorker(patience, called)

    def close(self, frame: bool = False) -> None:
        """Complete the last entry; write the line if the entry was a frame.

        Parameters
        ----------
        frame : bool
            Whether it was.
        """
        if self._calls.strip(IN_TIME) and self._taken:
            self._taken[-1].append(self._calls)
        self._calls = ''
        self._turn += frame
        if frame or len(self._taken) >= _MOST:
            self._publish()

    def _publish(self) -> None:
        taken, self._taken = self._taken, []
        if self._publisher is not None and self._publisher.get_subscription_count():
            self._publisher.publish(String(data=json.dumps(
                {'node': self._node.get_name(), 'turn': self._turn, 'taken': taken},
                separators=(',', ':'))))
