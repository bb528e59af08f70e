"""Node `player`: a session or recording on its topics, with `/clock`."""

from __future__ import annotations

import contextlib
import importlib
import math
import time
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from rclpy.duration import Duration
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Image
from std_srvs.srv import SetBool, Trigger

from microbot_ros.common.errors import InputError
from microbot_ros.common.extras import require
from microbot_ros.common.patience import PATIENCE
from microbot_ros.common.settings import setting
from microbot_ros.nodes.base.lifecycle import OK, RELIABLE, RigNode
from microbot_ros.nodes.base.messages import stamp_at
from microbot_ros.nodes.base.topics import CHANGES, KEPT
from microbot_ros.nodes.client.live_rig import LiveRig

if TYPE_CHECKING:
    from microbot_ros.session.mcap.recording import Message

_CLOCK_SECONDS = 0.01
"""Interval of `/clock` [s]. Choice: shorter than a frame of most cameras; half doubles the
messages."""
_SETTLED_SECONDS = 0.5
"""Time [s] without a new listener before anything is sent: a late listener misses the beginning.
Choice: half loses listeners that start slowly, twice delays every playback."""
_ACKNOWLEDGED_SECONDS = 3.5
"""Time [s] at the end for listeners to acknowledge everything: Fast DDS asks them every 3 s by
default."""
_LOOK_SECONDS, _FIRST_LOOKS_SECONDS = 1.0, 0.05
"""Interval [s] of checks for a live rig, while it plays and before. Choice: the first is the
longest time of playing into a rig, the second the delay of the beginning."""


@dataclass(frozen=True)
class PlayerParameters:
    """Parameters of the node `player`."""

    session: str = setting('', 'Folder or MCAP recording to play.', read_only=True)
    rate: float = setting(1.0, 'Speed relative to real time; 0: as fast as possible.', lower=0.0,
                          upper=100.0)
    start_s: float = setting(0.0, 'Start of the playback, from the start of the '
                                  'session.', lower=0.0,
                             upper=1e6, read_only=True)
    end_s: float = setting(0.0, 'End of the playback; 0 plays to the end.', lower=0.0, upper=1e6,
                           read_only=True)
    loop: bool = setting(False, 'Begin again at the end.', read_only=True)
    topics: list[str] = setting([], 'Topics to play; empty plays all.', read_only=True)
    seek_s: float = setting(0.0, 'Set it to jump to that time.', lower=0.0, upper=1e6)
    into_live_rig: bool = setting(
        False, 'Play even if nodes are live that do not follow `/clock`: they act on the recorded '
               'messages.', read_only=True)


