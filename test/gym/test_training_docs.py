"""The example of docs/how-to/train_a_controller.md trains, and is played as it was trained."""

import runpy
from pathlib import Path

import gymnasium
import numpy as np

from microbot_ros.control.plugins.policy import OnnxPolicy

EXAMPLE = Path(__file__).parents[2] / 'docs/examples/train_policy.py'


def test_the_example_trains_and_exports(tmp_path, capsys):
    example = runpy.run_path(str(EXAMPLE), run_name='example')
    matrix = example['train'](generations=2, population=3, steps=40)
    assert matrix.shape == (2, 16)
    assert capsys.readouterr().err.startswith('0: mean ')
    example['export'](matrix, tmp_path / 'policy.onnx')
    policy = OnnxPolicy(tmp_path / 'policy.onnx')
    assert policy.particles == 2
    env = gymnasium.make(example['ENVIRONMENT'])
    for seed in range(5):
        seen, _ = env.reset(seed=seed)
        np.testing.assert_allclose(policy.answer(seen), matrix @ seen, rtol=1e-5, atol=1e-6)


def test_policies_like_those_it_finds_reach_both_goals():
    example = runpy.run_path(str(EXAMPLE), run_name='example')
    matrix = example['policy'](np.array([[4.0, 0.0], [-1.0, 0.0]]))
    envs = gymnasium.make_vec(example['ENVIRONMENT'], num_envs=6)
    seen, _ = envs.reset(seed=1)
    reached, going = np.zeros(6, bool), np.ones(6, bool)
    while going.any():
        seen, _, ended, cut, _ = envs.step(seen @ matrix.T)
        reached |= going & ended
        going &= ~(ended | cut)
    assert reached.all()
