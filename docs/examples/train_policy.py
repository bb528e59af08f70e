"""Trains a policy by the cross-entropy method, with NumPy alone, and keeps it as ONNX.

    python docs/examples/train_policy.py policy.onnx

The field points along Σ aₖ wₖ, with the ways wₖ that are left to two particles (see
`microbot_ros.control.policy_task` for what is observed) and complex gains aₖ = exp(xₖ + iyₖ).
"""

import sys
from pathlib import Path

import gymnasium
import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

ENVIRONMENT = 'microbot_ros.gym:microbot_ros/Steering-v0'


def policy(exponents: np.ndarray) -> np.ndarray:
    """The matrix (2, 2 + 7 K) that makes actions of observations, of (x, y) (K, 2)."""
    matrix = np.zeros((2, 2 + 7 * len(exponents)), np.float32)
    for k, (x, y) in enumerate(exponents):
        a, b = np.exp(x) * np.cos(y), np.exp(x) * np.sin(y)
        matrix[:, 2 + 7 * k:4 + 7 * k] = [[a, -b], [b, a]]
    return matrix


def scores(envs: gymnasium.vector.VectorEnv, matrices: np.ndarray, steps: int) -> np.ndarray:
    """The sums (M,) of the rewards of one episode each, by policies (M, 2, 2 + 7 K)."""
    seen, _ = envs.reset()
    total, going = np.zeros(len(matrices)), np.ones(len(matrices), bool)
    for _ in range(steps):
        seen, rewards, ended, cut, _ = envs.step(np.einsum('mij,mj->mi', matrices, seen))
        total += np.where(going, rewards, 0)
        going &= ~(ended | cut)
    return total


def train(generations: int = 8, population: int = 16, steps: int = 900) -> np.ndarray:
    """The matrix in the middle of the best policies; the scores go to standard error."""
    envs = gymnasium.make_vec(ENVIRONMENT, num_envs=2 * population)
    envs.reset(seed=1)
    rng = np.random.default_rng(1)
    mean, std = np.zeros((2, 2)), np.array([[3.0, 1.0], [3.0, 1.0]])
    for generation in range(generations):
        tried = rng.normal(mean, std, (population, 2, 2))
        matrices = np.repeat([policy(one) for one in tried], 2, axis=0)  # two episodes each
        found = scores(envs, matrices, steps).reshape(population, 2).mean(axis=1)
        best = tried[np.argsort(found)[-max(population // 4, 2):]]
        mean, std = best.mean(axis=0), best.std(axis=0) + 0.1
        print(f'{generation}: mean {found.mean():.2f}, best {found.max():.2f}', file=sys.stderr)
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
