"""Talking to a running graph from outside: arm, set parameters, send goals, watch its health."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.duration import Duration
from rclpy.exceptions import InvalidNamespaceException, NameValidationException
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.qos import QoSProfile
from rclpy.task import Future
from rclpy.validate_namespace import validate_namespace
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import String
from std_srvs.srv import SetBool

from microbot_ros.control.controller_thread import AGAIN, CONFIGURING
from microbot_ros.drive.amplifier import BY_HAND, Zero
from microbot_ros.errors import InputError, RigError, clipped
from microbot_ros.loop.points import GOAL
from microbot_ros.nodes import messages
from microbot_ros.nodes.participant import client_context
from microbot_ros.records import Commands

_FIND_SECONDS = 5.0
"""So long a node may take to be seen: what it says to a process that has just started may be lost,
and is said again after 0.5 s."""

_TAKE_SECONDS = 5.0
"""So long a controller may take to say that it took goals or a path."""

_MATCH_SECONDS = 2.0
_REPEAT_SECONDS = 0.3
"""They are sent again as often as this until it does."""

_ASK_AGAIN_SECONDS = 3.0
"""A service that has not answered by then is asked again, but never to arm: longer than any takes
for its work."""

_ANSWER_SECONDS = 12.0
"""A service that has not answered by then will not."""

Tell = Callable[[bytes, str, dict[str, str]], None]


class NoAnswerError(RigError):
    """A node is there and does not answer: whether it did what was asked is not known."""


@dataclass(frozen=True)
class Taken:
    """What a controller said of goals or a path that it took: their stamp [s], and which one it
    is."""

    stamp: float
    controller: str


def checked_namespace(name: str) -> str:
    """A namespace by its `name`, with the slash before it; InputError for what cannot be one."""
    namespace = f'/{name.strip("/")}'
    try:
        validate_namespace(namespace)
    except InvalidNamespaceException:
        raise InputError('--namespace', 'expected a name such as rig_2; received '
                                        f'{clipped(namespace)}') from None
    return namespace


class GraphClient:
    """A client of the graph with a node, `name`, of its own, beside those of one `namespace`.

    Use as a context. What it asks of a node ends with that node's answer, or with RigError: the
    node is not there, says nothing or refuses.
    """

    def __init__(self, name: str = 'microbot', namespace: str = '/') -> None:
        namespace = checked_namespace(namespace)
        context = client_context()
        self.node = rclpy.create_node(name, namespace=namespace, context=context)
        self._executor = SingleThreadedExecutor(context=context)
        self._executor.add_node(self.node)
        # At once: by the time that somebody waits for an answer it has long been matched.
        self._progress: dict[str, str] = {}
        self._progress_watchers: list[Tell] = []
        self.node.create_subscription(
            DiagnosticStatus, 'controller/progress', self._on_progress, 10)

    def __enter__(self) -> GraphClient:
        return self

    def __exit__(self, *_: object) -> None:
        self._executor.shutdown()
        self.node.destroy_node()

    def spin(self, seconds: float) -> None:
        """Serve callbacks for so many `seconds`."""
        deadline = time.monotonic() + seconds
        while (left := deadline - time.monotonic()) > 0:
            self._executor.spin_once(timeout_sec=left)

    def until(self, true: Callable[[], Any], seconds: float) -> bool:
        """Serve callbacks until something is `true`, at most `seconds`; whether it is."""
        deadline = time.monotonic() + seconds
        while not true():
            left = deadline - time.monotonic()
            if left <= 0:
                return False
            self._executor.spin_once(timeout_sec=min(left, 0.02))
        return True

    def namespaces_of(self, node: str) -> list[str]:
        """The namespaces in which a node of that name runs, as far as the graph is known."""
        return [namespace for name, namespace in self.node.get_node_names_and_namespaces()
                if name == node]

    def runs(self, node: str) -> bool:
        """Whether a node of that name runs in our namespace, as far as the graph is known."""
        return self.node.get_namespace() in self.namespaces_of(node)

    def watch_health(self, tell: Callable[[str, bytes, str, dict[str, str]], None]) -> None:
        """Call `tell(node, level, sentence, values)` for every diagnostic status of a node in our
        namespace.
        """
        here = self.node.get_namespace()

        def heard(message: DiagnosticArray) -> None:
            for status in message.status:
                place, _, name = f'/{status.name.split(":")[0]}'.rpartition('/')
                if (place or '/') == here:
                    values = {pair.key: pair.value for pair in status.values}
                    tell(name, status.level, status.message, values)
        self.node.create_subscription(DiagnosticArray, '/diagnostics', heard, QoSProfile(depth=50))

    def watch_estimates(self, tell: Callable[[np.ndarray], None]) -> None:
        """Call `tell(points)`, of type ESTIMATE, for every `model/state`."""
        self.node.create_subscription(
            PointCloud2, 'model/state',
            lambda message: tell(messages.estimates(message)), 10)

    def echo(self, seconds: float = 2.5) -> str:
        """Send a message through the middleware and back; its name. InputError after `seconds`."""
        heard: list[String] = []
        self.node.create_subscription(String, '~/echo', heard.append, 1)
        publisher = self.node.create_publisher(String, '~/echo', 1)
        deadline = time.monotonic() + seconds
        while not heard:
            if time.monotonic() > deadline:
                raise InputError('ros', f'no echo within {seconds:g} s; is a firewall closing '
                                        'loopback?')
            publisher.publish(String(data='echo'))
            self.spin(0.05)
        name: str = rclpy.get_rmw_implementation_identifier()
        return name

    def arm(self, armed: bool = True) -> str:
        """Arm the gate of the coil driver, or disarm it if not `armed`; return what it answered.

        A request to arm is sent once: a second one could arm after a STOP that came in between.
        Without an answer to it the driver is asked to disarm. A request to disarm is repeated
        until it is answered.

        Raises
        ------
        RigError
            If the driver refuses, does not answer, or cannot confirm a zero that its amplifier
            could confirm; the message is the driver's.
        """
        try:
            answer = self._call(SetBool, 'coil_driver/arm', SetBool.Request(data=armed),
                                repeat=not armed)[-1]
        except NoAnswerError as silence:
            if not armed:
                raise RigError(f'{silence}: {Zero.UNREACHABLE}, {BY_HAND}') from None
            raise RigError(f'{silence}; {self._disarmed_instead()}') from None
        if not answer.success:
            raise RigError(f'coil_driver: {answer.message}')
        return str(answer.message)

    def _disarmed_instead(self) -> str:
        """Disarm a driver that did not answer a request to arm; what came of it, in words."""
        try:
            return f'disarmed: {self.arm(False)}'
        except RigError as error:
            return f'asked to disarm: {error}'

    def record(self, begin: bool) -> str:
        """End a recording or `begin` one; which folder. RigError with the recorder's reason.

        To be as it was told to be is a refusal only to the first request: a later one is sent
        because the answer to that was lost.
        """
        answers = self._call(SetBool, 'recorder/record', SetBool.Request(data=begin))
        done = [answer.message for answer in answers if answer and answer.success]
        refusal: str = answers[-1].message
        if not done and len(answers) > 1 and begin and refusal.startswith('already recording'):
            done = [refusal.removeprefix('already ')]
        elif not done and len(answers) > 1 and not begin and refusal == 'not recording':
            done = ['the recording has ended']
        if not done:
            raise RigError(f'recorder: {refusal}')
        return done[0]

    def set(self, node: str, **values: Any) -> None:
        """Set parameters of a node, again while it still takes them aside. InputError with its
        reason if it refuses a value."""
        try:
            request = SetParameters.Request(parameters=[
                Parameter(name, value=value).to_parameter_msg()
                for name, value in values.items()])
        except (TypeError, ValueError, AssertionError):
            raise InputError(node, 'expected booleans, numbers, texts or lists of one of them; '
                                   f'received {values}') from None
        deadline = time.monotonic() + CONFIGURING + _ANSWER_SECONDS
        while True:
            answer = self._call(SetParameters, f'{node}/set_parameters', request)[-1]
            going_on = any(result.reason.endswith(AGAIN) for result in answer.results)
            if not going_on or time.monotonic() > deadline:
                break
            self.spin(_REPEAT_SECONDS)
        for result in answer.results:
            if not result.successful:
                raise InputError(node, result.reason)

    def get(self, node: str, *names: str) -> dict[str, Any]:
        """Values of parameters of a node."""
        request = GetParameters.Request(names=list(names))
        answer = self._call(GetParameters, f'{node}/get_parameters', request)[-1]
        return {name: parameter_value_to_python(value)
                for name, value in zip(names, answer.values, strict=True)}

    def send_goals(self, positions: Sequence[tuple[float, float]],
                   particles: Sequence[int] | None = None) -> Taken:
        """Send `positions` (x, y) [m] to go to, in order, until the controller has taken it.

        With `particles` the goal of each of those; no position cancels.
        """
        xy, stamp = np.array(positions, float).reshape(-1, 2), self.node.get_clock().now().to_msg()
        if particles is None:
            return self._hand_over('goals', messages.poses(xy, np.zeros(len(xy)), stamp), 'goals')
        goals = np.zeros(len(xy), GOAL)
        goals['id'], goals['x'], goals['y'] = particles, *xy.T
        return self._hand_over('particle_goals', messages.cloud(goals, stamp), 'goals')

    def send_path(self, positions: Sequence[tuple[float, float]]) -> Taken:
        """Send `positions` (x, y) [m] as a path to follow, until the controller has taken it; no
        position cancels.
        """
        array = messages.poses(np.array(positions, float).reshape(-1, 2),
                               np.zeros(len(positions)), self.node.get_clock().now().to_msg())
        return self._hand_over('path', Path(header=array.header, poses=[
            PoseStamped(header=array.header, pose=pose) for pose in array.poses]), 'path')

    def send_plan(self, commands: Commands) -> Taken:
        """Send a plan, whose last row is its end, until the controller has taken it."""
        return self._hand_over('field/plan', messages.plan(
            commands, self.node.get_clock().now().to_msg()), 'plan')

    def watch_progress(self, tell: Tell) -> None:
        """Call `tell(level, sentence, values)` several times a second for the controller's."""
        self._progress_watchers.append(tell)

    def _on_progress(self, message: DiagnosticStatus) -> None:
        self._progress = {pair.key: pair.value for pair in message.values}
        for tell in self._progress_watchers:
            tell(message.level, message.message, self._progress)

    def _hand_over(self, topic: str, message: Any, what: str) -> Taken:
        """Publish to the controller, again and again, until it says that it has this stamp.

        RigError with its reason where it refuses. That somebody listens says nothing: it may be a
        recorder. To be told twice changes nothing for a controller, whose goals are the same then.
        """
        stamp = messages.to_seconds(message.header.stamp)
        self._progress = {}

        def taken() -> bool:
            return float(self._progress.get(f'{what}_stamp_s', 'nan')) == stamp

        def answered() -> bool:
            return taken() or float(self._progress.get('refused_stamp_s', 'nan')) == stamp
        self._find('controller', lambda: self._listens('controller', topic), f'takes no {topic}')
        publisher = self.node.create_publisher(type(message), topic, 10)
        try:
            # A recorder is to have it too: what is published before it is matched passes it by.
            self.until(lambda: publisher.get_subscription_count() >= len(
                self.node.get_subscriptions_info_by_topic(topic)), _MATCH_SECONDS)
            deadline = time.monotonic() + _TAKE_SECONDS
            while not taken():
                if answered():
                    raise RigError(f'controller: {self._progress["refused"]}')
                if time.monotonic() > deadline:
                    answer = ('it answers, but not to these' if self._progress else
                              'it says nothing; is it active?')
                    raise RigError(f'controller did not take the {what} within '
                                   f'{_TAKE_SECONDS:g} s: {answer}')
                publisher.publish(message)
                self.until(answered, _REPEAT_SECONDS)
            publisher.wait_for_all_acked(Duration(seconds=_MATCH_SECONDS))
        finally:
            self.node.destroy_publisher(publisher)
        return Taken(stamp, self._progress['controller'])

    def _listens(self, node: str, topic: str) -> bool:
        return any((end.node_name, end.node_namespace) == (node, self.node.get_namespace())
                   for end in self.node.get_subscriptions_info_by_topic(topic))

    def _find(self, node: str, true: Callable[[], bool], lack: str) -> None:
        """Wait until it is true of a node; RigError with what is known of it otherwise."""
        if self.until(true, _FIND_SECONDS):
            return
        here, places = self.node.get_namespace(), self.namespaces_of(node)
        if here in places:
            raise RigError(f'{node} is there, but {lack}')
        hint = f' There is one in --namespace {places[0]}' if places else ''
        raise RigError(f'{node} was not found in the namespace {here} within {_FIND_SECONDS:g} s: '
                       f'is it running?{hint}')

    def _call(self, kind: type, name: str, request: Any, repeat: bool = True) -> list[Any]:
        """Return the answers to a request, one for each time it was sent; None for a lost one.

        A server that does not know yet where to send an answer drops it: with `repeat` the
        request is sent again until there is an answer. NoAnswerError without one.
        """
        node = name.rpartition('/')[0]
        try:
            client = self.node.create_client(kind, name)
        except NameValidationException:
            raise InputError('', f"expected the name of a node; received '{node}'") from None
        try:
            self._find(node, client.service_is_ready, f'has no service {name}')
            asked: list[Future] = []
            deadline = time.monotonic() + _ANSWER_SECONDS
            while not (asked and asked[-1].done()):
                if time.monotonic() > deadline:
                    raise NoAnswerError(f'{node} did not answer within {_ANSWER_SECONDS:g} s')
                if not asked or (repeat and not any(future.done() for future in asked)):
                    asked.append(client.call_async(request))
                self.until(asked[-1].done, _ASK_AGAIN_SECONDS)
            return [future.result() if future.done() else None for future in asked]
        finally:
            self.node.destroy_client(client)
