"""Proof on data that a fit did not see: the gap in prediction, and the gain in likelihood."""

from __future__ import annotations

import numpy as np

from microbot_ros.discovery.ladder import without
from microbot_ros.discovery.likelihood import Fit, Part, evaluate, maximise
from microbot_ros.discovery.result import Gap
from microbot_ros.discovery.search import found_in
from microbot_ros.model.model import Model

HORIZON = 1.0
"""Seconds ahead of which a prediction is judged, where the recording is long enough."""

BLOCKS = 5
"""Blocks of time that are predicted in turn, each from all others."""

HALVES = 4
"""Blocks of time that make the two halves of a split likelihood, every other one."""


def _block(p: Part, blocks: int) -> np.ndarray:
    """The block (T,) of every frame."""
    times = p.evidence.times
    return np.minimum((times - times[0]) / np.ptp(times) * blocks, blocks - 1).astype(int)


def _on(fit: Fit, model: Model, frames: list[np.ndarray] | None = None) -> Fit:
    """Another model, with the same noise, on some frames of the same sessions; not fitted."""
    evidences = [p.evidence for p in fit.parts]
    if frames is not None:
        evidences = [e.within(chosen) for e, chosen in zip(evidences, frames, strict=True)]
    return evaluate(model, evidences, [p.whitening for p in fit.parts])


def log_e_value(fit: Fit, effect: str) -> float:
    """Natural logarithm of the split-likelihood ratio for an effect (Wasserman et al. 2020).

    Each half of the recording is judged with the effects as fitted to the other half, against the
    best that the model without this one can do; the mean of both ratios exceeds 20 by chance at
    most one time in 20. v and φ are fitted to each half: they belong to both models.
    """
    logs = []
    for half in (0, 1):
        train = [_block(p, HALVES) % 2 == half for p in fit.parts]
        test = [~chosen for chosen in train]
        learned = maximise(_on(fit, fit.model, train)).model
        rest = without(_on(fit, fit.model, test), effect)
        logs.append((rest.cost - _on(fit, learned, test).cost) / 2)
    return float(np.logaddexp(logs[0], logs[1]) - np.log(2))


def held_out_gap(before: Fit, after: Fit, truth: Model | None = None) -> Gap:
    """Open-loop prediction over a horizon, each block predicted from a fit to all others.

    As the excess of one axis over what diffusion and localisation alone give; both are those of
    `after`. The effects of `truth`, where it is known, are not fitted. What depends on position
    is taken where the particles were.
    """
    shortest = min(float(np.ptp(p.evidence.times)) for p in after.parts)
    horizon = min(HORIZON, shortest / (2 * BLOCKS))
    models = [before.model, after.model, *([truth] if truth else [])]
    errors: list[list[np.ndarray]] = [[] for _ in models]
    for block in range(BLOCKS):
        inside = [_block(p, BLOCKS) == block for p in after.parts]
        for model, found in zip(models, errors, strict=True):
            rest = _on(after, model, [~frames for frames in inside])
            learned = rest if model is truth else _learned(rest)
            found += [
                _errors(p, whole, frames, horizon)
                for p, whole, frames in zip(learned.parts, after.parts, inside, strict=True)
            ]
    floor = _floor(after, horizon)
    excess = [
        _excess(np.concatenate(found), floor)
        for found in errors
    ]
    return Gap(horizon, excess[0], excess[1], floor, excess[2] if truth else float('nan'))


def _learned(fit: Fit) -> Fit:
    """Fitted, without spots and swings that these frames do not show: they would be made up."""
    learned = maximise(fit)
    for effect in learned.model.effects:
        if any(p.shape for p in effect.parameters()):
            rest = maximise(_on(learned, learned.model.without(effect.id)))
            found = found_in(learned, rest, effect.id)
            learned = learned if found.delta_bic > 0 and found.whole else rest
    return learned


def _excess(errors: np.ndarray, floor: float) -> float:
    return float(np.sqrt(max(np.mean(errors**2) - floor**2, 0.0))) if errors.size else float('nan')


def _errors(learned: Part, whole: Part, frames: np.ndarray, horizon: float) -> np.ndarray:
    """Of the displacements over the horizon within some frames (T,), both axes, flat."""
    e = whole.evidence
    ahead = max(round(horizon / e.interval), 1)
    left = e.z - learned.levels.moved(learned.swim)
    seen = e.seen & frames[:, None]
    both = seen[ahead:] & seen[:-ahead] & _known(learned, horizon)
    error = (left[ahead:] - left[:-ahead])[both]
    return np.concatenate([error.real, error.imag])


def _known(learned: Part, horizon: float) -> np.ndarray:
    """Tracks (N,) of particles that were seen enough elsewhere for their v and φ to be of use."""
    power = np.trace(learned.gram[:, 1:, 1:], axis1=1, axis2=2) / 2
    std = np.sqrt(learned.diffusion / np.maximum(power, 1e-300))[learned.evidence.owner]
    step = np.diff(learned.evidence.times)[:, None]
    own = np.abs(np.diff(learned.levels.along, axis=0)) / step
    travelled = horizon * np.sqrt((own**2).mean(axis=0))
    known: np.ndarray = std * travelled < 0.5 * np.sqrt(2 * learned.diffusion * horizon)
    return known


def _floor(fit: Fit, horizon: float) -> float:
    """√(2D·horizon + 2σ²), averaged over sessions."""
    values = [
        2 * p.diffusion * (max(round(horizon / p.evidence.interval), 1) * p.evidence.interval)
        + 2 * max(p.whitening.excess, 0.0) * p.diffusion
        for p in fit.parts
    ]
    return float(np.sqrt(np.average(values, weights=[p.count for p in fit.parts])))