class PlayerNode(RigNode):
    """Node that publishes the recorded bytes unchanged; `~/pause` and `~/step` control it."""

    Parameters: ClassVar[type] = PlayerParameters
    _unsent: deque[Message]
    """Messages that are due, and for which listeners had no room."""

    def veto(self, proposed: PlayerParameters) -> str:
        # Pace and position change here, so that an impossible change is refused.
        if not hasattr(self, '_playback'):
            return ''
        now, rate = time.monotonic(), proposed.rate or math.inf
        try:
            if proposed.seek_s != self.settings.seek_s:
                self._playback.seek(proposed.seek_s, now)
                self._unsent.clear()
            self._playback.set_rate(rate, now)
        except InputError as error:
            return str(error)
        return ''

    def setup(self) -> None:
        values: PlayerParameters = self.settings
        if not values.session:
            raise InputError(self.get_name(), 'expected a parameter session: what to play')
        self._open = contextlib.ExitStack()
        require('mcap')
        from microbot_ros.session.replay.playback import open_source

        self._source = self._open.enter_context(open_source(values.session))
        self._kinds = self._find_kinds(set(values.topics))
        self._outlets = PlaybackPublishers(self, self._kinds)
        self._rig = LiveRig(self, self._kinds)
        self._look_due = 0.0
        self._alone = values.into_live_rig
        self._sent = 0
        self.service(SetBool, '~/pause', self._on_pause)
        self.service(Trigger, '~/step', self._on_step)
        self.every(_CLOCK_SECONDS, self._play)

    def start(self) -> None:
        values: PlayerParameters = self.settings
        self._asked = self._found = time.monotonic()
        self._listeners = 0
        self._unsent = deque()
        self._begun = self._done = False
        from microbot_ros.session.replay.playback import Playback

        self._playback = Playback(
            self._source, self._asked, rate=values.rate or math.inf, start=values.start_s,
            end=values.end_s or None, loop=values.loop, topics=[*self._kinds])

    def teardown(self) -> None:
        if hasattr(self, '_open'):
            self._open.close()

    @property
    def finished(self) -> bool:
        """Whether everything was played, or playing was given up."""
        return self._done or bool(self.fault)

    def health(self) -> tuple[bytes, str, dict[str, object]]:
        state = ('finished' if self._playback.finished else
                 'paused' if self._playback.paused else
                 'playing' if self._begun else 'waiting for listeners of')
        return OK, f'{state} {self.settings.session}', {'messages_sent': self._sent}

    def _find_kinds(self, wanted: set[str]) -> dict[str, type]:
        """Return the topics to play and their types."""
        names = {f'/{topic.lstrip("/")}' for topic in wanted}
        unknown = names - set(self._source.topics)
        if unknown:
            there = ', '.join(sorted(self._source.topics))
            raise InputError(self.settings.session, f'no topic {sorted(unknown)[0]}; the '
                                                    f'recording has: {there}')
        return {name: _message_class(topic.type) for name, topic in self._source.topics.items()
                if name != CHANGES and (not names or name in names)}

    def _play(self) -> None:
        now = time.monotonic()
        if not self.settings.into_live_rig and now >= self._look_due:
            self._look(now)
        if self.finished:
            return
        self._done = self._playback.finished and not self._unsent and (
            now - self._asked > _ACKNOWLEDGED_SECONDS or self._outlets.has_all())
        if not self._begun:
            self._gather(now)
        else:
            self._send_due(now)

    def _look(self, now: float) -> None:
        """Give up if a rig is live, also if it becomes live meanwhile."""
        self._look_due = now + (_LOOK_SECONDS if self._begun else _FIRST_LOOKS_SECONDS)
        live, self._alone = self._rig.look()
        if live:
            self.fault = (f'{live} is live and would act on recorded messages: stop it, run '
                          'it with use_sim_time, or replay with --into-live-rig '
                          '(into_live_rig)')

    def _gather(self, now: float) -> None:
        """Begin when all listeners are present."""
        listeners = self._outlets.count
        if listeners != self._listeners:
            self._listeners, self._found = listeners, now
        incomplete = (self._outlets.missing() or not listeners
                      or now - self._found < _SETTLED_SECONDS)
        if not self._alone or (incomplete and now - self._asked < PATIENCE.listeners_s):
            return
        self._begun = True
        if not self._playback.paused:
            self._playback.resume(now)

    def _send_due(self, now: float) -> None:
        # A bounded slice, so that services are answered at any rate.
        while time.monotonic() - now <= 5 * _CLOCK_SECONDS:
            if not self._unsent and (message := self._playback.take(now)):
                self._unsent.append(message)
            if not self._send():
                break
        if not self._unsent:
            self._outlets.tell_time(self._playback.clock_ns(now))

    def _send(self) -> bool:
        """Publish what has waited longest; return False if that is nothing, or finds no room."""
        if not self._unsent:
            return False
        message = self._unsent[0]
        self._asked = time.monotonic()
        if not self._outlets.send(message.topic, bytes(message.data)):
            self.complain(f'waiting for a listener of {message.topic} that keeps all and is late')
            return False
        self._unsent.popleft()
        self._sent += 1
        return True

    def _on_pause(self, request: Any, response: Any) -> Any:
        now = time.monotonic()
        (self._playback.pause if request.data else self._playback.resume)(now)
        response.success, response.message = True, 'paused' if request.data else 'playing'
        return response

    def _on_step(self, _: Any, response: Any) -> Any:
        now = time.monotonic()
        sent = self._sent
        if not self._unsent:
            self._unsent.extend(self._playback.step(now))
        while self._send():
            pass
        count = self._sent - sent
        self._outlets.tell_time(self._playback.clock_ns(now))
        response.success, response.message = count > 0, f'{count} messages'
        return response


class PlaybackPublishers:
    """Publishers of topics by name, and of `/clock`.

    Parameters
    ----------
    node : RigNode
        The node.
    kinds : dict of str to type
        Type of the messages, by topic.
    """

    def __init__(self, node: RigNode, kinds: dict[str, type]) -> None:
        self._node = node
        self._clock = node.publisher(Clock, '/clock')
        # A listener that is slow on frames would cost a gigabyte in ten seconds.
        self._outlets = {name: node.publisher(kind, name, RELIABLE if kind is Image else KEPT)
                         for name, kind in kinds.items()}

    @property
    def count(self) -> int:
        """Number of listeners that a message sent now will reach."""
        return sum(outlet.get_subscription_count() for outlet in self._all.values())

    def missing(self) -> list[str]:
        """Return the topics that do not reach all their listeners yet.

        Returns
        -------
        list of str
            Names of the topics.
        """
        return [name for name, outlet in self._all.items()
                if outlet.get_subscription_count() < self._node.count_subscribers(name)]

    def send(self, topic: str, data: bytes) -> bool:
        """Publish serialised data.

        It waits 0.1 s for room, which is how long Fast DDS lets a publisher wait.

        Parameters
        ----------
        topic : str
            Name of the topic.
        data : bytes
            The serialised message.

        Returns
        -------
        bool
            False if a listener that keeps every message has no room for it yet.
        """
        try:
            self._outlets[topic].publish(data)
        except rclpy_implementation.RCLError:
            return False
        return True

    def tell_time(self, t_ns: int) -> None:
        """Publish the time on `/clock`.

        Parameters
        ----------
        t_ns : int
            Time [ns].
        """
        self._clock.publish(Clock(clock=stamp_at(t_ns)))

    def has_all(self) -> bool:
        """Return whether every reliable listener has received everything.

        Returns
        -------
        bool
            Whether all messages are acknowledged.
        """
        return all(outlet.wait_for_all_acked(Duration()) for outlet in self._outlets.values())

    @property
    def _all(self) -> dict[str, Publisher]:
        return {'/clock': self._clock, **self._outlets}


def _message_class(type_name: str) -> type:
    """Return the class of a type such as `sensor_msgs/msg/Image`.

    InputError if it is not installed.
    """
    package, _, name = type_name.split('/')
    try:
        found: type = getattr(importlib.import_module(f'{package}.msg'), name)
    except (ImportError, AttributeError):
        raise InputError(type_name, 'expected an installed message type') from None
    return found
