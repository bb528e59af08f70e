"""The part of a node that needs no graph: what it answers to what it takes in."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import Any, ClassVar

from builtin_interfaces.msg import Time
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile

from microbot_ros.nodes.base.messages import stamp_at

# Small messages: deep enough for a replay at many times real time.
RELIABLE = QoSProfile(depth=200)


class Core:
    """Base of what runs live in a node (`RigNode`) and from a recording in a replay.

    `connect` makes the stage, its publishers and its subscriptions, through the methods of the
    host. The same messages in the same order, at the same times `now_ns`, give the same answers.
    """

    Parameters: ClassVar[type]
    frame: ClassVar[str] = ''
    """Topic that the core answers; what a node with one takes in is written to `loop/log`."""
    unrepeatable: str = ''
    """Why the same inputs need not give the same answers; '' where they do."""
    now_ns: int = 0
    """Time [ns] of the node's clock when it took the message that it works on."""

    @property
    def now_s(self) -> float:
        """`now_ns` in seconds."""
        return self.now_ns * 1e-9

    def now_stamp(self) -> Time:
        """Return `now_ns` as a message."""
        return stamp_at(self.now_ns)

    def connect(self) -> None:
        """Make the stage, the publishers and the subscriptions."""

    def take(self, changed: Mapping[str, Any], named: Collection[str]) -> str:
        """Hand changed parameters to what runs with them: all of them, or none and the reason.

        Parameters
        ----------
        changed
            New values of each parameter set by its prefix, '' for `Parameters`.
        named
            Names of the parameters that were set, whether their values changed or not.
        """
        return ''

    # Of the host ----------------------------------------------------------------------------

    @property
    def settings(self) -> Any:
        """Present parameters, an immutable instance of `Parameters`."""
        raise NotImplementedError

    def publisher(self, kind: type, topic: str, qos: QoSProfile = RELIABLE) -> Publisher:
        """Return a publisher of messages of a `kind` on a `topic`, by `qos`."""
        raise NotImplementedError

    def subscribe(self, kind: type, topic: str, callback: Callable[[Any], None],
                  qos: QoSProfile = RELIABLE, raw: bool = False,
                  on_matched: Callable[[Any], None] | None = None) -> None:
        """Call `callback` with each message of a `kind` on a `topic`, `raw` as bytes, by `qos`.

        `on_matched` is called when a publisher comes or goes.
        """
        raise NotImplementedError

    def complain(self, sentence: str) -> None:
        """Report a problem with an input, in one `sentence`."""

    def act(self, name: str) -> None:
        """Note that a timer of this `name` acts now."""
