"""Node `player`: a session or recording through topics, with `/clock`."""

from __future__ import annotations

import contextlib
import importlib
import itertools
import math
import time
from dataclasses import dataclass
from typing import Any, ClassVar

from lifecycle_msgs.srv import GetState
from rcl_interfaces.msg import ParameterEvent
from rcl_interfaces.srv import SetParameters
from rclpy.client import Client
from rclpy.serialization import deserialize_message
from std_srvs.srv import SetBool, Trigger

from microbot_ros.common.errors import InputError
from microbot_ros.common.settings import setting
from microbot_ros.nodes.lifecycle import OK, RigNode
from microbot_ros.nodes.live_rig import LiveRig
from microbot_ros.nodes.playback_publishers import PlaybackPublishers
from microbot_ros.nodes.topics import CHANGES, TOPICS
from microbot_ros.session.lockstep import LockStep, frame_topic, header_stamp_ns
from microbot_ros.session.playback import Playback, open_source
from microbot_ros.session.recording import Message, is_topic
from microbot_ros.session.replay_order import ReplayOrder

_CLOCK_SECONDS = 0.01
_SETTLED_SECONDS = 0.5
"""Nothing is sent until no listener has been found for so long: who comes late misses the
beginning."""
_NOBODY_SECONDS = 3.5
"""After this it is played to nobody. Fast DDS makes itself known every 3 s, unless told otherwise,
and what it says first of all gets lost at times."""
_ACKNOWLEDGED_SECONDS = 3.5
"""At the end, how long listeners may take to confirm that they have it all: Fast DDS asks them
every 3 s."""
_LOOK_SECONDS, _FIRST_LOOKS_SECONDS = 1.0, 0.05
"""How often to look whether a rig is live, while it plays and before."""
_TURN_SECONDS = 0.1
"""After this a node that has not answered is asked whether it has nothing to say."""


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
    into_live_rig: bool = setting(
        False, 'Play even where nodes are live that do not follow `/clock`: they act on what is '
        'played.', read_only=True)
    answers: list[str] = setting(
        [], 'Lock-step: topics on which a frame must be answered, with its stamp, before the next '
        'is sent, in the order of the nodes. Empty plays by time alone.', read_only=True)
    patience_s: float = setting(
        20.0, 'Lock-step: how long an answer may take before the replay is given up.',
        lower=0.1, upper=3600.0, read_only=True)


