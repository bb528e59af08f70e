"""What the recent command cannot distinguish, from its Fisher information.

Nothing here is compiled: `microbot info` reports it before any fit.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from microbot_ros.common.records import Session
from microbot_ros.estimation.likelihood.noise import Noise, stokes_einstein
from microbot_ros.estimation.likelihood.prepared_session import PreparedSession
from microbot_ros.model.heading import integrate_heading
from microbot_ros.model.model import Model

PARAMETERS = ('speed', 'φ', 'delay', 'drift', 'drift')
"""Rows of the information: log v, φ, delay, drift along x, drift along y."""

WEAK = 0.01
"""Fraction of its information below which a combination of parameters is not identifiable.

Choice: its standard deviation is then ten times what each parameter alone would have.
"""

_ADVICE = {
    frozenset(('φ', 'delay')): 'turn the field both ways, or in steps',
    frozenset(('speed', 'drift')): 'turn the field to other directions',
    frozenset(('φ', 'drift')): 'turn the field to other directions',
    frozenset(('delay', 'drift')): 'turn the field more often',
}
"""Pairs that a command does not distinguish → advice."""


@dataclass(frozen=True)
class Excitation:
    """What a command does not determine.

    Attributes
    ----------
    seconds : float
        Duration of the command [s].
    driven : bool
        Whether anything was driven.
    turned : bool
        Whether the command changed, so that a delay shows.
    pairs : tuple of (str, str)
        Pairs of PARAMETERS that are not distinguished, worst first.
    """

    seconds: float
    driven: bool
    turned: bool
    pairs: tuple[tuple[str, str], ...]

    @property
    def shows_delay(self) -> bool:
        """Whether a delay is distinguished from φ."""
        return self.driven and self.turned and ('φ', 'delay') not in self.pairs

    @property
    def sentences(self) -> list[str]:
        """One sentence for each open question, with a command that would settle it."""
        last = f'the last {self.seconds:.0f} s'
        if not self.driven:
            return [f'nothing was driven in {last}: speed, φ and delay are unseen']
        told = [
            f'{first} and {second} cannot be distinguished under the commands of {last}: '
            + _ADVICE.get(frozenset((first, second)), 'vary the command')
            for first, second in self.pairs
        ]
        if not self.turned:
            told.append(f'the delay is unknown: the command did not turn in {last}')
        return told


def command_excitation(session: Session) -> Excitation | None:
    """Return what the commands of a session could distinguish, before any fit.

    Assumes diffusion by Stokes–Einstein, or 0.1 µm²/s where it is unknown, and a localisation
    error of 50 nm.

    Parameters
    ----------
    session : Session
        Commands and frames.

    Returns
    -------
    Excitation or None
        None with fewer than two frames.
    """
    prepared = PreparedSession.of(session)
    if len(prepared.times) < 2:
        return None
    diffusion, _ = stokes_einstein(session.conditions) or (1e-13, 0.0)
    model = Model.baseline(session.conditions, session.commands)
    return excitation(model, prepared, 0.0, Noise(diffusion, 5e-8))


def excitation(model: Model, session: PreparedSession, delay: float, noise: Noise) -> Excitation:
    """Return what the commands of a session could distinguish.

    By the Fisher information on PARAMETERS, from one particle with v = 1 and φ = 0 that is always
    seen. Its columns are the path ∫u dt [s], the same rotated by 90°, its derivative by the delay,
    and time, for a slow drift.

    Parameters
    ----------
    model : Model
        Only its first order is used.
    session : PreparedSession
        Commands and frames.
    delay : float
        Delay of the commands [s].
    noise : Noise
        Diffusion and localisation error.

    Returns
    -------
    Excitation
        Undetermined pairs of parameters.
    """
    step = 0.5 * session.interval
    early, path, late = (_moved(model, session, delay + s) for s in (-step, 0.0, step))
    interval = np.diff(session.times).astype(complex)
    info = _information(
        np.stack([path, 1j * path, (late - early) / (2 * step), interval, 1j * interval], axis=-1),
        interval.real, noise)
    size = np.sqrt(np.diag(info))
    return Excitation(
        seconds=float(session.times[-1] - session.times[0]),
        driven=bool(size[0] > 0),
        turned=bool(size[2] > 1e-4 * size[0]),
        pairs=_confounded(info),
    )


def _moved(model: Model, session: PreparedSession, delay: float) -> np.ndarray:
    """Return ∫u dt [s] over every frame interval (T − 1,), with the commands `delay` [s] late."""
    bare = Model(model.reference_field, model.propulsion)
    late = replace(session.commands, t=session.commands.t + delay)
    segments, course, context = integrate_heading(bare, replace(session, commands=late).timeline)
    moved: np.ndarray = segments.sum(course.path * bare.speed_factor(context))[:, 0]
    return moved


def _information(columns: np.ndarray, interval: np.ndarray, noise: Noise) -> np.ndarray:
    """Return the information of increments on the amplitudes of `columns` (T − 1, M).

    Increments over an `interval` h have variance 2Dh + 2R and covariance −R with their neighbours,
    R = σ² − DE/3 (see `noise`).
    """
    from scipy.linalg import solve_banded  # 0.04 s to import; numba imports it too

    covariance = np.full((3, len(interval)), -noise.ratio)
    covariance[1] = 2 * (interval + noise.ratio)
    solved = solve_banded((1, 1), covariance, columns)
    return np.real(np.conj(columns).T @ solved) / noise.diffusion


def _confounded(info: np.ndarray) -> tuple[tuple[str, str], ...]:
    """Return pairs that a nearly singular direction of the information mixes, worst first."""
    size = np.sqrt(np.diag(info))
    present = size > 1e-9 * size.max(initial=1e-300)
    names = [name for name, there in zip(PARAMETERS, present, strict=True) if there]
    scaled = info[np.ix_(present, present)] / np.outer(size[present], size[present])
    values, vectors = np.linalg.eigh(scaled)
    pairs = []
    for value, vector in zip(values, vectors.T, strict=True):
        if value < WEAK:
            first, second = sorted(np.argsort(-np.abs(vector))[:2])
            if names[first] != names[second]:
                pairs.append((names[first], names[second]))
    return tuple(dict.fromkeys(pairs))
