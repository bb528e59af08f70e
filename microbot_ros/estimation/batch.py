"""Speed, direction and force of every particle of a recording, by maximum likelihood."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ros.common.errors import InputError
from microbot_ros.common.records import Session
from microbot_ros.estimation.identities import settle_identities
from microbot_ros.estimation.likelihood.delay import Delay, DelayedFits
from microbot_ros.estimation.likelihood.excitation import excitation
from microbot_ros.estimation.likelihood.joint import SessionFit
from microbot_ros.estimation.likelihood.model_fit import fit_sessions
from microbot_ros.estimation.likelihood.noise import Noise, implausible_diffusion, whiten
from microbot_ros.estimation.likelihood.phasor import Polar
from microbot_ros.estimation.likelihood.prepared_session import prepare
from microbot_ros.estimation.one_leg_regression import Leg, one_leg
from microbot_ros.model.model import Model

GATE = 40.0
"""Squared whitened residual above which diffusion does not explain a step: 2e-9 by chance (χ² of
2)."""

CLEAR = 5.0
"""Gain in log likelihood above which a delay is used: 0.16 % by chance (χ² of 1).

Choice: a smaller value uses delays that are not there, a larger one leaves φ wrong.
"""

_FEWEST_STEPS = 10
"""Fewest steps at a frequency for its gain to be compared. Choice: a gain of fewer says little."""
_MOST_LEVELS = 60
"""Largest number of frequencies that are levels; more are a continuous drive.