class PlayerNode(RigNode):
    """Publishes the recorded bytes as they are; `~/pause` and `~/step` hold and advance it.

    In lock-step the clock stands while a frame is worked on, and recorded changes of parameters
    are made again at their place among the frames.
    """

    Parameters: ClassVar[type] = PlayerParameters
    _unsent: Message | None

    def veto(self, proposed: PlayerParameters) -> str:
        """Changes of pace and place `proposed` are made here, so that what cannot be is refused.
        """
        if not hasattr(self, '_playback'):
            return ''
        now, rate = time.monotonic(), proposed.rate or math.inf
        try:
            if proposed.seek_s != self.settings.seek_s:
                self._playback.seek(proposed.seek_s, now)
                self._unsent = None
            self._playback.set_rate(rate, now)
        except InputError as error:
            return str(error)
        return ''

    def setup(self) -> None:
        values: PlayerParameters = self.settings
        if not values.session:
            raise InputError(self.get_name(), 'expected a parameter session: what to play')
        self._open = contextlib.ExitStack()
        self._source = self._open.enter_context(open_source(values.session))
        self._kinds = self._find_kinds(set(values.topics))
        self._outlets = PlaybackPublishers(self, self._kinds)
        self._rig = LiveRig(self, self._kinds)
        self._look_due = 0.0
        self._alone = values.into_live_rig
        self._answers = [self._hear(topic) for topic in values.answers]
        self._sent = 0
        self._callable: dict[str, Client] = {}
        self._asked_after = ('', 0)
        self.service(SetBool, '~/pause', self._on_pause)
        self.service(Trigger, '~/step', self._on_step)
        self.every(_CLOCK_SECONDS, self._play)

    def start(self) -> None:
        values: PlayerParameters = self.settings
        source, topics = self._source, [*self._kinds]
        frame = frame_topic(self._kinds, self._answers)
        if self._answers:
            # The controller's, where it is in play: it is what people change.
            source = ReplayOrder(source, frame, next(
                (topic for topic in self._answers if is_topic(topic, 'field/command')),
                self._answers[-1]))
            topics += {CHANGES} & set(source.topics)
        self._asked = self._found = time.monotonic()
        self._listeners = 0
        self._unsent = None
        self._begun = self._done = False
        self._playback = Playback(
            source, self._asked, rate=values.rate or math.inf, start=values.start_s,
            end=values.end_s or None, loop=values.loop, topics=topics)
        self._lockstep = LockStep(self._playback, frame, self._answers)

    def teardown(self) -> None:
        if hasattr(self, '_open'):
            self._open.close()

    @property
    def finished(self) -> bool:
        """Whether all has been played and answered, or given up."""
        return self._done or bool(self.fault)

    def health(self) -> tuple[bytes, str, dict[str, object]]:
        state = ('finished' if self._lockstep.finished else
                 'paused' if self._playback.paused else
                 'playing' if self._begun else 'waiting for listeners of')
        return OK, f'{state} {self.settings.session}', {'messages_sent': self._sent}

    def _find_kinds(self, wanted: set[str]) -> dict[str, type]:
        """The topics to play, and their types."""
        names = {f'/{topic.lstrip("/")}' for topic in wanted}
        unknown = names - set(self._source.topics)
        if unknown:
            there = ', '.join(sorted(self._source.topics))
            raise InputError(self.settings.session, f'no topic {sorted(unknown)[0]}; has {there}')
        chosen = {name: _message_class(topic.type) for name, topic in self._source.topics.items()
                  if name != CHANGES and (not names or name in names)}
        for name, (kind, _) in TOPICS.items() if self.settings.answers else ():
            for topic in chosen:
                if is_topic(topic, name) and chosen[topic] is not kind:
                    raise InputError(self.settings.session, f'expected a {kind.__name__} on '
                                                            f'{topic}, found another type')
        return chosen

    def _play(self) -> None:
        now = time.monotonic()
        if not self.settings.into_live_rig and now >= self._look_due:
            self._look(now)
        if self.finished:
            return
        # Told a turn of the executor later, so that who heard the last answer too has taken it.
        self._done = self._lockstep.finished and not self._unsent and (
            bool(self._answers) or now - self._asked > _ACKNOWLEDGED_SECONDS
            or self._outlets.has_all())
        if not self._begun:
            self._gather(now)
        elif not self._lockstep.missing:
            self._send_due(now)
        elif now - self._asked > self.settings.patience_s:
            self._give_up(self._who_is_late())
        elif now - self._asked > _TURN_SECONDS:
            self._ask_after()

    def _look(self, now: float) -> None:
        """Play into no rig that is live, nor into one that comes alive meanwhile."""
        self._look_due = now + (_LOOK_SECONDS if self._begun else _FIRST_LOOKS_SECONDS)
        live, self._alone = self._rig.look()
        if live:
            self.fault = (f'{live} is live, and would take the past for the present: end it, run '
                          'it with use_sim_time, or replay with --into-live-rig (into_live_rig)')

    def _gather(self, now: float) -> None:
        """Begin when whoever listens is there; in lock-step that is somebody for every topic."""
        listeners = self._outlets.count
        if listeners != self._listeners:
            self._listeners, self._found = listeners, now
        missing = [topic for topic in self._answers if not self.count_publishers(topic)]
        missing += self._outlets.missing(at_least=1 if self._answers else 0)
        incomplete = missing or not listeners or now - self._found < _SETTLED_SECONDS
        if self._answers and missing and now - self._asked > self.settings.patience_s:
            self._give_up(f'not everybody is there for {missing[0]}')
        if not self._alone or (incomplete and (
                self._answers or now - self._asked < _NOBODY_SECONDS)):
            return
        self._begun = True
        if not self._playback.paused:
            self._playback.resume(now)

    def _send_due(self, now: float) -> None:
        held = [self._unsent] if self._unsent else []
        for message in itertools.chain(held, self._lockstep.take(now)):
            # A bounded slice, so that services are answered at any rate.
            if not self._send(message) or time.monotonic() - now > 5 * _CLOCK_SECONDS:
                break
        if not self._answers and not self._unsent:
            self._outlets.tell_time(self._playback.clock_ns(now))

    def _send(self, message: Message) -> bool:
        """Whether there was room for it; if not it is kept for the next turn."""
        self._asked = time.monotonic()
        if self._answers:
            self._outlets.tell_time(message.t_ns)
        if message.topic == CHANGES:
            self._change_again(message.data)
        elif not self._outlets.send(message.topic, bytes(message.data)):
            self._unsent = message
            self.complain(f'waiting for a listener of {message.topic} that keeps all and is late')
            return False
        self._unsent = None
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
        for message in () if self._unsent else self._lockstep.step(now):
            self._send(message)
        count = self._sent - sent
        if not self._answers:
            self._outlets.tell_time(self._playback.clock_ns(now))
        response.success, response.message = count > 0, f'{count} messages'
        return response

    # Lock-step ------------------------------------------------------------------------------

    def _hear(self, name: str) -> str:
        """Listen to the answers on a topic, and go on when the last to a frame is there."""
        if name not in TOPICS:
            raise InputError(self.get_name(), f'answers: expected topics of the graph, got {name}')
        topic = self.resolve_topic_name(name)

        def take(data: bytes) -> None:
            self._lockstep.answer(topic, header_stamp_ns(data))
            if not self._lockstep.missing:
                self._send_due(time.monotonic())
        self.subscribe(TOPICS[name][0], topic, take, raw=True)
        return topic

    def _ask_after(self) -> None:
        """A node that has had its turn and said nothing, because poses were too old, has answered.

        It serves one after the other: what it is asked now it replies to after its turn.
        """
        topic, stamp_ns = next(iter(self._lockstep.missing.items()))
        asked = topic, stamp_ns
        if asked != self._asked_after:
            self._asked_after = asked
            for node in self._answering(topic):
                self._call(GetState, f'{node}/get_state', GetState.Request(), *asked)

    def _change_again(self, data: bytes) -> None:
        """Give a node the parameters that it was given then, and wait until it has taken them."""
        event = deserialize_message(data, ParameterEvent)
        if event.changed_parameters and event.node in self._answering(*self._answers):
            name = f'{event.node}/set_parameters'
            self._lockstep.expect(name, 0)
            request = SetParameters.Request(parameters=event.changed_parameters)
            self._call(SetParameters, name, request, name, 0)

    def _call(self, kind: type, name: str, request: Any, topic: str, stamp_ns: int) -> None:
        """Call a service; its reply counts as an answer."""
        if name not in self._callable:
            self._callable[name] = self.client(kind, name)
            self._callable[name].wait_for_service(self.settings.patience_s)
        self._callable[name].call_async(request).add_done_callback(
            lambda _: self._lockstep.answer(topic, stamp_ns))

    def _answering(self, *topics: str) -> set[str]:
        """The nodes that publish on some topics, by their full names."""
        return {
            f'{info.node_namespace.rstrip("/")}/{info.node_name}'
            for topic in topics for info in self.get_publishers_info_by_topic(topic)}

    def _who_is_late(self) -> str:
        topic, stamp_ns = next(iter(self._lockstep.missing.items()))
        who = ', '.join(self._answering(topic)) or 'nobody'
        at = (stamp_ns - self._source.start_ns) / 1e9
        return f'{who} did not answer the frame at {at:.3f} s on {topic}'

    def _give_up(self, reason: str) -> None:
        self.fault = f'{reason} within {self.settings.patience_s:g} s'


def _message_class(type_name: str) -> type:
    """`sensor_msgs/msg/Image` as a class; InputError where this machine has no such type."""
    package, _, name = type_name.split('/')
    try:
        found: type = getattr(importlib.import_module(f'{package}.msg'), name)
    except (ImportError, AttributeError):
        raise InputError(type_name, 'expected a message type that is installed here') from None
    return found
