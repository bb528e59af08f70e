"""The example of docs/training.md trains, and what it keeps is played as it was trained."""

import runpy
from pathlib import Path

import gymnasium
import numpy as np

from microbot_ros.control.policy import OnnxPolicy

EXAMPLE = Path(__file__).parents[2] / 'docs/examples/train_policy.py'


def test_the_example_trains_and_exports(tmp_path, capsys):
    example = runpy.run_path(str(EXAMPLE), run_name='example')
    matrix = example['train'](generations=1, population=3, episodes=1)
    assert matrix.shape == (2, 16)
    assert capsys.readouterr().err.startswith('0: mean ')
    example['export'](matrix, tmp_path / 'policy.onnx')
    policy = OnnxPolicy(tmp_path / 'policy.onnx')
    assert policy.particles == 2
    env = gymnasium.make(example['ENVIRONMENT'])
    for seed in range(5):
        seen, _ = env.reset(seed=seed)
        np.testing.assert_allclose(policy.answer(seen), matrix @ seen, rtol=1e-5, atol=1e-6)


def test_gains_like_those_it_finds_reach_both_goals():
    example = runpy.run_path(str(EXAMPLE), run_name='example')
    env = gymnasium.make(example['ENVIRONMENT'])
    scores = [example['score'](env, example['policy'](np.array([100, 0, 2, 0])), seed)
              for seed in range(3)]
    assert min(scores) > 2
