"""A Gymnasium environment on the loop, for those who train controllers.

    import gymnasium, microbot_ros.gym

    env = gymnasium.make('microbot_ros/Steering-v0')

Gymnasium is in the extra `gym`. What the environment shows and takes is in
`control.policy_task`; a policy trained in it is played at a rig by the controller `policy`.
"""

try:
    import gymnasium
except ModuleNotFoundError:
    raise ImportError('microbot_ros.gym needs Gymnasium: pip install microbot_ros[gym]') from None

gymnasium.register(
    'microbot_ros/Steering-v0', 'microbot_ros.gym.steering:SteeringEnv',
    vector_entry_point='microbot_ros.gym.steering:SteeringVectorEnv')
