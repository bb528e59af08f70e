"""Periodograms of white residuals: what swings, at which frequency."""

from __future__ import annotations

import numpy as np

PADDING = 4
"""Frequencies looked at for every independent one."""


def turning_parts(times: np.ndarray, signal: np.ndarray,
                  fastest: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Frequencies (F,) from one period a recording to `fastest` [Hz], and the parts (F,) each of
    a complex signal (T,) that turn forwards and backwards: Σ s e^{∓iωt}.

    Frames are put on an even grid of the usual interval, half of which no period comes near.
    """
    h = float(np.median(np.diff(times)))
    slot = np.rint((times - times[0]) / h).astype(int)
    even = np.zeros(PADDING * (slot[-1] + 1), complex)
    np.add.at(even, slot, signal)
    forward = np.fft.fft(even)
    frequency = np.fft.fftfreq(len(even), h)
    use = np.flatnonzero((frequency >= 1 / (slot[-1] * h)) & (frequency <= fastest))
    turned = np.exp(2j * np.pi * frequency[use] * times[0])
    return frequency[use], forward[use] * turned.conj(), forward[-use] * turned

