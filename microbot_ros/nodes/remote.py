"""Talking to a running graph from outside: arm, set parameters, send goals, watch its health."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import String
from std_srvs.srv import SetBool

from microbot_ros.errors import InputError
from microbot_ros.nodes import messages
from microbot_ros.nodes.transport import stay_local


class Remote:
    """A client of the graph with a node of its own. Use as a context."""

    def __init__(self, name: str = 'microbot') -> None:
        stay_local()
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        self.node = rclpy.create_node(name)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)

    def __enter__(self) -> Remote:
        return self

    def __exit__(self, *_: object) -> None:
        self._executor.shutdown()
        self.node.destroy_node()
        rclpy.try_shutdown()

    def spin(self, seconds: float) -> None:
        """Serve callbacks for that long."""
        deadline = time.monotonic() + seconds
        while (left := deadline - time.monotonic()) > 0:
            self._executor.spin_once(timeout_sec=left)

    def watch_health(self, tell: Callable[[str, bytes, str, dict[str, str]], None]) -> None:
        """Call `tell(node, level, sentence, values)` for every diagnostic status."""
        def heard(message: DiagnosticArray) -> None:
            for status in message.status:
                values = {pair.key: pair.value for pair in status.values}
                tell(status.name.split(':')[0], status.level, status.message, values)
        self.node.create_subscription(DiagnosticArray, '/diagnostics', heard, QoSProfile(depth=50))

    def watch_estimates(self, tell: Callable[[np.ndarray], None]) -> None:
        """Call `tell(points)`, of type messages.ESTIMATE, for every `model/state`."""
        self.node.create_subscription(
            PointCloud2, 'model/state',
            lambda message: tell(messages.points(message, messages.ESTIMATE)), 10)

    def echo(self, seconds: float = 2.5) -> str:
        """Send a message through the middleware and back; its name. InputError if none came."""
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

    def arm(self, armed: bool = True) -> None:
        """Arm or disarm the gate of the coil driver. InputError with its reason if it refuses."""
        answer = self._call(SetBool, 'coil_driver/arm', SetBool.Request(data=armed))
        if not answer.success:
            raise InputError('coil_driver', answer.message)

    def record(self, begin: bool) -> str:
        """Begin or end a recording; which folder. InputError with the recorder's reason."""
        answer = self._call(SetBool, 'recorder/record', SetBool.Request(data=begin))
        if not answer.success:
            raise InputError('recorder', answer.message)
        message: str = answer.message
        return message

    def set(self, node: str, **values: Any) -> None:
        """Set parameters of a node. InputError with its reason if it refuses."""
        try:
            request = SetParameters.Request(parameters=[
                Parameter(name, value=value).to_parameter_msg()
                for name, value in values.items()])
        except (TypeError, ValueError, AssertionError):
            raise InputError(node, 'expected booleans, numbers, texts or lists of one of them; '
                                   f'received {values}') from None
        for result in self._call(SetParameters, f'{node}/set_parameters', request).results:
            if not result.successful:
                raise InputError(node, result.reason)

    def get(self, node: str, *names: str) -> dict[str, Any]:
        """Values of parameters of a node. InputError where it does not answer."""
        request = GetParameters.Request(names=list(names))
        answer = self._call(GetParameters, f'{node}/get_parameters', request)
        return {name: parameter_value_to_python(value)
                for name, value in zip(names, answer.values, strict=True)}

    def send_goals(self, positions: Sequence[tuple[float, float]],
                   particles: Sequence[int] | None = None) -> float:
        """Publish where to go, in order [m], once a controller listens; the stamp [s].

        With `particles` the goal of each of those; no position cancels.
        """
        xy, stamp = np.array(positions, float).reshape(-1, 2), self.node.get_clock().now().to_msg()
        if particles is None:
            self._publish('goals', messages.poses(xy, np.zeros(len(xy)), stamp))
        else:
            goals = np.zeros(len(xy), messages.GOAL)
            goals['id'], goals['x'], goals['y'] = particles, *xy.T
            self._publish('particle_goals', messages.cloud(goals, stamp))
        return messages.to_seconds(stamp)

    def send_path(self, positions: Sequence[tuple[float, float]]) -> None:
        """Publish a path to follow [m], once a controller listens; no position cancels."""
        array = messages.poses(np.array(positions, float).reshape(-1, 2),
                               np.zeros(len(positions)), self.node.get_clock().now().to_msg())
        self._publish('path', Path(header=array.header, poses=[
            PoseStamped(header=array.header, pose=pose) for pose in array.poses]))

    def watch_progress(self, tell: Callable[[bytes, str, dict[str, str]], None]) -> None:
        """Call `tell(level, sentence, values)` several times a second for the controller's."""
        def heard(message: DiagnosticStatus) -> None:
            tell(message.level, message.message,
                 {pair.key: pair.value for pair in message.values})
        self.node.create_subscription(DiagnosticStatus, 'controller/progress', heard, 10)

    def _publish(self, topic: str, message: Any, seconds: float = 5.0) -> None:
        publisher = self.node.create_publisher(type(message), topic, 10)
        deadline = time.monotonic() + seconds
        while publisher.get_subscription_count() == 0:
            if time.monotonic() > deadline:
                raise InputError(topic, 'nobody listens; is the controller running?')
            self.spin(0.05)
        publisher.publish(message)

    def _call(self, kind: type, name: str, request: Any, seconds: float = 5.0) -> Any:
        client = self.node.create_client(kind, name)
        try:
            if not client.wait_for_service(timeout_sec=seconds):
                raise InputError(name, f'no such service within {seconds:g} s; is it running?')
            future = client.call_async(request)
            self._executor.spin_until_future_complete(future, timeout_sec=seconds)
            if not future.done():
                raise InputError(name, f'no answer within {seconds:g} s')
            return future.result()
        finally:
            self.node.destroy_client(client)
