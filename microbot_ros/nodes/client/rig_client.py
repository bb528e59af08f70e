"""Requests to a running rig, common to commands, the cockpit's page and discovery."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Point, PointStamped, PoseStamped
from nav_msgs.msg import Path
from rcl_interfaces.msg import ParameterDescriptor
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from rclpy.client import Client
from rclpy.exceptions import NameValidationException
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.publisher import Publisher
from rclpy.task import Future
from std_msgs.msg import Header
from std_srvs.srv import SetBool

from microbot_ros.common.errors import InputError, RigError, known
from microbot_ros.common.patience import PATIENCE
from microbot_ros.common.records import Commands
from microbot_ros.control.controller_thread import AGAIN, CONFIGURING
from microbot_ros.drive.amplifier import BY_HAND, Zero
from microbot_ros.loop.points import GOAL
from microbot_ros.nodes.base import messages

REPEAT_S = 0.3
"""Interval [s] at which goals, a path or a plan are sent until they are accepted. Choice: a
controller reports five times a second."""
MATCH_S = 2.0
"""Time [s] for all listeners to be connected. Choice: discovery takes less; a listener that is
later misses one message."""
RECORDER_S = 0.5
"""Time [s] for a recorder to be discovered after the controller. Choice: on one machine they are
0.1 s apart; half would lose goals of a busy rig, twice delays the first one without a recorder."""

T = TypeVar('T')
Wait = tuple[Callable[[], Any], float]
Steps = Generator[Wait, bool, T]
"""Work on a request: a generator that yields conditions to wait for, with the longest time [s] of
each. It is sent whether the condition came true, and returns the answer."""


class RefusedError(RigError):
    """Error of a node that refused a request.

    Parameters
    ----------
    node : str
        Name of the node.
    reason : str
        Why, in its own words.
    """

    def __init__(self, node: str, reason: str) -> None:
        self.reason = reason or 'refused; no reason given'
        super().__init__(f'{node}: {self.reason}')


class NoAnswerError(RigError):
    """Error of a node that is present and does not answer: whether it acted is unknown."""


@dataclass(frozen=True)
class Taken:
    """Answer of a controller that accepted goals or a path.

    Attributes
    ----------
    stamp : float
        Their stamp [s].
    controller : str
        Name of the controller.
    """

    stamp: float
    controller: str


class RigClient:
    """Client of the nodes in the namespace of a node that the caller spins.

    Each request is a generator (`Steps`), so that it can wait in a command's own thread or in an
    event loop. It returns the answer, or raises RigError: a node is missing, silent or refuses.
    `services` and `publishers` hold those made so far, by name; `taught` is the newest message of
    `tracker/taught`.

    Parameters
    ----------
    node : Node
        Node in the namespace of the rig.
    """

    def __init__(self, node: Node) -> None:
        self.services: dict[str, Client] = {}
        self.publishers: dict[str, Publisher] = {}
        self.progress: dict[str, str] = {}
        self.taught = DiagnosticStatus()
        self._progress_s = 0.0
        self._node = node

    def hear(self, progress: dict[str, str]) -> None:
        """Receive a report of the controller.

        Parameters
        ----------
        progress : dict of str to str
            Its values.
        """
        self.progress, self._progress_s = progress, time.monotonic()

    def arm(self, now: bool = False) -> Steps[str]:
        """Arm the gate of the coil driver.

        Without an answer the driver is asked to disarm.

        Parameters
        ----------
        now : bool
            Whether not to wait for a driver that is not seen yet.

        Returns
        -------
        Steps[str]
            Answer of the driver.

        Raises
        ------
        RigError
            If the driver is missing, silent or refuses.
        """
        try:
            return (yield from self._set_gate(True, 0.0 if now else PATIENCE.find_s))
        except NoAnswerError as silence:
            try:
                disarmed = f'disarmed: {(yield from self.stop(now=True))}'
            except RigError as error:
                disarmed = f'disarm requested; no answer: {error}'
            raise RigError(f'{silence}; {disarmed}') from None
        except GeneratorExit:  # the caller gave up before the answer, as on Ctrl-C
            self._service(SetBool, 'coil_driver/arm').call_async(SetBool.Request(data=False))
            raise

    def stop(self, now: bool = False) -> Steps[str]:
        """Zero the coils and disarm.

        The answer to any of the requests counts.

        Parameters
        ----------
        now : bool
            Whether to ask the driver even if it is not seen.

        Returns
        -------
        Steps[str]
            Answer of the driver, which begins with a `Zero`.

        Raises
        ------
        RigError
            If the driver is missing, silent or refuses.
        """
        try:
            return (yield from self._set_gate(False, None if now else PATIENCE.find_s))
        except NoAnswerError as silence:
            raise RigError(f'{Zero.UNREACHABLE}: {silence}; coils may carry current, {BY_HAND}'
                           ) from None

    def record(self, begin: bool) -> Steps[str]:
        """Begin or end a recording.

        If the recording is in this state already, only the first request is refused: a later one
        is sent because the answer to the first was lost.

        Parameters
        ----------
        begin : bool
            Whether to begin.

        Returns
        -------
        Steps[str]
            Answer of the recorder.
        """
        answer, first = yield from self._ask(
            SetBool, 'recorder/record', SetBool.Request(data=begin))
        if not first and begin and answer.message.startswith('already recording'):
            return str(answer.message).removeprefix('already ')
        if not first and not begin and answer.message == 'not recording':
            return 'the recording has ended'
        return _done('recorder', answer)

    def teach(self, like: bool, x: float, y: float, kind: str | None, stamp_ns: int,
              ) -> Steps[str]:
        """Show the tracker an example.

        Parameters
        ----------
        like : bool
            Whether it shows the kind to follow, or not.
        x, y : float
            Position [px].
        kind : str or None
            Name of the kind; None for the one that fits best.
        stamp_ns : int
            Stamp of the frame [ns].

        Returns
        -------
        Steps[str]
            What the tracker learned.

        Raises
        ------
        RefusedError
            If the tracker learned nothing, with its reason.
        """
        yield from self.set('tracker', example_kind=kind or '')
        topic = 'tracker/like' if like else 'tracker/unlike'
        if stamp_ns >= 2**31 * 10**9:
            raise InputError('teach', f'expected a stamp before 2038; received {stamp_ns} ns')
        message = PointStamped(point=Point(x=x, y=y), header=Header(
            frame_id=messages.PIXELS, stamp=messages.stamp_at(stamp_ns)))
        asked = {'example': topic.partition('/')[2], 'stamp_ns': str(stamp_ns), 'x': str(x),
                 'y': str(y)}
        before = self.taught
        self.publishers[topic].publish(message)

        def answered() -> bool:
            return self.taught is not before and asked == {
                entry.key: entry.value for entry in self.taught.values}
        if not (yield answered, sum(PATIENCE.ask_s)):
            raise NoAnswerError(f'tracker did not answer within {sum(PATIENCE.ask_s):g} s')
        if self.taught.level != DiagnosticStatus.OK:
            raise RefusedError('tracker', self.taught.message)
        return str(self.taught.message)

    def set(self, node: str, /, **values: Any) -> Steps[None]:
        """Set parameters of a node, again while it is still busy with them.

        Parameters
        ----------
        node : str
            Name of the node.
        **values : object
            Values by name.

        Returns
        -------
        Steps[None]
            The request.

        Raises
        ------
        InputError
            If the node refuses a value, with its reason.
        """
        try:
            request = SetParameters.Request(parameters=[
                Parameter(name, value=value).to_parameter_msg()
                for name, value in values.items()])
        except (TypeError, ValueError, AssertionError):
            raise InputError(node, 'expected booleans, numbers, texts or lists of one of them; '
                                   f'received {values}') from None
        deadline = time.monotonic() + CONFIGURING + sum(PATIENCE.ask_s)
        while True:
            answer, _ = yield from self._ask(SetParameters, f'{node}/set_parameters', request)
            going_on = any(result.reason.endswith(AGAIN) for result in answer.results)
            if not going_on or time.monotonic() > deadline:
                break
            yield (lambda: False), REPEAT_S
        for name, result in zip(values, answer.results, strict=True):
            if not result.successful:
                there = [one.name for one in (yield from self.describe(node))]
                raise InputError(node, (
                    result.reason or f'{name} was refused' if name in there else
                    f"expected the name of a parameter, received '{name}'; {known(there, name)}"))

    def get(self, node: str, *names: str) -> Steps[dict[str, Any]]:
        """Get parameters of a node.

        Parameters
        ----------
        node : str
            Name of the node.
        *names : str
            Names of the parameters.

        Returns
        -------
        Steps[dict of str to object]
            Values by name.
        """
        answer, _ = yield from self._ask(
            GetParameters, f'{node}/get_parameters', GetParameters.Request(names=list(names)))
        return {name: parameter_value_to_python(value)
                for name, value in zip(names, answer.values, strict=True)}

    def describe(self, node: str) -> Steps[list[ParameterDescriptor]]:
        """Get the descriptors of all parameters of a node.

        Parameters
        ----------
        node : str
            Name of the node.

        Returns
        -------
        Steps[list of ParameterDescriptor]
            The descriptors.
        """
        listed, _ = yield from self._ask(
            ListParameters, f'{node}/list_parameters', ListParameters.Request())
        answer, _ = yield from self._ask(
            DescribeParameters, f'{node}/describe_parameters',
            DescribeParameters.Request(names=listed.result.names))
        return list(answer.descriptors)

    def send_goals(self, positions: Sequence[tuple[float, float]],
                   particles: Sequence[int] | None = None) -> Steps[Taken]:
        """Send goals, in order, until the controller has accepted them.

        Parameters
        ----------
        positions : sequence of tuple[float, float]
            Positions (x, y) [m]; none cancels.
        particles : sequence of int or None
            Particle of each goal; None for any.

        Returns
        -------
        Steps[Taken]
            Answer of the controller.
        """
        xy, stamp = np.array(positions, float).reshape(-1, 2), self._now()
        if particles is None:
            return self._hand_over('goals', messages.poses(xy, np.zeros(len(xy)), stamp), 'goals')
        goals = np.zeros(len(xy), GOAL)
        goals['id'], goals['x'], goals['y'] = particles, *xy.T
        return self._hand_over('particle_goals', messages.cloud(goals, stamp), 'goals')

    def send_path(self, positions: Sequence[tuple[float, float]]) -> Steps[Taken]:
        """Send a path until the controller has accepted it.

        Parameters
        ----------
        positions : sequence of tuple[float, float]
            Positions (x, y) [m]; none cancels.

        Returns
        -------
        Steps[Taken]
            Answer of the controller.
        """
        array = messages.poses(np.array(positions, float).reshape(-1, 2),
                               np.zeros(len(positions)), self._now())
        return self._hand_over('path', Path(header=array.header, poses=[
            PoseStamped(header=array.header, pose=pose) for pose in array.poses]), 'path')

    def send_plan(self, commands: Commands) -> Steps[Taken]:
        """Send a plan until the controller has accepted it.

        Parameters
        ----------
        commands : Commands
            The plan; its last row is its end.

        Returns
        -------
        Steps[Taken]
            Answer of the controller.
        """
        return self._hand_over('field/plan', messages.plan(commands, self._now()), 'plan')

    def _now(self) -> Time:
        return self._node.get_clock().now().to_msg()

    def namespaces_of(self, node: str) -> list[str]:
        """Return the namespaces in which a node runs, as far as the graph is known.

        Parameters
        ----------
        node : str
            Name of the node.

        Returns
        -------
        list of str
            Namespaces.
        """
        return [namespace for name, namespace in self._node.get_node_names_and_namespaces()
                if name == node]

    def _hand_over(self, topic: str, message: Any, what: str) -> Steps[Taken]:
        """Publish to the controller repeatedly until it reports this stamp.

        RefusedError with its reason if it refuses. The presence of a listener proves nothing: it
        may be a recorder. A repetition changes nothing for a controller, as its goals are the
        same.
        """
        stamp, began = messages.to_seconds(message.header.stamp), time.monotonic()
        took, refused = f'{what}_stamp_s', 'refused_stamp_s'

        def says(*keys: str) -> bool:
            return any(float(self.progress.get(key, 'nan')) == stamp for key in keys)
        yield from self._find('controller', lambda: self._listens('controller', topic),
                              f'takes no {topic}', PATIENCE.find_s)
        publisher = self.publishers.get(topic)
        if publisher is None:
            publisher = self.publishers[topic] = self._node.create_publisher(
                type(message), topic, 10)
            yield (lambda: self._listens('recorder', topic)), RECORDER_S
        # For recorders too: a subscriber misses messages from before it is matched.
        yield (lambda: publisher.get_subscription_count() >= len(
            self._node.get_subscriptions_info_by_topic(topic))), MATCH_S
        deadline = time.monotonic() + PATIENCE.take_s
        while not says(took, refused):
            if time.monotonic() > deadline:
                answer = ('it answers, but not for these' if self._progress_s > began else
                          'it publishes nothing; is it active?')
                raise RigError(f'controller did not accept the {what} within '
                               f'{PATIENCE.take_s:g} s: {answer}')
            publisher.publish(message)
            yield (lambda: says(took, refused)), REPEAT_S
        if says(took):
            return Taken(stamp, self.progress['controller'])
        raise RefusedError('controller', self.progress['refused'])

    def _listens(self, node: str, topic: str) -> bool:
        wanted = node, self._node.get_namespace()
        return any((end.node_name, end.node_namespace) == wanted
                   for end in self._node.get_subscriptions_info_by_topic(topic))

    def _find(self, node: str, true: Callable[[], bool], lack: str, seconds: float,
              ) -> Steps[None]:
        """Wait for a condition on a node; RigError with what is known of the node otherwise."""
        if (yield true, seconds):
            return
        here, places = self._node.get_namespace(), self.namespaces_of(node)
        if here in places:
            raise RigError(f'{node} is there, but {lack}')
        hint = f' There is one in --namespace {places[0]}' if places else ''
        within = f' within {seconds:g} s' if seconds else ''
        raise RigError(f'{node} was not found in the namespace {here}{within}: is it running?'
                       f'{hint}')

    def _set_gate(self, armed: bool, find_s: float | None) -> Steps[str]:
        service = self._service(SetBool, 'coil_driver/arm')
        if find_s is not None:
            yield from self._find('coil_driver', service.service_is_ready,
                                  'has no service coil_driver/arm', find_s)
        answer, _ = yield from self._send('coil_driver', service, SetBool.Request(data=armed),
                                          PATIENCE.arm_s if armed else PATIENCE.stop_s)
        return _done('coil_driver', answer)

    def _service(self, kind: type, name: str) -> Client:
        if name not in self.services:
            self.services[name] = self._node.create_client(kind, name)
        return self.services[name]

    def _ask(self, kind: type, name: str, request: Any) -> Steps[tuple[Any, bool]]:
        """Find a service and send it a request, see `_send`."""
        node = name.rpartition('/')[0]
        try:
            service = self._service(kind, name)
        except NameValidationException:
            raise InputError('', f"expected the name of a node; received '{node}'") from None
        yield from self._find(
            node, service.service_is_ready, f'has no service {name}', PATIENCE.find_s)
        return (yield from self._send(node, service, request, PATIENCE.ask_s))

    def _send(self, node: str, service: Client, request: Any, again_s: Sequence[float],
              ) -> Steps[tuple[Any, bool]]:
        """Return the answer to a request, and whether it belongs to the first attempt.

        A server that does not know yet where to send an answer drops it: the request is sent again
        after each of `again_s` but the last. NoAnswerError without an answer.
        """
        asked: list[Future] = []
        try:
            for seconds in again_s:
                asked.append(service.call_async(request))
                if (yield (lambda: any(one.done() for one in asked)), seconds):
                    answered = next(one for one in asked if one.done())
                    return answered.result(), answered is asked[0]
        finally:
            for one in asked:
                service.remove_pending_request(one)
        raise NoAnswerError(f'{node} did not answer within {sum(again_s):g} s')


def _done(node: str, answer: Any) -> str:
    """Return the answer of a node; RefusedError with its reason if it refused."""
    if not answer.success:
        raise RefusedError(node, answer.message)
    return str(answer.message)
