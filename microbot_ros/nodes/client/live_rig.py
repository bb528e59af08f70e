"""Search for a live rig where a recording is to be played."""

from __future__ import annotations

import time
from collections.abc import Iterable

from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import GetParameters
from rclpy.client import Client
from rclpy.task import Future

from microbot_ros.nodes.base.lifecycle import RigNode

ACTING = frozenset({'camera', 'tracker', 'model', 'controller', 'coil_driver', 'virtual_rig'})
"""Nodes that see or move particles. A recorder or a viewer may watch a playback."""
_GONE_BY = ('camera/image_raw', 'particles', 'model/state', 'field/command', 'field/applied',
            'field/rotating')
"""Topics on which acting nodes base their answers."""
_ANSWER_SECONDS = 10.0
"""Time [s] after which a node without answer counts as live. Choice: a node that is just starting
does not answer yet, and importing takes some seconds."""
_NAMELESS = '_NODE_NAME_UNKNOWN_'
"""Name that ROS uses for a node that it has discovered but not identified."""


class LiveRig:
    """Search for live nodes that would receive a playback, or publish into it.

    These are acting nodes of the player's namespace or on the topics to play, and all other
    publishers of topics that acting nodes use. A node that follows the player's clock
    (`use_sim_time`) is not live, except a coil driver: its port is real in any case.

    Parameters
    ----------
    node : RigNode
        The player.
    topics : iterable of str
        Topics to play.
    """

    def __init__(self, node: RigNode, topics: Iterable[str]) -> None:
        self._node = node
        self._topics = list(topics)
        self._since: dict[str, float] = {}
        self._follows: dict[str, bool] = {}
        self._asked: dict[str, tuple[Client, Future | None]] = {}

    def look(self) -> tuple[str, bool]:
        """Search once.

        Returns
        -------
        tuple[str, bool]
            Name of the first live node, or ''; and whether all others are known not to be live.
        """
        now = time.monotonic()
        here = self._candidates()
        for name in set(self._since) - here:
            for known in (self._since, self._follows, self._asked):
                known.pop(name, None)
        for name in sorted(here):
            since = self._since.setdefault(name, now)
            if name.endswith('/coil_driver'):
                return name, False
            if name not in self._follows and not self._ask(name) and (
                    now - since > _ANSWER_SECONDS):
                self._follows[name] = False
            if not self._follows.get(name, True):
                return name, False
        return '', here <= set(self._follows)

    def _candidates(self) -> set[str]:
        node = self._node
        namespace = node.get_namespace()
        found = {(name, where) for name, where in node.get_node_names_and_namespaces()
                 if name in ACTING and where == namespace}
        for topic in self._topics:
            publishers = node.get_publishers_info_by_topic(topic)
            subscribers = node.get_subscriptions_info_by_topic(topic)
            found |= {(one.node_name, one.node_namespace) for one in [*publishers, *subscribers]
                      if one.node_name in ACTING}
            if f'/{topic}'.endswith(tuple(f'/{name}' for name in _GONE_BY)):
                found |= {(one.node_name, one.node_namespace) for one in publishers}
        return {f'{where.rstrip("/")}/{name}' for name, where in found
                if (name, where) != (node.get_name(), namespace)}

    def _ask(self, name: str) -> bool:
        """Ask a node for its clock, without waiting; return whether it has answered."""
        if name.endswith(_NAMELESS):
            return False
        if name not in self._asked:
            client = self._node.client(GetParameters, f'{name}/get_parameters')
            self._asked[name] = client, None
        client, future = self._asked[name]
        if future is None:
            if client.service_is_ready():
                request = GetParameters.Request(names=['use_sim_time'])
                self._asked[name] = client, client.call_async(request)
            return False
        if not future.done():
            return False
        values = future.result().values
        self._follows[name] = bool(
            values and values[0].type == ParameterType.PARAMETER_BOOL and values[0].bool_value)
        return True
