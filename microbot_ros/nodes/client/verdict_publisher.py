"""Findings of discovery in a running graph, for its screens."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from rclpy.duration import Duration
from std_msgs.msg import String

from microbot_ros.nodes.base.lifecycle import LATCHED
from microbot_ros.nodes.client.graph_client import GraphClient

_HEARD_SECONDS = 1.0
"""Time [s] for listeners to receive a result before the process may end. Choice: half risks a lost
result on a busy machine."""


class VerdictPublisher:
    """Publisher of findings on `discovery/verdict` of the graph of a client.

    The topic is latched: a later screen receives the last result, as long as this object lives.

    Parameters
    ----------
    client : GraphClient
        Client of the graph.
    """

    def __init__(self, client: GraphClient) -> None:
        self._publisher = client.node.create_publisher(String, 'discovery/verdict', LATCHED)

    def publish(self, result: Mapping[str, Any]) -> None:
        """Send a result on one line.

        Parameters
        ----------
        result : mapping of str to object
            Content of `result.json`.
        """
        line = json.dumps(result, ensure_ascii=False, allow_nan=False)
        self._publisher.publish(String(data=line))
        self._publisher.wait_for_all_acked(Duration(seconds=_HEARD_SECONDS))
