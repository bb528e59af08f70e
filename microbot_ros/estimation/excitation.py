"""What the recent command cannot tell apart, from the information it carries."""

from __future__ import annotations

import numpy as np

from microbot_ros.estimation.noise import Noise, whiten

PARAMETERS = ('speed', 'φ', 'delay', 'drift along x', 'drift along y')

WEAK = 0.01
"""A combination of parameters with less than this share of their information is unseen."""

_ADVICE = {
    frozenset(('φ', 'delay')): 'turn the field both ways, or in steps',
    frozenset(('speed', 'drift')): 'turn the field to other directions',
    frozenset(('φ', 'drift')): 'turn the field to other directions',
    frozenset(('delay', 'drift')): 'turn the field more often',
}


def information(times: np.ndarray, path: np.ndarray, late: np.ndarray, noise: Noise) -> np.ndarray:
    """Fisher information (5, 5) about (log v, φ, delay, drift x, drift y) of one particle.

    For v = 1 and φ = 0: `path` (T,) complex ∫u dt, `late` (T,) its derivative by the delay. Both
    axes are whitened as positions are; a slow drift is a column that grows with time.
    """
    time = (times - times[0]).astype(complex)
    levels = np.stack([path, 1j * path, late, time, 1j * time], axis=-1)[:, None, :]
    seen = np.ones((len(times), 1), bool)
    columns = whiten(levels, times, noise, seen).columns[:, 0]
    return np.real(np.conj(columns).T @ columns)


def confounded(info: np.ndarray) -> list[tuple[str, str]]:
    """Pairs of PARAMETERS that a singular direction of the information mixes, worst first."""
    size = np.sqrt(np.diag(info))
    present = size > 1e-9 * size.max(initial=1e-300)
    names = [name for name, there in zip(PARAMETERS, present, strict=True) if there]
    scaled = info[np.ix_(present, present)] / np.outer(size[present], size[present])
    values, vectors = np.linalg.eigh(scaled)
    pairs = []
    for value, vector in zip(values, vectors.T, strict=True):
        if value < WEAK:
            first, second = sorted(np.argsort(-np.abs(vector))[:2])
            pairs.append((names[first], names[second]))
    return pairs


def sentences(info: np.ndarray, seconds: float) -> list[str]:
    """One sentence for each pair that the last `seconds` of commands confound."""
    if not info[0, 0] > 0:
        return [f'nothing was commanded in the last {seconds:.0f} s: speed, φ and delay are unseen']
    told = []
    for first, second in dict.fromkeys(
        (a.split(' along')[0], b.split(' along')[0]) for a, b in confounded(info)
    ):
        advice = _ADVICE.get(frozenset((first, second)), 'vary the command')
        told.append(
            f'{first} and {second} cannot be told apart under the last {seconds:.0f} s of '
            f'commands: {advice}'
        )
    if info[2, 2] <= 1e-9 * info[0, 0]:
        told.append(f'the delay is unseen: the command did not turn in the last {seconds:.0f} s')
    return told
