"""The nodes beside a real rig: `ros2 launch microbot_ros rig_launch.py config:=rig.yaml`."""

import os
from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, SetEnvironmentVariable
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode

from microbot_ros.ending import PARENT

NODES = ('coil_driver', 'recorder', 'controller', 'model', 'tracker', 'camera')


def generate_launch_description() -> LaunchDescription:
    """Every node of a rig, each activating itself; the gate stays disarmed."""
    default = Path(get_package_share_directory('microbot_ros')) / 'config' / 'rig.yaml'
    config = LaunchConfiguration('config')
    return LaunchDescription([
        # The nodes end with the launcher, whatever becomes of it.
        SetEnvironmentVariable(PARENT, str(os.getpid())),
        DeclareLaunchArgument('config', default_value=str(default),
                              description='ROS parameter file with a section per node'),
        *(
            LifecycleNode(package='microbot_ros', executable=f'{name}_node', name=name,
                          namespace='', parameters=[config], output='screen')
            for name in NODES
        ),
    ])
