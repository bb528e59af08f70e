"""Starting points of a search, from whitened residuals, before a few of them are fitted.

Oscillations show in a periodogram. For drifts that depend on place, residuals are summed over
blocks of time in which a particle hardly moves. A slow field passes the whitening filter as a
constant times itself, so its score needs no filter: (Σ R·v)² / Σ n|v|².
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from microbot_ros.estimation.likelihood.joint import SessionFit
from microbot_ros.estimation.likelihood.model_fit import ModelFit
from microbot_ros.model.effect import AnyEffect, Effect
from microbot_ros.model.effect_context import EffectContext, Places
from microbot_ros.model.model import Model
from microbot_ros.model.physics.vectors import as_vectors

PADDING = 4
"""Frequencies evaluated per independent one.

Choice: the largest is then missed by at most 1/8 of a line's width; more only cost time.
"""

BROAD = 12
"""Independent frequencies on either side of a peak from which its noise is estimated.

Choice: fewer follow the peak itself, more miss noise that is not white.
"""

BLOCK = 1.0
"""Duration [s] of the blocks over which residuals are summed.

Choice: particles move a few µm in it; a longer one blurs fields of place, a shorter one costs
time.
"""


def rotating_components(
    times: np.ndarray, signal: np.ndarray, fastest: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the rotating Fourier components of a complex signal.

    Computes Σ s e^{∓iωt}, forwards and backwards, from one period per recording to `fastest`.
    Frames are placed on a regular grid of the median interval; no period comes near half of it.

    Parameters
    ----------
    times : ndarray, shape (T,)
        Times of the frames [s].
    signal : ndarray of complex, shape (T,)
        The signal.
    fastest : float
        Highest frequency [Hz].

    Returns
    -------
    frequencies : ndarray, shape (F,)
        Frequencies [Hz].
    forward, backward : ndarray of complex, shape (F,)
        Components that rotate either way.
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


def background(power: np.ndarray, dof: int, signals: int = 1) -> np.ndarray:
    """Return the noise around each frequency of a periodogram.

    It is the median over BROAD independent frequencies on either side, of which a peak occupies
    one or two.

    Parameters
    ----------
    power : ndarray, shape (F,)
        The largest of the powers of several signals, each χ² of `dof` for white noise.
    dof : int
        Degrees of freedom.
    signals : int, optional
        Number of signals.

    Returns
    -------
    ndarray, shape (F,)
        In units of white noise; at least 1.
    """
    from scipy.ndimage import median_filter
    from scipy.special import chdtri

    usual = float(chdtri(dof, 1 - 0.5 ** (1 / signals)))
    around = median_filter(power, 2 * BROAD * PADDING + 1, mode='nearest')
    noise: np.ndarray = np.maximum(around / usual, 1.0)
    return noise


@dataclass(frozen=True)
class _Blocks:
    """Sums and counts (B, N, 2) of whitened residuals in blocks, and their middles.

    Both are 0, and the place is 0, for a particle that is missing in the middle of a block.
    """

    residual: np.ndarray
    count: np.ndarray
    middle: EffectContext

    @classmethod
    def of(cls, p: SessionFit, model: Model) -> _Blocks:
        times, commands = p.session.times, p.session.commands
        first = np.unique(((times - times[0]) / BLOCK).astype(int), return_index=True)[1]
        middle = (first + np.append(first[1:], len(times))) // 2
        t, position = times[middle], p.session.causal_positions[middle]
        known = np.isfinite(position)
        context = EffectContext(
            t[:, None], np.zeros((len(t), 1)), model.field(commands.field_at(t)[:, None]),
            commands.frequency_at(t)[:, None], model.reference_field,
            Places(np.where(known, position, 0.0)))
        count = np.add.reduceat(p.residual != 0, first, axis=0)
        return cls(known * as_vectors(np.add.reduceat(p.residual, first, axis=0)),
                   known * count[..., None].astype(float), context)


def likely_places(fit: ModelFit, starts: Iterable[AnyEffect],
                  near: Callable[[AnyEffect, AnyEffect], bool], count: int) -> list[AnyEffect]:
    """Return the starting points whose drift is likeliest beside a fit.

    Parameters
    ----------
    fit : ModelFit
        Fit without the effect.
    starts : iterable of Effect
        Starting points of one effect.
    near : callable
        Whether two starting points are too close to be both returned.
    count : int
        Maximum number of points.

    Returns
    -------
    list of Effect
        Largest score first.
    """
    found = list(starts)
    blocks = [_Blocks.of(p, fit.model) for p in fit.session_fits]
    slope, information = np.array([_score(blocks, start) for start in found]).T
    # Places that particles hardly visited must not win by chance.
    power = slope**2 / (information + 1e-3 * information.max())
    chosen: list[AnyEffect] = []
    for k in np.argsort(-power):
        if not any(near(found[k], other) for other in chosen):
            chosen.append(found[k])
        if len(chosen) == count:
            break
    return chosen


def _score(blocks: Sequence[_Blocks], start: Effect) -> tuple[float, float]:
    """Return slope and information of the likelihood in the strength of a drift of place."""
    strength = next(p for p in start.parameters() if not p.shape)
    unit = replace(start, **{strength.field: strength.from_fit(1.0)})
    slope = information = 0.0
    for block in blocks:
        push = unit.drift(block.middle)
        assert push is not None
        slope += float(np.vdot(block.residual, push))
        information += float(np.vdot(block.count, push * push))
    return slope / strength.scale, information / strength.scale**2
