"""A node without a graph: told what to take and when, it hands back what it says."""

from __future__ import annotations

import importlib
import queue
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, cast

import rclpy
import yaml
from rcl_interfaces.msg import ParameterEvent
from rclpy.client import Client
from rclpy.clock import ROSClock
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rclpy.signals import SignalHandlerOptions
from rclpy.time import Time

from microbot_ros.common.errors import InputError
from microbot_ros.control.deadline_worker import Call, DeadlineWorker, HungError, LateError
from microbot_ros.control.plugins.policy import EXECUTED_FILE
from microbot_ros.nodes.account import Account
from microbot_ros.nodes.lifecycle import RELIABLE, RigNode
from microbot_ros.nodes.process import NODES
from microbot_ros.nodes.transport import NODE, NOWHERE, transport
from microbot_ros.session.accounts import BUSY, CHANGE, HUNG, IN_TIME, LATE

_CALL_SECONDS = 60.0
"""How long a controller may think when nothing waits for it."""


class _Script(Account):
    """In place of what happens, what happened: the time, and how calls came out."""

    def __init__(self, node: RigNode) -> None:
        super().__init__(node)
        self._next: Iterator[str] = iter('')

    def begin(self) -> None:
        """There is nobody to tell."""

    def act(self, name: str) -> None:
        """It was noted when it happened."""

    def worker(self, patience: float) -> DeadlineWorker:
        return ScriptedWorker(patience, lambda: next(self._next, IN_TIME))

    def set(self, at_ns: int, verdicts: str) -> None:
        """What is taken next is taken at this time [ns], with these verdicts."""
        self.taken_s, self._next = at_ns * 1e-9, iter(verdicts)


class ScriptedWorker(DeadlineWorker):
    """A worker of `patience` [s] whose calls come out as each `verdict()` says they did."""

    def __init__(self, patience: float, verdict: Callable[[], str]) -> None:
        super().__init__(patience)
        self._verdict = verdict

    def call(self, function: Callable[[], Any], deadline: float) -> Any:
        verdict = self._verdict()
        if verdict == BUSY:
            raise LateError('has not returned from the tick before')
        if verdict == HUNG:
            raise HungError('did not return')
        if verdict == LATE:
            with suppress(Exception):
                super().call(function, _CALL_SECONDS)
            raise LateError(f'took longer than {deadline * 1e3:g} ms')
        return super().call(function, _CALL_SECONDS)

    def finished(self, call: Call[Any], seconds: float) -> bool:
        return super().finished(call, _CALL_SECONDS)


class _Outlet:
    """What a node takes for a publisher."""

    def __init__(self, publish: Callable[[Any], None]) -> None:
        self.publish = publish

    def get_subscription_count(self) -> int:
        return 0


