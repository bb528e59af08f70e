"""Trains a linear policy by the cross-entropy method, with NumPy alone, and keeps it as ONNX.

    python docs/examples/train_policy.py policy.onnx

The field points along Σ aₖ wₖ, with the ways wₖ that are left (what each is, says
`microbot_ros.control.policy_task`) and complex gains aₖ: four numbers for two particles.
"""

import sys
from pathlib import Path

import gymnasium
import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

ENVIRONMENT = 'microbot_ros.gym:microbot_ros/Steering-v0'


def policy(gains: np.ndarray) -> np.ndarray:
    """The matrix (2, 2 + 7 K) that makes actions of observations, for `gains` (2 K,)."""
    pairs = gains.reshape(-1, 2)
    matrix = np.zeros((2, 2 + 7 * len(pairs)), np.float32)
    for k, (a, b) in enumerate(pairs):
        matrix[:, 2 + 7 * k:4 + 7 * k] = [[a, -b], [b, a]]
    return matrix


def score(env: gymnasium.Env, matrix: np.ndarray, seed: int) -> float:
    """The sum of the rewards of one episode."""
    seen, _ = env.reset(seed=seed)
    total, over = 0.0, False
    while not over:
        seen, reward, terminated, truncated, _ = env.step(matrix @ seen)
        total, over = total + float(reward), terminated or truncated
    return total


def train(generations: int = 6, population: int = 16, episodes: int = 2) -> np.ndarray:
    """The matrix of the best policy found; the scores go to standard error."""
    rng, env = np.random.default_rng(1), gymnasium.make(ENVIRONMENT)
    mean, std = np.zeros(4), np.full(4, 10.0)
    for generation in range(generations):
        tried = rng.normal(mean, std, (population, 4))
        seeds = rng.integers(2**31, size=episodes).tolist()
        scores = [np.mean([score(env, policy(gains), seed) for seed in seeds]) for gains in tried]
        best = tried[np.argsort(scores)[-max(population // 4, 2):]]
        mean, std = best.mean(axis=0), best.std(axis=0) + 0.3
        print(f'{generation}: mean {np.mean(scores):.2f}, best {np.max(scores):.2f}',
              file=sys.stderr)
    return policy(mean)


def export(matrix: np.ndarray, path: Path) -> None:
    """Write action = matrix · observation as ONNX."""
    graph = helper.make_graph(
        [helper.make_node('Gemm', ['observation', 'weights'], ['action'], transB=1)], 'policy',
        [helper.make_tensor_value_info('observation', TensorProto.FLOAT, [1, matrix.shape[1]])],
        [helper.make_tensor_value_info('action', TensorProto.FLOAT, [1, 2])],
        [numpy_helper.from_array(matrix, 'weights')])
    onnx.save(helper.make_model(
        graph, ir_version=10, opset_imports=[helper.make_opsetid('', 21)]), path)


if __name__ == '__main__':
    export(train(), Path(sys.argv[1]))
