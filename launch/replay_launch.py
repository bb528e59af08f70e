"""A recording through the model and the controller, on simulated time.

`ros2 launch microbot_ros replay_launch.py session:=PATH rate:=1.0`
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode
from launch_ros.parameter_descriptions import ParameterValue


def generate_launch_description() -> LaunchDescription:
    """The player, and today's model and controller on what it plays."""
    session = LaunchConfiguration('session')
    rate = ParameterValue(LaunchConfiguration('rate'), value_type=float)
    simulated = {'use_sim_time': True}
    return LaunchDescription([
        DeclareLaunchArgument('session', description='folder or MCAP recording to play'),
        DeclareLaunchArgument('rate', default_value='1.0', description='times real time'),
        LifecycleNode(package='microbot_ros', executable='model_node', name='model',
                      namespace='', parameters=[simulated], output='screen'),
        LifecycleNode(package='microbot_ros', executable='controller_node', name='controller',
                      namespace='', parameters=[simulated], output='screen'),
        LifecycleNode(package='microbot_ros', executable='player_node', name='player',
                      namespace='', parameters=[{'session': session, 'rate': rate}],
                      output='screen'),
    ])