class Offline(RigNode):
    """Mixed into a node, `name`: its subscriptions and timers are called, its clock is set.

    Nothing that it publishes leaves it.
    """

    Account = _Script
    account: _Script

    def __init__(self, name: str) -> None:
        self.inlets: dict[str, tuple[type, Callable[[Any], None]]] = {}
        self.said: queue.SimpleQueue[tuple[str, Any]] = queue.SimpleQueue()
        """Topic, as the node calls it, and message; some come from threads."""
        self.alarms: dict[str, Callable[[], None]] = {}
        self.withheld = ''
        """Why it is not configured as it was when it was recorded; '' where it is."""
        super().__init__(name)
        self._network = self.values.get(EXECUTED_FILE, '')

    def be_told(self, name: str, data: bytes, at_ns: int, verdicts: str = '') -> None:
        """Take `data` of a message on the topic `name`, or of a change of parameters, at `at_ns`,
        with
        how its calls to a controller came out (`verdicts`).
        """
        self._at(at_ns, verdicts)
        if name != CHANGE:
            kind, callback = self.inlets[name]
            callback(deserialize_message(data, kind))
        elif changed := deserialize_message(data, ParameterEvent).changed_parameters:
            self.set_parameters_atomically([
                self._without_code(Parameter.from_parameter_msg(one)) for one in changed])

    def _without_code(self, parameter: Parameter) -> Parameter:
        """A `parameter` as it is to be set: a network that a recording names is not executed, but
        the one that was given at the start."""
        if parameter.name != EXECUTED_FILE or parameter.value == self._network:
            return parameter
        if parameter.value:
            self.withheld = (f'{EXECUTED_FILE} was set to another network, which a replay does '
                             'not execute')
        return Parameter(EXECUTED_FILE, value=self._network)

    def act(self, timer: str, at_ns: int, verdicts: str = '') -> None:
        """Let a `timer`, known by the name of its callback, go off at `at_ns`; `verdicts` as
        above.
        """
        self._at(at_ns, verdicts)
        self.alarms[timer]()

    @property
    def values(self) -> dict[str, Any]:
        """All its parameters."""
        return {name: one.value for name, one in self._parameters.items()}

    def _at(self, at_ns: int, verdicts: str) -> None:
        clock = self.get_clock()
        assert isinstance(clock, ROSClock)
        clock.set_ros_time_override(Time(nanoseconds=at_ns))
        self.account.set(at_ns, verdicts)

    # In place of what a graph would do ------------------------------------------------------

    def publisher(self, kind: type, topic: str, qos: QoSProfile = RELIABLE) -> Publisher:
        return cast(Publisher, _Outlet(lambda message: self.said.put((topic, message))))

    def subscribe(self, kind: type, topic: str, callback: Callable[[Any], None],
                  qos: QoSProfile = RELIABLE, raw: bool = False,
                  on_matched: Callable[[Any], None] | None = None) -> None:
        self.inlets[topic] = kind, self._guarded(callback)

    def every(self, seconds: float, callback: Callable[[], None], steady: bool = True) -> None:
        self.alarms[callback.__name__] = self._guarded(callback)

    def noted(self, callback: Callable[[], None]) -> Callable[[], None]:
        self.alarms[callback.__name__] = self._guarded(callback)
        return callback

    def service(self, kind: type, name: str, callback: Callable[[Any, Any], Any]) -> None:
        """A service `kind`, `name`, `callback` that nobody calls."""

    def client(self, kind: type, name: str) -> Client:
        raise NotImplementedError(f'{self.get_name()} calls {name}: there is nobody to answer')


@contextmanager
def alone(namespace: str, parameters: dict[str, dict[str, Any]], folder: Path) -> Iterator[None]:
    """ROS for nodes of a `namespace` that nobody sees, and that see nobody.

    Their `parameters` are left in a file in `folder`.
    """
    file = folder / 'parameters.yaml'
    file.write_text(yaml.safe_dump({f'/**/{node}': {
        'ros__parameters': {**values, 'use_sim_time': True}}
        for node, values in parameters.items()}))
    with transport(NOWHERE, NODE):
        try:
            rclpy.init(args=[
                '--ros-args', '--params-file', str(file), '-r', f'__ns:={namespace or "/"}',
                '--disable-stdout-logs', '--disable-rosout-logs', '--disable-external-lib-logs'],
                signal_handler_options=SignalHandlerOptions.NO)
            yield
        finally:
            rclpy.try_shutdown()


def make_offline(name: str) -> Offline:
    """The node of that name, configured and active. InputError where it does not want to be."""
    module = importlib.import_module(f'microbot_ros.nodes.{name}')
    kind: type[Offline] = type(NODES[name], (Offline, getattr(module, NODES[name])), {})
    node = kind(name)
    for step in (node.trigger_configure, node.trigger_activate):
        if step() != TransitionCallbackReturn.SUCCESS:
            raise InputError(name, node.fault.removeprefix(f'{name}: '))
    return node


def end_offline(node: Offline) -> None:
    """Let go of a node and of what it opened."""
    node.make_safe_and_close()
    node.destroy_node()
