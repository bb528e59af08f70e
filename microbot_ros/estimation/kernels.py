"""The one inner loop: whitening of tracks, compiled. Imported only when it is needed."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True)
def whiten_levels(
    times: np.ndarray, seen: np.ndarray, levels: np.ndarray, excess: float,
) -> tuple[np.ndarray, float, int]:
    """Whitened increments of `levels` (T, N, M) for D = 1 and σ²/D − exposure/3 = `excess` [s].

    Local-level Kalman gain per particle (see `noise`). Rows that are unseen, or the first of
    their particle, come out as zeros. Also the sum of log variances and the number of rows used.
    """
    frames, particles, columns = levels.shape
    out = np.zeros_like(levels)
    filtered = np.zeros(columns, levels.dtype)
    log_det, used = 0.0, 0
    for n in range(particles):
        last = -1
        variance = excess
        for k in range(frames):
            if not seen[k, n]:
                continue
            if last < 0:
                filtered[:] = levels[k, n]
            else:
                ahead = variance + 2.0 * (times[k] - times[last])
                total = ahead + excess
                gain = ahead / total
                scale = 1.0 / np.sqrt(total)
                for m in range(columns):
                    innovation = levels[k, n, m] - filtered[m]
                    filtered[m] += gain * innovation
                    out[k, n, m] = innovation * scale
                variance = excess * gain
                log_det += np.log(total)
                used += 1
            last = k
    return out, log_det, used
