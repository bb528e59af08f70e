"""The closed loop on the virtual rig: `ros2 launch microbot_ros demo_launch.py`.

The emulated amplifier is at the other end of a real serial line (a pseudo-terminal). The gate
stays disarmed until `ros2 service call /coil_driver/arm std_srvs/srv/SetBool '{data: true}'`.
"""

import os
import tempfile
from pathlib import Path

from launch import LaunchContext, LaunchDescription
from launch.actions import ExecuteProcess, OpaqueFunction, SetEnvironmentVariable
from launch_ros.actions import LifecycleNode
from launch_ros.substitutions import ExecutableInPackage

from microbot_ros.common.ending import PARENT

NODES = ('virtual_rig', 'tracker', 'model', 'controller', 'coil_driver')


def generate_launch_description() -> LaunchDescription:
    """The virtual rig in place of camera and coils, and every node that a real rig has."""
    return LaunchDescription([
        # The nodes and the amplifier end with the launcher, whatever becomes of it.
        SetEnvironmentVariable(PARENT, str(os.getpid())),
        OpaqueFunction(function=start),
    ])


def start(_: LaunchContext) -> list[ExecuteProcess]:
    """The amplifier and the nodes, once it is sure that they are to run: they need a folder."""
    folder = Path(tempfile.mkdtemp(prefix='microbot-'))
    port, log = str(folder / 'amplifier'), str(folder / 'amplifier.jsonl')
    own = {'virtual_rig': {'amplifier_log': log}, 'coil_driver': {'port': port}}
    # Scripts of a package lie in lib/microbot_ros, where no shell looks for them.
    microbot = ExecutableInPackage(executable='microbot', package='microbot_ros')
    return [
        ExecuteProcess(cmd=[microbot, 'emulate', 'serial_transfer', '--link', port,
                            '--log', log, '--full-scale-A', '2', '--leave-nothing'],
                       output='screen'),
        *(
            LifecycleNode(package='microbot_ros', executable=f'{name}_node', name=name,
                          namespace='', parameters=[own.get(name, {})], output='screen',
                          # Until the amplifier's port and log are there, nodes end and try again.
                          respawn=True, respawn_delay=1.0)
            for name in NODES
        ),
    ]