Choice: more than protocols have, fewer than a controller gives.
"""


@dataclass(frozen=True)
class GainAt:
    """Gain of all particles together at one frequency.

    Attributes
    ----------
    frequency : float
        Frequency [Hz].
    gain : complex
        Gain v e^{iφ} per frequency [m/s/Hz].
    std : float
        Standard deviation of the gain per axis [m/s/Hz].
    """

    frequency: float
    gain: complex
    std: float


@dataclass(frozen=True)
class FitResult:
    """First-order model fitted to a recording of P particles in T frames, SI.

    Attributes
    ----------
    ids : ndarray, shape (P,)
        Particles, ascending.
    polar : Polar
        Speed (rollers: gain [m/s/Hz]) and φ with standard deviations that include the delay's; NaN
        where nothing drove the particle.
    force, force_std : ndarray, shape (P,)
        Force and standard deviation [N]; NaN without radius or viscosity, and for rollers.
    noise : Noise
        D and σ at the delay.
    delay : Delay
        The delay in use.
    log_likelihood : float
        At the delay.
    legs : list of Leg
        The paper's own method for each particle.
    gains : list of GainAt
        Gains of rollers at each frequency.
    warnings : list of str
        Sentences on what makes numbers doubtful.
    measured : ndarray of complex, shape (T, P)
        Fitted tracks [m]; NaN in gaps.
    predicted : ndarray of complex, shape (T, P)
        Tracks of the model [m], from the start of each piece.
    rolling : bool
        Whether the particles are rollers.
    """

    ids: np.ndarray
    polar: Polar
    force: np.ndarray
    force_std: np.ndarray
    noise: Noise
    delay: Delay
    log_likelihood: float
    legs: list[Leg]
    gains: list[GainAt]
    warnings: list[str]
    measured: np.ndarray
    predicted: np.ndarray
    rolling: bool


def fit(session: Session, exposure: float = 0.0) -> FitResult:
    """Fit v and φ of every particle, D and σ, and the delay where the commands determine it.

    Parameters
    ----------
    session : Session
        The recording.
    exposure : float, optional
        Exposure of a frame [s].

    Returns
    -------
    FitResult
        Estimates with standard deviations.

    Raises
    ------
    InputError
        If there are too few frames.
    """
    session, settled = settle_identities(session)
    prepared = prepare(session)
    if len(prepared.times) < 4 or prepared.seen.sum() - prepared.seen.any(axis=0).sum() < 3:
        raise InputError(session.name, 'expected at least 4 frames after the first field with a '
                         'particle seen in them')
    model = Model.baseline(session.conditions, session.commands)
    fits = DelayedFits(model, prepared)
    plain = fit_sessions(model, [prepared]).session_fits[0]
    noise = plain.noise(exposure)
    excited = excitation(model, prepared, 0.0, noise)
    best, delay = _with_delay(model, fits, plain) if excited.shows_delay else (plain, Delay())
    slope = fits.log_phasor_slope(delay.value, best.whitening.noise_ratio)
    if best is not plain:
        noise = best.noise(exposure)
    speeds = best.polar().widened(delay.felt(slope)).of(best.session.main)
    warnings = [*session.remarks, *settled, *_steps(best), *excited.sentences]
    if ('φ', 'delay') in excited.pairs:
        warnings.append(
            f'φ is stated for no delay; every 0.1 s of delay would add '
            f'{np.degrees(slope.imag) / 10:+.1f}° to it'
        )
    warnings += implausible_diffusion(session.conditions, noise)
    gains = _gains(best, noise) if model.propulsion == 'rolling' else []
    warnings += _uneven(gains)
    force, force_std = speeds.force(session.conditions)
    return FitResult(
        np.unique(prepared.ids), speeds, force, force_std, noise, delay, best.log_likelihood,
        one_leg(session), gains, warnings,
        _of_particles(np.where(best.session.seen, best.session.z, np.nan), best.session.ids),
        _of_particles(_predicted(best), best.session.ids), model.propulsion == 'rolling',
    )


def _with_delay(model: Model, fits: DelayedFits, plain: SessionFit) -> tuple[SessionFit, Delay]:
    """Return the fit at the delay that the data support; else at none."""
    *_, found = fits.posterior(plain.whitening.noise_ratio)
    if found is None or not found.determined:
        return plain, Delay()
    delayed = fit_sessions(model, [fits.session(found.value)]).session_fits[0]
    if delayed.log_likelihood - plain.log_likelihood < CLEAR:
        return plain, Delay(0.0, found.std)
    return delayed, found


def _steps(fit: SessionFit) -> list[str]:
    """Return a sentence on each particle that jumped, or moved by more than diffusion explains."""
    session = fit.session
    names, owner = np.unique(session.ids, return_inverse=True)
    large = np.bincount(owner, (np.abs(fit.residual) ** 2 > GATE).sum(axis=0))
    return [
        f'particle {name}: {count:.0f} steps are too large for diffusion {what}'
        for counts, what in (
            (session.jumps, 'and were left out: the stage moved, or tracking was lost'),
            (large, 'but were kept: tracking was lost, or the speed is not constant'))
        for name, count in zip(names, counts, strict=True) if count
    ]


def _gains(fit: SessionFit, noise: Noise) -> list[GainAt]:
    """Return the gains at all frequencies, fitted together; none for a continuous drive."""
    session = fit.session
    frequency = np.abs(session.commands.frequency_at(session.times[:-1]))
    path = np.diff(fit.expected.along[:, 0])
    levels, counts = np.unique(frequency[frequency > 0], return_counts=True)
    levels = levels[counts > _FEWEST_STEPS]
    if not 0 < len(levels) <= _MOST_LEVELS:
        return []
    columns = [np.append(0, np.cumsum(np.where(frequency == level, path, 0)))
               for level in levels]
    together = np.stack(
        [session.z, *(np.broadcast_to(c[:, None], session.z.shape) for c in columns)], axis=-1)
    white = whiten(together, session.times, noise, session.pieces)
    white = white.reshape(-1, white.shape[-1])
    gains = np.linalg.lstsq(white[:, 1:], white[:, 0], rcond=None)[0]
    power = np.conj(white[:, 1:]).T @ white[:, 1:]
    spread = np.linalg.pinv(power).diagonal().real
    return [GainAt(float(level), complex(gain), float(np.sqrt(variance)))
            for level, gain, variance in zip(levels, gains, spread, strict=True) if variance > 0]


def _uneven(gains: list[GainAt]) -> list[str]:
    """Return a sentence if gains differ between frequencies by more than their errors."""
    if len(gains) < 2:
        return []
    gain, weight = np.array([one.gain for one in gains]), np.array([one.std**-2 for one in gains])
    mean = (weight * gain).sum() / weight.sum()
    chi_square = float((weight * np.abs(gain - mean) ** 2).sum())
    # χ² of two axes per further frequency; its mean is 2 each, and 10 each never by chance.
    if chi_square < 10 * (len(gains) - 1):
        return []
    ends = ' and '.join(f'{abs(one.gain) * 1e6:.2f} µm/s/Hz at {one.frequency:g} Hz'
                        for one in (gains[0], gains[-1]))
    return [f'the gain is not constant in frequency: {ends}; `microbot response` measures it at '
            'each']


def _of_particles(tracks: np.ndarray, ids: np.ndarray) -> np.ndarray:
    """Join the tracks (T, N) of particles `ids` (N,), never two at once, to one each: (T, P)."""
    joined = np.full((len(tracks), len(np.unique(ids))), np.nan + 0j)
    for track, n in zip(tracks.T, np.unique(ids, return_inverse=True)[1], strict=True):
        joined[:, n] = np.where(np.isnan(track), joined[:, n], track)
    return joined


def _predicted(fit: SessionFit) -> np.ndarray:
    """Return the tracks (T, N) of the model, each piece from its start."""
    pieces, moved = fit.session.pieces, fit.expected.at(fit.velocity_phasor)
    predicted = np.full(pieces.shape, np.nan + 0j)
    for n, piece in enumerate(pieces.T):
        for name in np.unique(piece[piece > 0]):
            rows = np.flatnonzero(piece == name)
            own = slice(rows[0], rows[-1] + 1)
            predicted[own, n] = fit.session.z[rows[0], n] + moved[own, n] - moved[rows[0], n]
    return predicted
