"""How far lines lie from each other."""

from __future__ import annotations

import numpy as np


def farthest(points: np.ndarray, line: np.ndarray) -> float:
    """How far the farthest of `points` is from a `line` through its corners."""
    a, d = line[:-1], np.diff(line, axis=0)
    share = np.clip(((points[:, None] - a) * d).sum(-1) / (d * d).sum(-1), 0, 1)
    return float(np.linalg.norm(points[:, None] - a - share[..., None] * d, axis=-1)
                 .min(axis=1).max())
