"""Whether rollers' gain follows a curve in frequency, judged by how levels scatter about it.

Real surfaces make the gain differ from one stretch of a recording to the next by more than the
noise within it. So the gain at every level of the drive is one number, and numbers scatter about
the curve by an amount that is fitted too (random effects: DerSimonian and Laird 1986).
"""

from __future__ import annotations

import numpy as np

from microbot_ros.discovery.stepwise_selection import without
from microbot_ros.discovery.tail_probabilities import chi_square_tail
from microbot_ros.estimation.likelihood import SessionFit
from microbot_ros.estimation.model_fit import ModelFit
from microbot_ros.model.effect_context import EffectContext

FEWEST = 10
"""Levels from which both a curve and the scatter about it can be told."""


def curve_p_value(fit: ModelFit, name: str) -> float:
    """Chance that gains which scatter about a constant follow a curve so much better.

    That of the effect `name` of a `fit`; ValueError where it has none.
    """
    effect = fit.model.effect(name)
    if effect is None or not effect.is_drive_curve:
        raise ValueError(f'the fit has no curve {name}')
    rest = without(fit, name)
    gains = np.concatenate([_gains(p) for p in rest.session_fits])
    if len(gains) < FEWEST:
        return 1.0
    frequency, gain, std = gains.T
    nothing = np.zeros(len(gains))
    context = EffectContext(nothing, nothing, np.zeros((len(gains), 2)), frequency,
                  fit.model.reference_field)
    ratio = 2 * (scattered(gain, std, np.asarray(effect.speed_factor(context)))
                 - scattered(gain, std, np.ones(len(gains))))
    return chi_square_tail(ratio, min(len(effect.parameters()), len(gains) - 1))


def _gains(p: SessionFit) -> np.ndarray:
    """Frequency, gain relative to proportional rolling, its std: a row for every level."""
    e = p.session
    frequency = np.abs(e.commands.frequency_at(e.times[:-1]))
    moves = np.diff(p.expected.at(p.velocity_phasor) - p.expected.offset, axis=0)
    rows = []
    for level in np.unique(frequency[frequency > 0]):
        steps = np.where((frequency == level)[:, None], moves, 0)
        column = np.concatenate([np.zeros((1, steps.shape[1])), steps.cumsum(axis=0)])
        white = p.whiten(np.broadcast_to(column, e.z.shape)[..., None])[..., 0]
        power = float((np.abs(white) ** 2).sum())
        if power > 0:
            found = (white.conj() * p.white[..., 0]).real.sum() / np.sqrt(p.diffusion) / power
            rows.append((level, found, power**-0.5))
    return np.array(rows).reshape(-1, 3)


def scattered(gain: np.ndarray, std: np.ndarray, curve: np.ndarray) -> float:
    """Log likelihood of gains about a multiple of a curve, with the best scatter beside noise.

    `gain` ± `std` and `curve`, each (L,): one for every level of the drive.
    """
    from scipy.optimize import minimize_scalar

    def cost(log_scatter: float) -> float:
        variance = std**2 + np.exp(2 * log_scatter)
        scale = (curve * gain / variance).sum() / (curve**2 / variance).sum()
        return float(0.5 * (np.log(variance) + (gain - scale * curve) ** 2 / variance).sum())

    return -float(minimize_scalar(cost, bounds=(-12.0, 3.0), method='bounded').fun)
