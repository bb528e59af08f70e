"""Proof on data that a fit did not see: the gap in prediction, and the gain in likelihood."""

from __future__ import annotations

import numpy as np

from microbot_ros.discovery.result import Gap
from microbot_ros.discovery.search import compare
from microbot_ros.discovery.stepwise_selection import without
from microbot_ros.estimation.likelihood import SessionFit
from microbot_ros.estimation.model_fit import ModelFit, evaluate, maximise
from microbot_ros.model.model import Model

HORIZON = 1.0
"""Seconds ahead of which a prediction is judged, where the recording is long enough."""

BLOCKS = 5
"""Blocks of time that are predicted in turn, each from all others."""

HALVES = 4
"""Blocks of time that make the two halves of a split likelihood, every other one."""


def _block(p: SessionFit, blocks: int) -> np.ndarray:
    """The block (T,) of every frame."""
    times = p.session.times
    return np.minimum((times - times[0]) / np.ptp(times) * blocks, blocks - 1).astype(int)


def _on(fit: ModelFit, model: Model, frames: list[np.ndarray]) -> ModelFit:
    """Another model, with the same noise, on some frames of the same sessions; not fitted."""
    sessions = [
        p.session.seen_only_in(chosen) for p, chosen in zip(fit.session_fits, frames, strict=True)]
    return evaluate(model, sessions, [p.whitening for p in fit.session_fits])


def log_e_value(fit: ModelFit, effect: str) -> float:
    """Log split-likelihood ratio for an `effect` of a `fit` (Wasserman et al. 2020), natural.

    Each half of the recording is judged with the effects as fitted to the other half, against the
    best that the model without this one can do; the mean of both ratios exceeds 20 by chance at
    most one time in 20. v and φ are fitted to each half: they belong to both models.
    """
    logs = []
    for half in (0, 1):
        train = [_block(p, HALVES) % 2 == half for p in fit.session_fits]
        test = [~chosen for chosen in train]
        learned = maximise(_on(fit, fit.model, train)).model
        rest = without(_on(fit, fit.model, test), effect)
        logs.append((rest.cost - _on(fit, learned, test).cost) / 2)
    return float(np.logaddexp(logs[0], logs[1]) - np.log(2))


def held_out_gap(before: ModelFit, after: ModelFit, truth: Model | None = None) -> Gap:
    """Open-loop prediction over a horizon, each block predicted from a fit to all others.

    `before` and `after` are the fits without and with what was found. As the excess of one axis
    over what diffusion and localisation alone give; both are those of `after`. The effects of
    `truth`, where it is known, are not fitted. What depends on position is taken where the
    particles were.
    """
    shortest = min(float(np.ptp(p.session.times)) for p in after.session_fits)
    horizon = min(HORIZON, shortest / (2 * BLOCKS))
    models = [before.model, after.model, *([truth] if truth else [])]
    errors: list[list[np.ndarray]] = [[] for _ in models]
    for block in range(BLOCKS):
        inside = [_block(p, BLOCKS) == block for p in after.session_fits]
        for model, found in zip(models, errors, strict=True):
            rest = _on(after, model, [~frames for frames in inside])
            learned = rest if model is truth else _learned(rest)
            found += [
                _errors(p, whole, frames, horizon)
                for p, whole, frames in zip(
                    learned.session_fits, after.session_fits, inside, strict=True)
            ]
    floor = _floor(after, horizon)
    excess = [_excess(np.concatenate(found), floor) for found in errors]
    return Gap(horizon, excess[0], excess[1], floor, excess[2] if truth else float('nan'))


def _learned(fit: ModelFit) -> ModelFit:
    """Fitted, without spots and swings that these frames do not show: they would be made up."""
    learned = maximise(fit)
    for effect in learned.model.effects:
        if any(p.shape for p in effect.parameters()):
            rest = maximise(learned.under(learned.model.without(effect.id)))
            found = compare(learned, rest, effect.id)
            learned = learned if found.delta_bic > 0 and found.shape_seen else rest
    return learned


def _excess(errors: np.ndarray, floor: float) -> float:
    return float(np.sqrt(max(np.mean(errors**2) - floor**2, 0.0))) if errors.size else float('nan')


def _errors(learned: SessionFit, whole: SessionFit, frames: np.ndarray,
            horizon: float) -> np.ndarray:
    """Of the displacements over the horizon within some frames (T,), both axes, flat."""
    e = whole.session
    ahead = max(round(horizon / e.interval), 1)
    left = e.z - learned.expected.at(learned.velocity_phasor)
    seen = e.seen & frames[:, None]
    both = seen[ahead:] & seen[:-ahead] & _known(learned, horizon)
    error = (left[ahead:] - left[:-ahead])[both]
    return np.concatenate([error.real, error.imag])


def _known(learned: SessionFit, horizon: float) -> np.ndarray:
    """Tracks (N,) of particles that were seen enough elsewhere for their v and φ to be of use."""
    std = np.minimum(learned.phasor_std, 1.0)[learned.session.owner]
    step = np.diff(learned.session.times)[:, None]
    own = np.abs(np.diff(learned.expected.along, axis=0)) / step
    travelled = horizon * np.sqrt((own**2).mean(axis=0))
    known: np.ndarray = std * travelled < 0.5 * np.sqrt(2 * learned.diffusion * horizon)
    return known


def _floor(fit: ModelFit, horizon: float) -> float:
    """√(2D·horizon + 2σ²), averaged over sessions."""
    values = [
        2 * p.diffusion * (max(round(horizon / p.session.interval), 1) * p.session.interval)
        + 2 * max(p.whitening.noise_ratio, 0.0) * p.diffusion
        for p in fit.session_fits
    ]
    return float(np.sqrt(np.average(values, weights=[p.count for p in fit.session_fits])))
