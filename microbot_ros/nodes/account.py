"""What a node took in for each answer, and in which order: `~/account`."""

from __future__ import annotations

import functools
import json
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from rclpy.publisher import Publisher
from std_msgs.msg import String

from microbot_ros.control.deadline_worker import DeadlineWorker, HungError, LateError
from microbot_ros.session.accounts import BUSY, CALLS, CHANGE, HUNG, IN_TIME, LATE

if TYPE_CHECKING:
    from microbot_ros.nodes.lifecycle import RigNode


_MOST = 200
"""So much is noted at most before it is published, without a frame where none comes."""


class Account:
    """Notes every message as a node takes it, and publishes the list after each answer.

    Another node hears the same messages at other times and in another order, so that a recording
    alone does not say what an answer was made from. `session.accounts` reads what is written
    here. Nothing is published while nobody listens.
    """

    taken_s: float
    """The node's time [s] when it took what it works on now: to judge ages by."""

    def __init__(self, node: RigNode) -> None:
        self._node = node
        self._publisher: Publisher | None = None
        self._turn = 0
        self._taken: list[list[Any]] = []
        self._verdicts = ''
        self.taken_s = 0.0

    def begin(self) -> None:
        """Start afresh, with a node that is configured."""
        if self._publisher is None:
            self._node.add_post_set_parameters_callback(self._changed)
        self._turn, self._taken, self._verdicts = 0, [], ''
        self._publisher = self._node.publisher(String, '~/account')

    def keeping(self, topic: str, callback: Callable[[Any], None]) -> Callable[[Any], None]:
        """The callback of a topic, with its messages noted; as it is for those without a header,
        which cannot be told apart: see `RigNode.noted`."""
        @functools.wraps(callback)
        def take(message: Any) -> None:
            if not hasattr(message, 'header'):
                callback(message)
                return
            stamp = message.header.stamp
            self._note(topic, stamp.sec * 1_000_000_000 + stamp.nanosec)
            try:
                callback(message)
            finally:
                self._judged()
                self._turn += topic == self._node.accounts_for
                if topic == self._node.accounts_for or len(self._taken) >= _MOST:
                    self._publish()
        return take

    def act(self, name: str) -> None:
        """Note that a timer, known by the name of its callback, does something."""
        self._note(name)

    def worker(self, patience: float) -> DeadlineWorker:
        """A worker of that `patience` [s] whose verdicts on lateness are noted."""
        return NotingWorker(patience, self.judge)

    def judge(self, verdict: str) -> None:
        """Note the `verdict` on a call of the work in hand."""
        self._verdicts += verdict

    def _changed(self, _: list[Any]) -> None:
        self._note(CHANGE, of_calls=True)
        self._judged()

    def _note(self, name: str, stamp_ns: int = 0, of_calls: bool = False) -> None:
        now = self._node.get_clock().now().nanoseconds
        self.taken_s = now * 1e-9
        if self._verdicts and not of_calls:
            self._taken.append([CALLS, 0, now])
            self._judged()
        self._taken.append([name, stamp_ns, now])

    def _judged(self) -> None:
        """Add to what was noted last how its calls came out, unless all were in time."""
        if self._verdicts.strip(IN_TIME) and self._taken:
            self._taken[-1].append(self._verdicts)
        self._verdicts = ''

    def _publish(self) -> None:
        assert self._publisher is not None
        if self._publisher.get_subscription_count():
            self._publisher.publish(String(data=json.dumps(
                {'turn': self._turn, 'taken': self._taken}, separators=(',', ':'))))
        self._taken = []


class NotingWorker(DeadlineWorker):
    """A worker of `patience` [s] that lets `tell` know how each call came out: one letter of
    `session.accounts`.
    """

    def __init__(self, patience: float, tell: Callable[[str], None]) -> None:
        super().__init__(patience)
        self._tell = tell

    def call(self, function: Callable[[], Any], deadline: float) -> Any:
        before = self._waited_for
        try:
            value = super().call(function, deadline)
        except HungError:
            self._tell(HUNG)
            raise
        except LateError:
            self._tell(BUSY if self._waited_for is before else LATE)
            raise
        except Exception:
            self._tell(IN_TIME)
            raise
        self._tell(IN_TIME)
        return value
