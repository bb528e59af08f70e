"""Where a search may begin: coarse looks at white residuals, before a few places are fitted.

What swings shows in a periodogram. For what pushes at a place, residuals are summed over blocks
of time in which a particle hardly moves: a slow field passes the whitening filter as a constant
times itself, so that the score against it needs no filter: (Σ R·v)² / Σ n|v|².
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
"""Frequencies looked at for every independent one."""

BLOCK = 1.0
"""Seconds over which residuals are summed."""


def rotating_components(
    times: np.ndarray, signal: np.ndarray, fastest: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Frequencies (F,) [Hz] and the components (F,) of a `signal` that rotate either way.

    Σ s e^{∓iωt} of a complex `signal` (T,) at `times` (T,) [s], forwards and backwards, from one
    period a recording to `fastest` [Hz]. Frames are put on an even grid of the usual interval,
    half of which no period comes near.
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


@dataclass(frozen=True)
class _Blocks:
    """Sums of white residuals and their number, (B, N, 2) and (B, N, 1), and the middles."""

    residual: np.ndarray
    count: np.ndarray
    middle: EffectContext

    @classmethod
    def of(cls, p: SessionFit, model: Model) -> _Blocks:
        times, commands = p.session.times, p.session.commands
        first = np.unique(((times - times[0]) / BLOCK).astype(int), return_index=True)[1]
        middle = (first + np.append(first[1:], len(times))) // 2
        t = times[middle]
        context = EffectContext(
            t[:, None], np.zeros((len(t), 1)), model.field(commands.field_at(t)[:, None]),
            commands.frequency_at(t)[:, None], model.reference_field,
            Places(p.session.causal_positions[middle]))
        count = np.add.reduceat(p.residual != 0, first, axis=0)
        return cls(as_vectors(np.add.reduceat(p.residual, first, axis=0)), count[..., None],
                   context)


def likely_places(fit: ModelFit, starts: Iterable[AnyEffect],
                  near: Callable[[AnyEffect, AnyEffect], bool], count: int) -> list[AnyEffect]:
    """The `count` of `starts` whose drift is likeliest beside a `fit`, best first.

    None of them `near` another.
    """
    found = list(starts)
    blocks = [_Blocks.of(p, fit.model) for p in fit.session_fits]
    slope, information = np.array([_score(blocks, start) for start in found]).T
    # Where hardly anybody came by, nothing can be seen.
    power = slope**2 / (information + 1e-3 * information.max())
    chosen: list[AnyEffect] = []
    for k in np.argsort(-power):
        if not any(near(found[k], other) for other in chosen):
            chosen.append(found[k])
        if len(chosen) == count:
            break
    return chosen


def _score(blocks: Sequence[_Blocks], start: Effect) -> tuple[float, float]:
    """Slope and information of the strength of a drift."""
    strength = next(p for p in start.parameters() if not p.shape)
    unit = replace(start, **{strength.field: strength.from_fit(1.0)})
    slope = information = 0.0
    for block in blocks:
        drift = unit.drift(block.middle)
        push = np.zeros(2) if drift is None else np.nan_to_num(drift) / strength.scale
        slope += float((block.residual * push).sum())
        information += float((block.count * push**2).sum())
    return slope, information
