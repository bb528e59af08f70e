"""Gymnasium environment on the loop, for training controllers.

    import gymnasium, microbot_ros.gym

    env = gymnasium.make('microbot_ros/Steering-v0')

Gymnasium is in the extra `gym`. Observations and actions are defined in `control.policy_task`; the
controller `policy` runs a trained policy on a rig.

Examples
--------
>>> import gymnasium, microbot_ros.gym
>>> env = gymnasium.make('microbot_ros/Steering-v0')
>>> observation, _ = env.reset(seed=0)
>>> observation.shape == env.observation_space.shape
True
"""

try:
    import gymnasium
except ModuleNotFoundError:
    raise ImportError('microbot_ros.gym needs Gymnasium: pip install microbot_ros[gym]') from None

gymnasium.register(
    'microbot_ros/Steering-v0', 'microbot_ros.gym.steering:SteeringEnv',
    vector_entry_point='microbot_ros.gym.steering:SteeringVectorEnv')
