"""What discovery found in a running graph, for its screens."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from rclpy.duration import Duration
from std_msgs.msg import String

from microbot_ros.nodes.base.lifecycle import LATCHED
from microbot_ros.nodes.client.graph_client import GraphClient

_HEARD_SECONDS = 1.0
"""So long whoever listens may take to have heard it, before the process may end."""


class VerdictPublisher:
    """Says on `discovery/verdict` of the graph of a `client` what a look has found.

    The topic is latched: a screen that comes later hears the last verdict, as long as this lives.
    """

    def __init__(self, client: GraphClient) -> None:
        self._publisher = client.node.create_publisher(String, 'discovery/verdict', LATCHED)

    def publish(self, result: Mapping[str, Any]) -> None:
        """Send a `result`, the content of `result.json`, on one line."""
        line = json.dumps(result, ensure_ascii=False, allow_nan=False)
        self._publisher.publish(String(data=line))
        self._publisher.wait_for_all_acked(Duration(seconds=_HEARD_SECONDS))
