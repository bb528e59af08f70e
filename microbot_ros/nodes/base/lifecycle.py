"""Base of all nodes: guarded transitions and callbacks, parameters, diagnostics."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Collection, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.client import Client
from rclpy.clock import Clock, ClockType
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy

from microbot_ros.common.compiled import load
from microbot_ros.common.errors import InputError
from microbot_ros.common.settings import defaults
from microbot_ros.nodes.base.core import RELIABLE, Core
from microbot_ros.nodes.base.log import Log
from microbot_ros.nodes.base.messages import MessageError, to_seconds
from microbot_ros.nodes.base.parameters import ParameterSet, refuse_unknown

# For commands: a delayed node receives the newest one, not a queue of old ones.
NEWEST = QoSProfile(depth=1)
LATCHED = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
"""Keep the last message for later subscribers; depth 1 by definition."""
CHANGES_IN = QoSProfile(depth=10, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
"""Receive each change of a latched topic: a delayed node must not miss one. Choice: more than come
while a node is busy."""
# A best-effort subscriber matches every publisher of images, a reliable one only some.
IMAGES_IN = QoSProfile(depth=5, reliability=QoSReliabilityPolicy.BEST_EFFORT)
IMAGES_OUT = QoSProfile(depth=5)  # choice: a slow reader may be five frames late

_LINE = 400
"""Longest status message [characters]. Choice: about one line of a wide terminal; half would hide
sentences."""

SILENCE_SECONDS = 1.0
"""Time [s] without an input after which a node reports it. Choice: many frames at any rate; half
would report a slow camera."""

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


class RigNode(LifecycleNode, Core):
    """Lifecycle node that cannot fail silently.

    Subclasses name their parameters (`Parameters`) and implement `setup` (create publishers,
    subscriptions, timers, open devices), `start`, `stop`, `teardown`, `make_safe` and `health`. An
    exception in a transition or callback is logged with its traceback and shown on `/diagnostics`,
    and `make_safe` runs at once; a bad message is reported and dropped. Subscriptions and timers
    act only while the node is active.

    Parameters
    ----------
    name : str
        Name of the node.
    arguments : sequence of str or None
        ROS arguments of this node alone, `--ros-args` and what follows.
    """

    def __init__(self, name: str, arguments: Sequence[str] | None = None) -> None:
        super().__init__(name, cli_args=arguments)
        self.active = False
        self.starting = False
        """Whether its process starts it, and reports a failure."""
        self.log = Log(self)
        self.fault = ''
        """Why setup failed or the node does not work; '' for no fault."""
        self._complaint = ''
        self._complaint_until = 0.0
        self._created: list[tuple[Callable[[Any], Any], Any]] = []
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._diagnostics = self.create_publisher(DiagnosticArray, '/diagnostics', 10)
        self.create_timer(1.0, self._report, clock=self._steady)
        self._parameters_of_node: ParameterSet[Any] = ParameterSet(
            self, self.Parameters, self.veto, take=self._take_noted)
        self.declare_more()
        refuse_unknown(self)

    @classmethod
    def known_parameters(cls) -> dict[str, tuple[type, str]]:
        """Return all parameters of the node.

        Returns
        -------
        dict[str, tuple[type, str]]
            The dataclass and the field that describe a parameter, by its full name.
        """
        return {name: (cls.Parameters, name) for name in defaults(cls.Parameters)}

    # What a node fills in -------------------------------------------------------------------

    def declare_more(self) -> None:
        """Declare parameters beyond `Parameters`."""

    def veto(self, proposed: Any) -> str:
        """Return why parameters cannot be accepted; changes nothing, as others may still refuse.

        Parameters
        ----------
        proposed : object
            New parameters.

        Returns
        -------
        str
            Reason; '' to accept.
        """
        return ''

    def setup(self) -> None:
        """Configure: create everything that the node needs.

        Raises
        ------
        InputError
            If a person must act.
        """

    def start(self) -> None:
        """Activate."""

    def stop(self) -> None:
        """Deactivate and end in the safe state; also called from states that were never active."""

    def teardown(self) -> None:
        """Release what `setup` made, beyond publishers, subscriptions and timers."""

    def make_safe(self) -> None:
        """Put the devices of the node into their safe state; must not raise."""

    def health(self) -> tuple[bytes, str, dict[str, object]]:
        """Return the health of the node for `/diagnostics`.

        Returns
        -------
        tuple[bytes, str, dict of str to object]
            Level, one sentence, and values with units in their names.
        """
        return OK, 'running', {}

    @property
    def finished(self) -> bool:
        """Whether the node has nothing left to do, so that its process may end."""
        return False

    # What a node uses -----------------------------------------------------------------------

    @property
    def settings(self) -> Any:
        """Present parameters, an immutable instance of `Parameters`."""
        return self._parameters_of_node.values

    def publisher(self, kind: type, topic: str, qos: QoSProfile = RELIABLE) -> Publisher:
        # The next cleanup destroys it.
        made = self.create_publisher(kind, topic, qos)
        self._created.append((self.destroy_publisher, made))
        return made

    def subscribe(self, kind: type, topic: str, callback: Callable[[Any], None],
                  qos: QoSProfile = RELIABLE, raw: bool = False,
                  on_matched: Callable[[Any], None] | None = None) -> None:
        # Guarded; the next cleanup destroys it.
        if self.frame and not raw:
            callback = self.log.keeping(topic, callback)
        take = self._guarded(callback)
        events = SubscriptionEventCallbacks(
            matched=self._guarded(on_matched) if on_matched else None)
        made = self.create_subscription(kind, topic, take, qos, raw=raw, event_callbacks=events)
        self._created.append((self.destroy_subscription, made))

    def every(self, seconds: float, callback: Callable[[], None], steady: bool = True) -> None:
        """Make a guarded timer that the next cleanup destroys.

        Parameters
        ----------
        seconds : float
            Period [s].
        callback : callable
            Function that is called.
        steady : bool
            Whether it uses the monotonic clock; otherwise simulated time.
        """
        clock = self._steady if steady else self.get_clock()
        made = self.create_timer(seconds, self._guarded(callback), clock=clock)
        self._created.append((self.destroy_timer, made))

    def service(self, kind: type, name: str, callback: Callable[[Any, Any], Any]) -> None:
        """Make a service that the next cleanup destroys.

        Parameters
        ----------
        kind : type
            Type of the service.
        name : str
            Name of the service.
        callback : callable
            Function that is called with request and response.
        """
        made = self.create_service(kind, name, callback)
        self._created.append((self.destroy_service, made))

    def service_aside(self, kind: type, name: str, callback: Callable[..., Any],
                      at_once: Callable[[Any, Any], Any] | None = None) -> None:
        """Make a service whose callback runs in a thread, one request after the other.

        Messages do not wait for it. The next cleanup destroys it.

        Parameters
        ----------
        kind : type
            Type of the service.
        name : str
            Name of the service.
        callback : callable
            Function that is called with request, response and the result of `at_once`.
        at_once : callable or None
            Function that is called with request and header in the executor, when the request is
            received.
        """
        aside = self.aside(name)
        made = self.create_service(kind, name, lambda *asked: asked)
        answer = made.send_response

        def take(asked: tuple[Any, ...], header: Any) -> None:
            if at_once:
                asked = (*asked, at_once(asked[0], header))
            aside(lambda: answer(callback(*asked), header))

        # The executor would answer with the callback's result; this lets it continue instead.
        made.send_response = take  # type: ignore
        self._created.append((self.destroy_service, made))

    def aside(self, name: str) -> Callable[[Callable[[], None]], None]:
        """Return a function that runs work in a thread, one piece after the other.

        An exception in the work is logged. The thread ends with the next cleanup.

        Parameters
        ----------
        name : str
            Name of the thread.

        Returns
        -------
        callable
            Function that is called with the work.
        """
        pool = ThreadPoolExecutor(1, thread_name_prefix=name)
        self._created.append((pool.shutdown, True))

        def logged(work: Callable[[], None]) -> None:
            try:
                work()
            except Exception:  # the exception would be lost in the pool
                self.get_logger().error(f'{name}: {traceback.format_exc()}')

        def run(work: Callable[[], None]) -> None:
            pool.submit(logged, work)
        return run

    def client(self, kind: type, name: str) -> Client:
        """Make a client of a service that the next cleanup destroys.

        Parameters
        ----------
        kind : type
            Type of the service.
        name : str
            Name of the service.

        Returns
        -------
        Client
            The client.
        """
        made = self.create_client(kind, name)
        self._created.append((self.destroy_client, made))
        return made

    def seconds(self) -> float:
        """Return the present time of the node's clock.

        Returns
        -------
        float
            Time [s].
        """
        return to_seconds(self.get_clock().now().to_msg())

    def make_safe_and_close(self) -> None:
        """Make safe, then release everything that `setup` made, in any state of the node."""
        self.active = False
        self.make_safe()
        if self._state_machine.current_state[1] in ('unconfigured', 'inactive', 'active'):
            self.trigger_shutdown()
        else:  # a signal during a transition, such as the first compilation
            self._transition('shutdown', self._end)

    def complain(self, sentence: str) -> None:
        # On the log, and for 5 s on `/diagnostics`.
        self._complaint = sentence
        self._complaint_until = time.monotonic() + 5.0
        self.get_logger().warning(sentence, throttle_duration_sec=1.0)

    def act(self, name: str) -> None:
        if self.frame:
            self.log.note(name, 0)

    # Machinery ------------------------------------------------------------------------------

    def _take_noted(self, changed: Mapping[str, Any], named: Collection[str]) -> str:
        if not self.frame or not hasattr(self, '_parameters_of_node'):
            return self.take(changed, named)
        sets = self._parameters_of_node.sets
        values = {prefix + name: value for prefix, each in sets.items()
                  for name, value in vars(changed.get(prefix, each.values)).items()
                  if prefix + name in named}
        return self.log.take(values, lambda: self.take(changed, named))

    def _guarded(self, callback: Callable[..., None]) -> Callable[..., None]:
        def guarded(*arguments: Any) -> None:
            if not self.active:
                return
            try:
                callback(*arguments)
            except MessageError as error:
                self.complain(str(error))
            except Exception as error:
                self._failed(callback.__name__, error)
        return guarded

    def _failed(self, where: str, error: Exception) -> None:
        self.make_safe()
        self.complain(f'{where} failed: {error}')
        self.get_logger().error(traceback.format_exc())

    def _transition(self, name: str, step: Callable[[], None]) -> TransitionCallbackReturn:
        try:
            step()
        except Exception as error:
            self.fault = _for_people(error)
            if not self.fault:
                self.fault = f'{name} failed: {error}'
                self._failed(name, error)
                return TransitionCallbackReturn.ERROR
            self.make_safe()
            if not self.starting:
                self.get_logger().error(self.fault)
            return TransitionCallbackReturn.FAILURE
        return TransitionCallbackReturn.SUCCESS

    def _setup(self) -> None:
        self.setup()
        load()  # no callback is to wait for numba

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Set the node up (`setup`).

        Parameters
        ----------
        state : LifecycleState
            State before the transition.

        Returns
        -------
        TransitionCallbackReturn
            Result of the transition.
        """
        self.fault = ''
        if self.frame:
            self.log.begin()
        done = self._transition('configure', self._setup)
        if done != TransitionCallbackReturn.SUCCESS:
            self._discard()
        return done

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Start the node (`start`).

        Parameters
        ----------
        state : LifecycleState
            State before the transition.

        Returns
        -------
        TransitionCallbackReturn
            Result of the transition.
        """
        done = self._transition('activate', self.start)
        self.active = done == TransitionCallbackReturn.SUCCESS
        return done

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop the node, safe (`stop`).

        Parameters
        ----------
        state : LifecycleState
            State before the transition.

        Returns
        -------
        TransitionCallbackReturn
            Result of the transition.
        """
        self.active = False
        return self._transition('deactivate', self.stop)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Release what `setup` made.

        Parameters
        ----------
        state : LifecycleState
            State before the transition.

        Returns
        -------
        TransitionCallbackReturn
            Result of the transition.
        """
        return self._transition('cleanup', self._discard)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop the node and release what `setup` made.

        Parameters
        ----------
        state : LifecycleState
            State before the transition.

        Returns
        -------
        TransitionCallbackReturn
            Result of the transition.
        """
        return self._transition('shutdown', self._end)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop the node and release what `setup` made.

        Parameters
        ----------
        state : LifecycleState
            State before the transition.

        Returns
        -------
        TransitionCallbackReturn
            Result of the transition.
        """
        return self._transition('error', self._end)

    def _end(self) -> None:
        self.active = False
        self.stop()
        self._discard()

    def _discard(self) -> None:
        self.teardown()
        for destroy, made in self._created:
            destroy(made)
        self._created.clear()

    def _report(self) -> None:
        level, sentence, values = self._condition()
        if self.fault:
            level, sentence = ERROR, self.fault
        elif time.monotonic() < self._complaint_until and level == OK:
            level, sentence = WARN, self._complaint
        message = DiagnosticArray(status=[status(self, level, in_one_line([sentence]), values)])
        message.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(message)

    def _condition(self) -> tuple[bytes, str, dict[str, object]]:
        if not self.active:
            return OK, 'not active', {}
        try:
            return self.health()
        except Exception as error:  # would end the executor, and the node with it
            self._failed('health', error)
            return ERROR, f'health failed: {error}', {}


def in_one_line(sentences: Sequence[str]) -> str:
    """Return as many sentences as fit into one line, and the number of the others.

    Parameters
    ----------
    sentences : sequence of str
        Sentences.

    Returns
    -------
    str
        At most 400 characters.
    """
    told, left = '', list(sentences)
    while left and len(f'{told}; {left[0]}') <= _LINE - len('; and 999 more'):
        told = '; '.join(filter(None, (told, left.pop(0))))
    if not told and left:
        told = f'{left.pop(0)[:_LINE - 20]}…'
    return f'{told}; and {len(left)} more' if left else told


def status(node: Node, level: bytes, sentence: str, values: dict[str, object]) -> DiagnosticStatus:
    """Return the status message of a node, named by its name with its namespace.

    Parameters
    ----------
    node : Node
        The node.
    level : bytes
        Level of `health`.
    sentence : str
        Text for people.
    values : dict of str to object
        Values of `health`.

    Returns
    -------
    DiagnosticStatus
        The message.
    """
    full = node.get_fully_qualified_name().removeprefix('/')
    return DiagnosticStatus(
        level=level, name=f'{full}: {node.get_name()}', message=sentence,
        values=[KeyValue(key=key, value=_text(value)) for key, value in values.items()])


def _for_people(error: Exception) -> str:
    """Return what a person must correct, an input or a file; '' if the code is at fault."""
    if isinstance(error, OSError) and error.filename is not None:
        return f'{error.filename}: {error.strerror}'
    return str(error) if isinstance(error, InputError) else ''


def _text(value: object) -> str:
    return f'{value:.6g}' if isinstance(value, float) else str(value)
