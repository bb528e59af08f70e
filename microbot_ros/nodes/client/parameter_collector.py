"""Parameters of the nodes of a running graph, requested once each."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

from rcl_interfaces.msg import ParameterValue
from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.client import Client
from rclpy.parameter import parameter_value_to_python
from rclpy.task import Future

from microbot_ros.nodes.base.lifecycle import RigNode
from microbot_ros.nodes.base.names import NODES

_PATIENCE = 5.0
"""Time [s] without an answer after which a node is asked again: a node that is just starting may
have received the question before its answer could reach anybody. Choice: longer than any answer
takes."""


class ParameterCollector:
    """Collector that requests the parameters of a rig's nodes as they appear, without waiting.

    It asks every node whose services are ready, and does not use the middleware's list of nodes.
    In one recording of a minute the parameters of five nodes were missing, though their messages
    came; that list is the likely cause. Answers arrive by the executor of the requesting node.

    Parameters
    ----------
    node : RigNode
        Requesting node.
    told : callable
        Function that is called with the name of a node and its parameters.
    """

    def __init__(self, node: RigNode, told: Callable[[str, dict[str, Any]], None]) -> None:
        self._node = node
        self._told = told
        self._clients: dict[str, tuple[Client, Client]] = {}
        self.begin()

    def begin(self) -> None:
        """Forget all answers, also those that are under way, so that every node is asked anew."""
        self._again: dict[str, float] = {}

    @property
    def answered(self) -> set[str]:
        """Nodes that have answered since the beginning."""
        return {name for name, again in self._again.items() if again == math.inf}

    def look(self) -> None:
        """Ask nodes that are present and have not answered yet; prepare one more client.

        One at a time, since the middleware delivers nothing while it makes a client: 10 ms.
        """
        for name in NODES:
            if name not in self._clients:
                self._clients[name] = (
                    self._node.client(ListParameters, f'{name}/list_parameters'),
                    self._node.client(GetParameters, f'{name}/get_parameters'))
                return
            if time.monotonic() >= self._again.get(name, 0.0) and all(
                    client.service_is_ready() for client in self._clients[name]):
                self._again[name] = time.monotonic() + _PATIENCE
                self._ask(name)

    def _ask(self, node: str) -> None:
        lister, getter = self._clients[node]
        asked = self._again

        def listed(answer: Future) -> None:
            names = list(answer.result().result.names)
            getter.call_async(GetParameters.Request(names=names)).add_done_callback(
                lambda got: self._answered(asked, node, names, got.result().values))
        lister.call_async(ListParameters.Request()).add_done_callback(listed)

    def _answered(self, asked: dict[str, float], node: str, names: list[str],
                  values: list[ParameterValue]) -> None:
        if asked is self._again and asked[node] != math.inf:
            asked[node] = math.inf
            self._told(node, {name: parameter_value_to_python(value)
                              for name, value in zip(names, values, strict=True)})
