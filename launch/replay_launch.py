"""A recording through the model and the controller, on simulated time.

`ros2 launch microbot_ros replay_launch.py session:=PATH rate:=1.0`; beside a live rig it is
refused unless `into_live_rig:=true`.
"""

import os

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, SetEnvironmentVariable, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode
from launch_ros.parameter_descriptions import ParameterValue

from microbot_ros.common.ending import PARENT


def generate_launch_description() -> LaunchDescription:
    """The player, and today's model and controller on what it plays."""
    session = LaunchConfiguration('session')
    rate = ParameterValue(LaunchConfiguration('rate'), value_type=float)
    into_live_rig = ParameterValue(LaunchConfiguration('into_live_rig'), value_type=bool)
    simulated = {'use_sim_time': True}
    return LaunchDescription([
        # The nodes end with the launcher, whatever becomes of it.
        SetEnvironmentVariable(PARENT, str(os.getpid())),
        DeclareLaunchArgument('session', description='folder or MCAP recording to play'),
        DeclareLaunchArgument('rate', default_value='1.0', description='times real time'),
        DeclareLaunchArgument('into_live_rig', default_value='false',
                              description='play even where nodes of a rig are live'),
        LifecycleNode(package='microbot_ros', executable='model_node', name='model',
                      namespace='', parameters=[simulated], output='screen'),
        LifecycleNode(package='microbot_ros', executable='controller_node', name='controller',
                      namespace='', parameters=[simulated], output='screen'),
        LifecycleNode(package='microbot_ros', executable='player_node', name='player',
                      namespace='', parameters=[{'session': session, 'rate': rate,
                                   'into_live_rig': into_live_rig}],
                      output='screen', on_exit=Shutdown(reason='the recording has ended')),
    ])
