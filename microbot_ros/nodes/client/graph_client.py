"""Client of a running graph: arm, set parameters, send goals, watch its health."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import wraps
from typing import Any, Concatenate, ParamSpec, TypeVar

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.duration import Duration
from rclpy.exceptions import InvalidNamespaceException
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile
from rclpy.validate_namespace import validate_namespace
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import String

from microbot_ros.common.errors import InputError, clipped
from microbot_ros.nodes.base import messages
from microbot_ros.nodes.base.participant import client_context
from microbot_ros.nodes.client.rig_client import RigClient, Steps

_ACKNOWLEDGED_S = 2.0
"""Time [s] that a client waits at its end until its messages have arrived. Choice: half risks a
lost message on a busy machine, twice delays the end of a command."""

P = ParamSpec('P')
T = TypeVar('T')
Tell = Callable[[bytes, str, dict[str, str]], None]


def checked_namespace(name: str) -> str:
    """Return a namespace with its leading slash.

    Parameters
    ----------
    name : str
        Namespace with or without slashes.

    Returns
    -------
    str
        The namespace.

    Raises
    ------
    InputError
        If it is not valid.
    """
    namespace = f'/{name.strip("/")}'
    try:
        validate_namespace(namespace)
    except InvalidNamespaceException:
        raise InputError('--namespace', 'expected a name such as rig_2; received '
                                        f'{clipped(namespace)}') from None
    return namespace


def _spun(request: Callable[Concatenate[RigClient, P], Steps[T]],
          ) -> Callable[Concatenate[GraphClient, P], T]:
    """Return a method of `RigClient` that waits for the answer and serves callbacks meanwhile."""
    @wraps(request)
    def performed(self: GraphClient, /, *args: P.args, **kwargs: P.kwargs) -> T:
        return self.perform(request(self.rig, *args, **kwargs))
    return performed


class GraphClient:
    """Client of the graph with its own node beside those of one namespace, as a context.

    Requests are made by `rig`, a `RigClient`; it waits for the answers.

    Parameters
    ----------
    name : str
        Name of its node.
    namespace : str
        Namespace of the rig; '/' for the root.
    """

    def __init__(self, name: str = 'microbot', namespace: str = '/') -> None:
        namespace = checked_namespace(namespace)
        context = client_context()
        self.node = rclpy.create_node(name, namespace=namespace, context=context)
        self._executor = SingleThreadedExecutor(context=context)
        self._executor.add_node(self.node)
        self.rig = RigClient(self.node)
        # Now, so that it is matched before an answer is awaited.
        self._progress_watchers: list[Tell] = []
        self.node.create_subscription(
            DiagnosticStatus, 'controller/progress', self._on_progress, 10)

    def __enter__(self) -> GraphClient:
        return self

    def __exit__(self, *_: object) -> None:
        for publisher in self.rig.publishers.values():
            publisher.wait_for_all_acked(Duration(seconds=_ACKNOWLEDGED_S))
        self._executor.shutdown()
        self.node.destroy_node()

    def spin(self, seconds: float) -> None:
        """Serve callbacks.

        Parameters
        ----------
        seconds : float
            Time [s].
        """
        deadline = time.monotonic() + seconds
        while (left := deadline - time.monotonic()) > 0:
            self._executor.spin_once(timeout_sec=left)

    def until(self, true: Callable[[], Any], seconds: float) -> bool:
        """Serve callbacks until a condition is true.

        Parameters
        ----------
        true : callable
            The condition.
        seconds : float
            Longest time to wait [s].

        Returns
        -------
        bool
            Whether it became true.
        """
        deadline = time.monotonic() + seconds
        while not true():
            left = deadline - time.monotonic()
            if left <= 0:
                return False
            self._executor.spin_once(timeout_sec=min(left, 0.02))
        return True

    def runs(self, node: str) -> bool:
        """Return whether a node runs in the client's namespace, as far as the graph is known.

        Parameters
        ----------
        node : str
            Name of the node.

        Returns
        -------
        bool
            Whether it runs.
        """
        return self.node.get_namespace() in self.rig.namespaces_of(node)

    def watch_health(self, tell: Callable[[str, bytes, str, dict[str, str]], None]) -> None:
        """Watch the diagnostic status of all nodes in the client's namespace.

        Parameters
        ----------
        tell : callable
            Function that is called with node, level, sentence and values.
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
        """Watch `model/state`.

        Parameters
        ----------
        tell : callable
            Function that is called with estimates (N,) of type ESTIMATE.
        """
        self.node.create_subscription(
            PointCloud2, 'model/state',
            lambda message: tell(messages.estimates(message)), 10)

    def echo(self, seconds: float = 2.5) -> str:
        """Send a message through the middleware and back.

        Parameters
        ----------
        seconds : float
            Longest time to wait [s].

        Returns
        -------
        str
            Name of the middleware.

        Raises
        ------
        InputError
            If it does not come back in time.
        """
        heard: list[String] = []
        self.node.create_subscription(String, '~/echo', heard.append, 1)
        publisher = self.node.create_publisher(String, '~/echo', 1)
        deadline = time.monotonic() + seconds
        while not heard:
            if time.monotonic() > deadline:
                raise InputError('ros', f'no echo within {seconds:g} s; does a firewall block '
                                        'the loopback interface?')
            publisher.publish(String(data='echo'))
            self.spin(0.05)
        name: str = rclpy.get_rmw_implementation_identifier()
        return name

    arm = _spun(RigClient.arm)
    stop = _spun(RigClient.stop)
    record = _spun(RigClient.record)
    set = _spun(RigClient.set)
    get = _spun(RigClient.get)
    send_goals = _spun(RigClient.send_goals)
    send_path = _spun(RigClient.send_path)
    send_plan = _spun(RigClient.send_plan)

    def perform(self, steps: Steps[T]) -> T:
        """Serve callbacks while the steps of a request wait.

        Parameters
        ----------
        steps : Steps[T]
            The steps.

        Returns
        -------
        T
            Their result.
        """
        try:
            wait = next(steps)
            while True:
                wait = steps.send(self.until(*wait))
        except StopIteration as end:
            answer: T = end.value
            return answer
        finally:
            steps.close()

    def watch_progress(self, tell: Tell) -> None:
        """Watch the controller's progress, several times a second.

        Parameters
        ----------
        tell : Tell
            Function that is called with level, sentence and values.
        """
        self._progress_watchers.append(tell)

    def _on_progress(self, message: DiagnosticStatus) -> None:
        progress = {pair.key: pair.value for pair in message.values}
        self.rig.hear(progress)
        for tell in self._progress_watchers:
            tell(message.level, message.message, progress)
