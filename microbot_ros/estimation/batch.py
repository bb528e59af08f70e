"""Speed, direction and force of every particle of a recording, by maximum likelihood."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from microbot_ros.errors import InputError
from microbot_ros.estimation.commands import model_paths
from microbot_ros.estimation.delay import Delay, DelayedLikelihood
from microbot_ros.estimation.noise import GainFit, Noise, whiten
from microbot_ros.estimation.phasor import Polar, polar
from microbot_ros.estimation.recipe import Leg, one_leg
from microbot_ros.model.model import Model
from microbot_ros.model.particle import Fluid, translational_diffusion
from microbot_ros.records import Session

GATE = 40.0
"""Squared whitened innovation beyond which a step of a track is a jump: 2e-9 by chance."""

CLEAR = 5.0
"""Gain in log likelihood above which a delay is used: 0.16 % by chance."""

BANDS_HZ = (0.0, 2.0, 5.0, 10.0, 20.0, np.inf)
"""Rotation frequencies between which gains of rollers are compared."""

DRAG_RELATIVE_STD = 0.07
"""What is not known of 6πηr: 5 % of viscosity and 5 % of radius."""


@dataclass(frozen=True)
class Band:
    """Gain c (complex, m/s/Hz) of all particles together in one band of frequencies."""

    low: float
    high: float
    gain: complex
    std: float


@dataclass(frozen=True)
class Fit:
    """The first-order model fitted to a recording; arrays over `ids` (N,), SI.

    `swims` holds speed (rollers: gain [m/s/Hz]) and φ with standard deviations that include the
    delay's; NaN where nothing excited them. `force`, `force_std` [N] are NaN without radius or
    viscosity and for rollers. `delay` is the one used. `prediction` (T, N) complex: the model from
    every particle's first sighting on, at `times` (T,), beside the measured `z` (T, N).
    """

    ids: np.ndarray
    swims: Polar
    force: np.ndarray
    force_std: np.ndarray
    noise: Noise
    delay: Delay
    legs: list[Leg]
    bands: list[Band]
    warnings: list[str]
    times: np.ndarray
    z: np.ndarray
    prediction: np.ndarray
    rolling: bool


def fit(session: Session, exposure: float = 0.0) -> Fit:
    """Fit v, φ of every particle, D and σ, and the delay where the commands allow it.

    `exposure` [s] of a frame. Raises InputError where there is too little to fit.
    """
    times, positions = session.tracks.grid()
    measured = positions[..., 0] + 1j * positions[..., 1]
    if len(times) < 4 or np.isfinite(measured).sum() - measured.shape[1] < 3:
        raise InputError(session.name, 'expected at least 4 frames with a particle seen in them')
    model = Model.baseline(session.conditions, session.commands)
    z, warnings = _without_jumps(session, model, times, measured, exposure)
    record = DelayedLikelihood(model, session.commands, times, z, exposure)
    plain = record.at(0.0).maximum()
    excited = record.excitation(0.0, plain.noise)
    best, delay = _with_delay(record, plain) if excited.shows_delay else (plain, Delay())
    turn = record.turn(delay.value, best.noise)
    spread = np.sqrt(np.where(np.isfinite(best.gain), best.variance, np.nan))
    swims = polar(best.gain, spread).widened(turn, delay.std)
    warnings += excited.sentences
    if ('φ', 'delay') in excited.pairs:
        warnings.append(
            f'φ is stated for no delay; every 0.1 s of delay would add '
            f'{np.degrees(turn.imag) / 10:+.1f}° to it'
        )
    warnings += _against_stokes_einstein(session, best.noise)
    bands = _bands(session, model, times, z, best.noise) if model.propulsion == 'rolling' else []
    warnings += _uneven(bands)
    force, force_std = swims.force(session.conditions, DRAG_RELATIVE_STD)
    drive = record.drive(delay.value)
    return Fit(
        session.tracks.particles, swims, force, force_std, best.noise, delay, one_leg(session),
        bands, warnings, times, z, _predicted(z, best.gain * drive), model.propulsion == 'rolling',
    )


def _with_delay(record: DelayedLikelihood, plain: GainFit) -> tuple[GainFit, Delay]:
    """The fit at the delay that the data demand; at none where they do not."""
    found = next((d for d in reversed(list(record.delay(plain.noise))) if d), Delay())
    if not found.determined:
        return plain, Delay()
    delayed = record.at(found.value).maximum()
    if delayed.log_likelihood - plain.log_likelihood < CLEAR:
        return plain, Delay(0.0, found.std)
    return delayed, found


def _without_jumps(
    session: Session, model: Model, times: np.ndarray, z: np.ndarray, exposure: float,
) -> tuple[np.ndarray, list[str]]:
    """Tracks with the steps taken out that no diffusion explains, and a sentence on each track."""
    z, jumps = z.copy(), np.zeros(z.shape, bool)
    drive = np.broadcast_to(model_paths(model, session.commands, times).drive, z.shape)
    for _ in range(20):
        best = DelayedLikelihood(model, session.commands, times, z, exposure).at(0.0).maximum()
        new = (np.abs(best.residual) ** 2 > GATE) & ~jumps
        if not new.any():
            break
        jumps |= new
        moved = z - np.where(np.isfinite(best.gain), best.gain, 0) * drive
        for n in np.flatnonzero(new.any(axis=0)):
            rows = np.flatnonzero(np.isfinite(z[:, n]))
            step = np.where(new[rows[1:], n], np.diff(moved[rows, n]), 0)
            z[rows[1:], n] -= np.cumsum(step)
    return z, [
        f'particle {name}: {count} steps are too large for diffusion and were left out: '
        'the stage moved, tracking was lost, or the speed is not constant'
        for name, count in zip(session.tracks.particles, jumps.sum(axis=0), strict=True) if count
    ]


def _bands(
    session: Session, model: Model, times: np.ndarray, z: np.ndarray, noise: Noise,
) -> list[Band]:
    """One gain per band of frequencies, all fitted together."""
    commands = session.commands
    frequency = commands.frequency_at(times[:-1])
    drive = np.diff(model_paths(model, commands, times).drive[:, 0])
    inside = [
        (frequency > low) & (frequency <= high)
        for low, high in pairwise(BANDS_HZ)
    ]
    used = [k for k, mask in enumerate(inside) if mask.sum() > 10]
    columns = [np.append(0, np.cumsum(np.where(inside[k], drive, 0))) for k in used]
    levels = np.stack(
        [z, *(np.broadcast_to(c[:, None], z.shape) for c in columns)], axis=-1
    )
    white = whiten(np.nan_to_num(levels), times, noise, np.isfinite(z)).columns
    white = white.reshape(-1, white.shape[-1])
    gains = np.linalg.lstsq(white[:, 1:], white[:, 0], rcond=None)[0]
    spread = np.linalg.inv(np.conj(white[:, 1:]).T @ white[:, 1:]).diagonal().real
    return [
        Band(BANDS_HZ[k], BANDS_HZ[k + 1], complex(gain), float(np.sqrt(variance)))
        for k, gain, variance in zip(used, gains, spread, strict=True)
    ]


def _uneven(bands: list[Band]) -> list[str]:
    """A sentence where gains differ between bands beyond their spread."""
    if len(bands) < 2:
        return []
    gain, weight = np.array([b.gain for b in bands]), np.array([b.std**-2 for b in bands])
    mean = (weight * gain).sum() / weight.sum()
    excess = float((weight * np.abs(gain - mean) ** 2).sum())
    # χ² of two axes per further band; the mean of it is 2 per band, and 10 per band never.
    if excess < 10 * (len(bands) - 1):
        return []
    values = ', '.join(
        f'{abs(b.gain) * 1e6:.2f} from {b.low:g} to {b.high:g} Hz' for b in bands
    )
    return [f'the gain is not constant in frequency: {values} (µm/s/Hz)']


def _against_stokes_einstein(session: Session, noise: Noise) -> list[str]:
    radius, viscosity = session.conditions.radius, session.conditions.viscosity
    if not (radius and viscosity):
        return []
    fluid = Fluid(viscosity, session.conditions.temperature or 298.15)
    expected = translational_diffusion(fluid, radius)
    if abs(noise.diffusion - expected) < max(4 * noise.diffusion_std, 0.2 * expected):
        return []
    return [
        f'D is {noise.diffusion * 1e12:.3g} µm²/s where Stokes–Einstein gives '
        f'{expected * 1e12:.3g}: radius or viscosity are off, or something moves the particles'
    ]


def _predicted(z: np.ndarray, moved: np.ndarray) -> np.ndarray:
    """The model's tracks (T, N) from every particle's first sighting on."""
    first = np.isfinite(z).argmax(axis=0), np.arange(z.shape[1])
    return z[first] + moved - moved[first]
