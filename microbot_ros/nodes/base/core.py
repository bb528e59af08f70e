"""Part of a node that needs no graph: its answers to its inputs."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import Any, ClassVar

from builtin_interfaces.msg import Time
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile

from microbot_ros.nodes.base.messages import stamp_at

RELIABLE = QoSProfile(depth=200)  # choice: deep enough for a replay at many times real time


class Core:
    """Base of the code that runs live in a node (`RigNode`) and from a recording in a replay.

    `connect` makes the stage, its publishers and its subscriptions, through the methods of the
    host. The same messages in the same order, at the same times `now_ns`, give the same answers.
    """

    Parameters: ClassVar[type]
    frame: ClassVar[str] = ''
    """Topic that the core answers; the inputs of a node with such a topic are written to
    `loop/log`."""
    unrepeatable: str = ''
    """Why the same inputs need not give the same answers; '' if they do."""
    now_ns: int = 0
    """Time [ns] of the node's clock when it received the present message; 0 before the first."""

    @property
    def now_s(self) -> float:
        """`now_ns` in seconds."""
        return self.now_ns * 1e-9

    def now_stamp(self) -> Time:
        """Return `now_ns` as a message.

        Returns
        -------
        Time
            Stamp.
        """
        return stamp_at(self.now_ns)

    def connect(self) -> None:
        """Make the stage, the publishers and the subscriptions."""

    def take(self, changed: Mapping[str, Any], named: Collection[str]) -> str:
        """Hand changed parameters to the code that uses them: all of them, or none.

        Parameters
        ----------
        changed : mapping of str to object
            New values of each parameter set by its prefix, '' for `Parameters`.
        named : collection of str
            Names of the parameters that were set, whether their values changed or not.

        Returns
        -------
        str
            Why the change is refused; '' if it is not.
        """
        return ''

    # Of the host ----------------------------------------------------------------------------

    @property
    def settings(self) -> Any:
        """Present parameters, an immutable instance of `Parameters`."""
        raise NotImplementedError

    def publisher(self, kind: type, topic: str, qos: QoSProfile = RELIABLE) -> Publisher:
        """Make a publisher.

        Parameters
        ----------
        kind : type
            Type of the messages.
        topic : str
            Name of the topic.
        qos : QoSProfile
            Quality of service.

        Returns
        -------
        Publisher
            The publisher.
        """
        raise NotImplementedError

    def subscribe(self, kind: type, topic: str, callback: Callable[[Any], None],
                  qos: QoSProfile = RELIABLE, raw: bool = False,
                  on_matched: Callable[[Any], None] | None = None) -> None:
        """Subscribe to a topic.

        Parameters
        ----------
        kind : type
            Type of the messages.
        topic : str
            Name of the topic.
        callback : callable
            Function that is called with each message.
        qos : QoSProfile
            Quality of service.
        raw : bool
            Whether messages are passed on as bytes.
        on_matched : callable or None
            Function that is called when a publisher comes or goes.
        """
        raise NotImplementedError

    def complain(self, sentence: str) -> None:
        """Report a problem with an input.

        Parameters
        ----------
        sentence : str
            Text for people.
        """

    def act(self, name: str) -> None:
        """Record that a timer acts now.

        Parameters
        ----------
        name : str
            Name of the timer.
        """
