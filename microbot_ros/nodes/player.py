"""Node `player`: a session or recording through topics, with `/clock`."""

from __future__ import annotations

import contextlib
import importlib
import math
import time
from dataclasses import dataclass
from typing import Any, ClassVar

from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool, Trigger

from microbot_ros.errors import InputError
from microbot_ros.nodes import messages
from microbot_ros.nodes.lifecycle import OK, RigNode
from microbot_ros.session.playback import Playback, open_source
from microbot_ros.settings import setting

_CLOCK_SECONDS = 0.01


@dataclass(frozen=True)
class PlayerParameters:
    """Parameters of the node `player`."""

    session: str = setting('', 'Folder or MCAP recording to play.', read_only=True)
    rate: float = setting(1.0, 'Times real time; 0 is as fast as it goes.', lower=0.0,
                          upper=100.0)
    start_s: float = setting(0.0, 'Where to begin, since the start of the session.', lower=0.0,
                             upper=1e6, read_only=True)
    end_s: float = setting(0.0, 'Where to end; 0 plays to the end.', lower=0.0, upper=1e6,
                           read_only=True)
    loop: bool = setting(False, 'Begin again at the end.', read_only=True)
    topics: list[str] = setting([], 'What to play; empty plays all there is.', read_only=True)
    seek_s: float = setting(0.0, 'Set it to go to that time.', lower=0.0, upper=1e6)


class PlayerNode(RigNode):
    """Publishes the recorded bytes as they are; `~/pause` and `~/step` hold and advance it."""

    Parameters: ClassVar[type] = PlayerParameters

    def setup(self) -> None:
        values: PlayerParameters = self.settings
        if not values.session:
            raise InputError(self.get_name(), 'expected a parameter session: what to play')
        self._open = contextlib.ExitStack()
        self._source = self._open.enter_context(open_source(values.session))
        self._outlets = self._make_publishers(set(values.topics))
        self._time = self.publisher(Clock, '/clock')
        self._applied = values
        self._sent = 0
        self.service(SetBool, '~/pause', self._on_pause)
        self.service(Trigger, '~/step', self._on_step)
        self.every(_CLOCK_SECONDS, self._play)

    def start(self) -> None:
        values: PlayerParameters = self.settings
        self._playback = Playback(
            self._source, time.monotonic(), rate=values.rate or math.inf, start=values.start_s,
            end=values.end_s or None, loop=values.loop, topics=list(self._outlets))

    def teardown(self) -> None:
        if hasattr(self, '_open'):
            self._open.close()

    @property
    def finished(self) -> bool:
        """Whether all has been played."""
        return self.active and self._playback.finished

    def health(self) -> tuple[bytes, str, dict[str, object]]:
        state = ('finished' if self._playback.finished else
                 'paused' if self._playback.paused else 'playing')
        return OK, f'{state} {self.settings.session}', {'messages_sent': self._sent}

    def _make_publishers(self, wanted: set[str]) -> dict[str, Publisher]:
        names = {f'/{topic.lstrip("/")}' for topic in wanted}
        unknown = names - set(self._source.topics)
        if unknown:
            there = ', '.join(sorted(self._source.topics))
            raise InputError(self.settings.session, f'no topic {sorted(unknown)[0]}; has {there}')
        return {
            name: self.publisher(_message_class(topic.type), name)
            for name, topic in self._source.topics.items() if not names or name in names}

    def _play(self) -> None:
        now = time.monotonic()
        self._follow_parameters(now)
        while (message := self._playback.take(now)) is not None:
            self._send(message)
            # A bounded slice, so that services are answered at any rate.
            if time.monotonic() - now > 5 * _CLOCK_SECONDS:
                break
        self._tell_time(now)

    def _follow_parameters(self, now: float) -> None:
        values, before = self.settings, self._applied
        if values is before:
            return
        self._applied = values
        if values.rate != before.rate:
            self._playback.set_rate(values.rate or math.inf, now)
        if values.seek_s != before.seek_s:
            self._playback.seek(values.seek_s, now)

    def _send(self, message: Any) -> None:
        self._outlets[message.topic].publish(bytes(message.data))
        self._sent += 1

    def _tell_time(self, now: float) -> None:
        stamp = messages.to_stamp(self._playback.clock_ns(now) * 1e-9)
        self._time.publish(Clock(clock=stamp))

    def _on_pause(self, request: Any, response: Any) -> Any:
        now = time.monotonic()
        (self._playback.pause if request.data else self._playback.resume)(now)
        response.success, response.message = True, 'paused' if request.data else 'playing'
        return response

    def _on_step(self, _: Any, response: Any) -> Any:
        now = time.monotonic()
        count = 0
        for message in self._playback.step(now):
            self._send(message)
            count += 1
        self._tell_time(now)
        response.success, response.message = count > 0, f'{count} messages'
        return response


def _message_class(type_name: str) -> type:
    """`sensor_msgs/msg/Image` as a class; InputError where this machine has no such type."""
    package, _, name = type_name.split('/')
    try:
        found: type = getattr(importlib.import_module(f'{package}.msg'), name)
    except (ImportError, AttributeError):
        raise InputError(type_name, 'expected a message type that is installed here') from None
    return found
