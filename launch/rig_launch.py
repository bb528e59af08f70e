"""The nodes that a rig's file names: `ros2 launch microbot_ros rig_launch.py config:=rig.yaml`.

With `namespace:=rig_2` beside another rig; in the file `/**/camera` is a camera in any namespace.
"""

import os
from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, SetEnvironmentVariable
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode

from microbot_ros.common.ending import PARENT


def generate_launch_description() -> LaunchDescription:
    """Every node of a rig, each activating itself; the gate stays disarmed."""
    default = Path(get_package_share_directory('microbot_ros')) / 'config' / 'rig.yaml'
    return LaunchDescription([
        # The nodes end with the launcher, whatever becomes of it.
        SetEnvironmentVariable(PARENT, str(os.getpid())),
        DeclareLaunchArgument('config', default_value=str(default),
                              description='ROS parameter file with a section per node'),
        DeclareLaunchArgument('namespace', default_value='/',
                              description='which rig, where there are several'),
        OpaqueFunction(function=start),
    ])


def start(context: LaunchContext) -> list[LifecycleNode]:
    """The nodes that the file has a section for; InputError for a file that is not right."""
    from microbot_ros.common.errors import InputError
    from microbot_ros.nodes.configuration import read_rig
    from microbot_ros.nodes.process import NODES

    config = LaunchConfiguration('config').perform(context)
    namespace = '/' + LaunchConfiguration('namespace').perform(context).strip('/')
    rig = read_rig(config, namespace)
    if not rig:
        raise InputError(config, f'expected a section for each node to run: {", ".join(NODES)}')
    return [LifecycleNode(package='microbot_ros', executable=f'{name}_node', name=name,
                          namespace=namespace, parameters=[config], output='screen')
            for name in NODES if name in rig]
