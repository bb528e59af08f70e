"""The demo as ROS tests it: `launch_test test/launch/demo_launch.py`.

launch and launch_testing come with an installation of ROS, not from PyPI. `test/test_package.py`
runs this where they are.
"""

from __future__ import annotations

import os
import time
import unittest
from pathlib import Path
from typing import Any

import launch_testing
import launch_testing.asserts
import rclpy
from launch import LaunchDescription
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch_testing.actions import ReadyToTest
from lifecycle_msgs.msg import State
from lifecycle_msgs.srv import GetState
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor

ROOT = Path(__file__).parents[2]
NODES = ('virtual_rig', 'tracker', 'model', 'controller', 'coil_driver')
PATIENCE_S = 300.0
"""After this the test gives up. Choice: the first start compiles for minutes."""

# Before launch makes its own participant: all look for each other on this machine alone.
os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')


def generate_test_description() -> LaunchDescription:
    """The launch file of the demo, and the tests at once."""
    return LaunchDescription([
        IncludeLaunchDescription(PythonLaunchDescriptionSource(
            str(ROOT / 'launch' / 'demo_launch.py'))),
        ReadyToTest()])


class TestDemo(unittest.TestCase):
    """What runs beside the nodes."""

    def test_every_node_becomes_active(self) -> None:
        """By the service that `ros2 lifecycle get` calls."""
        context = Context()
        rclpy.init(context=context)
        probe = rclpy.create_node('probe', context=context)
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(probe)
        clients = {name: probe.create_client(GetState, f'{name}/get_state') for name in NODES}
        state: dict[str, int] = {}
        end = time.monotonic() + PATIENCE_S
        while set(state.values()) != {State.PRIMARY_STATE_ACTIVE} or len(state) < len(NODES):
            assert time.monotonic() < end, state
            for name, client in clients.items():
                if client.service_is_ready():
                    answer = client.call_async(GetState.Request())
                    executor.spin_until_future_complete(answer, timeout_sec=1.0)
                    if answer.done():
                        state[name] = answer.result().current_state.id
            time.sleep(0.2)
        executor.shutdown()
        probe.destroy_node()
        rclpy.shutdown(context=context)


@launch_testing.post_shutdown_test()
class TestEnd(unittest.TestCase):
    """What is found after the launcher has stopped everything."""

    def test_every_process_ends_in_order(self, proc_info: Any) -> None:
        """Nodes zero the coils and exit with 0."""
        launch_testing.asserts.assertExitCodes(proc_info)
