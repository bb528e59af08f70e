"""What the recent command cannot tell apart, from the information it carries."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ros.estimation.noise import Noise, whiten

PARAMETERS = ('speed', 'φ', 'delay', 'drift', 'drift')
"""Rows of the information: log v, φ, delay, drift along x, drift along y."""

WEAK = 0.01
"""A combination of parameters with less than this share of their information is unseen."""

_ADVICE = {
    frozenset(('φ', 'delay')): 'turn the field both ways, or in steps',
    frozenset(('speed', 'drift')): 'turn the field to other directions',
    frozenset(('φ', 'drift')): 'turn the field to other directions',
    frozenset(('delay', 'drift')): 'turn the field more often',
}


@dataclass(frozen=True)
class Excitation:
    """What a command of `seconds` length leaves open.

    `pairs` of PARAMETERS that cannot be told apart, worst first; `driven`: something moved;
    `turned`: the command changed, so that a delay shows.
    """

    seconds: float
    driven: bool
    turned: bool
    pairs: tuple[tuple[str, str], ...]

    @property
    def shows_delay(self) -> bool:
        """Whether a delay can be told from φ."""
        return self.driven and self.turned and ('φ', 'delay') not in self.pairs

    @property
    def sentences(self) -> list[str]:
        """One sentence for everything that is open, with what would settle it."""
        last = f'the last {self.seconds:.0f} s'
        if not self.driven:
            return [f'nothing was driven in {last}: speed, φ and delay are unseen']
        told = [
            f'{first} and {second} cannot be told apart under the commands of {last}: '
            + _ADVICE.get(frozenset((first, second)), 'vary the command')
            for first, second in self.pairs
        ]
        if not self.turned:
            told.append(f'the delay is unseen: the command did not turn in {last}')
        return told


def judge(times: np.ndarray, path: np.ndarray, late: np.ndarray, noise: Noise) -> Excitation:
    """What a command tells apart within `times` (T,) [s], by its Fisher information.

    About PARAMETERS, from one particle with v = 1 and φ = 0: `path` (T,) complex is ∫u dt [s],
    `late` (T,) its derivative by the delay. Both axes are whitened under `noise` as positions
    are; a slow drift is a column that grows with time.
    """
    time = (times - times[0]).astype(complex)
    columns = np.stack([path, 1j * path, late, time, 1j * time], axis=-1)[:, None, :]
    white = whiten(columns, times, noise)[:, 0]
    info = np.real(np.conj(white).T @ white)
    size = np.sqrt(np.diag(info))
    return Excitation(
        seconds=float(times[-1] - times[0]),
        driven=bool(size[0] > 0),
        turned=bool(size[2] > 1e-4 * size[0]),
        pairs=_confounded(info),
    )


def _confounded(info: np.ndarray) -> tuple[tuple[str, str], ...]:
    """Pairs that a nearly singular direction of the scaled information mixes, worst first."""
    size = np.sqrt(np.diag(info))
    present = size > 1e-9 * size.max(initial=1e-300)
    names = [name for name, there in zip(PARAMETERS, present, strict=True) if there]
    scaled = info[np.ix_(present, present)] / np.outer(size[present], size[present])
    values, vectors = np.linalg.eigh(scaled)
    pairs = []
    for value, vector in zip(values, vectors.T, strict=True):
        if value < WEAK:
            first, second = sorted(np.argsort(-np.abs(vector))[:2])
            if names[first] != names[second]:
                pairs.append((names[first], names[second]))
    return tuple(dict.fromkeys(pairs))
