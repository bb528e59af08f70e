"""Map from the commanded to the actual field, from the directions of swimming particles.

Tracks determine the direction of B = M B_cmd + b. The strength of the y coils relative to the x
coils, their skew, and b relative to the field bend the path differently for each direction of the
command. A common factor of the field has no effect, and a common rotation is part of φ of every
particle: neither is fitted, so M keeps B_cmd along x.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from microbot_ros.common.errors import InputError
from microbot_ros.common.records import Session
from microbot_ros.common.units import from_si
from microbot_ros.discovery.check.input_checks import check_sessions
from microbot_ros.discovery.check.score_tests import residual_maps
from microbot_ros.discovery.result import Estimate
from microbot_ros.estimation.likelihood.model_fit import ModelFit, fit_sessions
from microbot_ros.model.effects import EFFECTS
from microbot_ros.model.model import Model

SOUGHT = ('coil_gain_mismatch', 'coil_misalignment', 'background_field')
"""Effects that make up the map."""

BESIDE = ('uniform_drift', 'command_delay')
"""Effects fitted as well, since they bend paths too."""

KNOWN = 0.1
"""Standard deviation of gain ratio or skew above which the map is refused: 3° of direction.

Choice: a smaller value refuses short recordings, a larger one returns maps of little use.
"""

PLAUSIBLE = 3.0
"""Ratio of the coil pairs above which the map is refused: a coil is then dead or reversed.

Choice: pairs of one rig are built alike to better than this.
"""

CLEARLY = 10.0
"""Gain in −2 log likelihood above which a mirrored command is the right one.

Choice: odds of 150 to 1.
"""

_BINS = 24
"""Bins of the command's direction in the figure. Choice: 15° each, enough for two harmonics."""


@dataclass(frozen=True)
class Deviations:
    """Deviation of particles from the command, in K bins of its direction.

    Attributes
    ----------
    commanded : ndarray, shape (K,)
        Mean direction of the command in each bin [rad].
    deviation, std : ndarray, shape (K,)
        Deviation of the motion from it, and standard deviation [rad].
    """

    commanded: np.ndarray
    deviation: np.ndarray
    std: np.ndarray


@dataclass(frozen=True)
class CoilMap:
    """Map B = M B_cmd + b of the coils, up to a common factor and a common rotation.

    Attributes
    ----------
    gain_ratio : Estimate
        Gain of the y coils relative to the x coils.
    skew : Estimate
        Lean of the y coils towards +x [rad].
    matrix : ndarray, shape (2, 2)
        M.
    offset, offset_std : ndarray, shape (2,)
        b and its standard deviation [T].
    strength : float
        Median field of the commands [T].
    unexplained : tuple of str
        Covariates on which the residual still depends.
    deviations : Deviations
        The fitted directions, for a figure.
    """

    gain_ratio: Estimate
    skew: Estimate
    matrix: np.ndarray
    offset: np.ndarray
    offset_std: np.ndarray
    strength: float
    unexplained: tuple[str, ...]
    deviations: Deviations

    def expected(self, direction: np.ndarray) -> np.ndarray:
        """Return the deviation of the field from the command.

        Parameters
        ----------
        direction : ndarray
            Commanded directions [rad], of any shape.

        Returns
        -------
        ndarray
            Deviations [rad] of the same shape, at the median field.
        """
        command = self.strength * np.stack([np.cos(direction), np.sin(direction)], axis=-1)
        field = command @ self.matrix.T + self.offset
        turned: np.ndarray = np.arctan2(field[..., 1], field[..., 0]) - direction
        return (turned + np.pi) % (2 * np.pi) - np.pi

    def summary(self) -> dict[str, object]:
        """Return the numbers for a JSON file, and what tracks do not determine.

        Returns
        -------
        dict
            Numbers in the units of their names.
        """
        return {
            'gain_ratio': self.gain_ratio.as_json('gain_ratio'),
            'skew_rad': self.skew.as_json('skew_rad'),
            'background_mT': from_si('_mT', self.offset).tolist(),
            'background_std_mT': from_si('_mT', self.offset_std).tolist(),
            'unexplained': list(self.unexplained),
            'not_determined': ['strength of the x coils', 'common turn of all coils',
                               'each coil of a pair by itself'],
        }


def coil_map(session: Session) -> CoilMap:
    """Fit the map to a session of catalytic particles.

    Parameters
    ----------
    session : Session
        Commands in many directions, with tracks.

    Returns
    -------
    CoilMap
        The map with its uncertainty.

    Raises
    ------
    InputError
        If particles do not swim along the field, a coil is reversed, or the map is not determined.
    """
    name = session.name or 'session'
    if session.conditions.propulsion != 'catalytic':
        raise InputError(name, 'expected catalytic particles, which move along the field; found '
                               f'{session.conditions.propulsion}')
    fit = _fit(session)
    mirrored = replace(session.commands, field=session.commands.field * (1.0, -1.0))
    if _fit(replace(session, commands=mirrored)).cost < fit.cost - CLEARLY:
        raise InputError(name, 'expected particles that turn with the command; they turn '
                               'against it: a pair of coils is reversed, or bx_mT and by_mT '
                               'are swapped, or the image is mirrored. Tracks cannot tell '
                               'which')
    covariance = _covariance(fit)
    gain, skew = (_estimate(fit, covariance, effect) for effect in SOUGHT[:2])
    _refuse_unknown(name, gain, skew)
    offset = fit.model.field(np.zeros(2))
    matrix = (fit.model.field(np.eye(2)) - offset).T
    strength = np.hypot(*session.commands.field.T)
    return CoilMap(
        gain, skew, matrix, offset, _offset_std(fit, covariance, matrix),
        float(np.median(strength[strength > 0])),
        tuple(m.against for m in residual_maps(fit) if m.fires), _deviations(fit))


def _fit(session: Session) -> ModelFit:
    prepared, _ = check_sessions([session])
    model = Model.baseline(session.conditions, session.commands)
    for effect in (*SOUGHT, *BESIDE):
        model = model.with_effect(EFFECTS[effect].null())
    return fit_sessions(model, prepared)


def _covariance(fit: ModelFit) -> np.ndarray:
    """Return the covariance of the effects' parameters, in fit coordinates.

    Nearly infinite in combinations that the data do not determine. A pseudo-inverse would treat
    these as known.
    """
    information, _, visible = fit.normal
    scale = 1 / np.sqrt(np.where(visible, np.diag(information), 1.0))
    chosen = np.where(np.outer(visible, visible), information, 0.0)
    values, vectors = np.linalg.eigh(chosen * np.outer(scale, scale))
    root = vectors / np.sqrt(np.maximum(values, 1e-12)) * scale[:, None]
    covariance: np.ndarray = root @ root.T
    return covariance


def _estimate(fit: ModelFit, covariance: np.ndarray, effect: str) -> Estimate:
    std = np.sqrt(np.diag(covariance))
    return next(Estimate.normal(parameter.from_fit(x), float(parameter.scale * s))
                for (name, parameter), x, s in zip(
                    fit.model.parameters, fit.model.vector(), std, strict=True) if name == effect)


def _refuse_unknown(name: str, gain: Estimate, skew: Estimate) -> None:
    for what, found in (('gain ratio of y to x coils', gain), ('skew of the y coils', skew)):
        if not found.std <= KNOWN:
            raise InputError(
                name, f'expected tracks that tell the {what} to ±{KNOWN:g}; it came out as '
                f'{found.value:.2g} ± {found.std:.2g}: command eight directions all round, each '
                'more than once, and record longer or more particles')
    if not 1 / PLAUSIBLE <= gain.value <= PLAUSIBLE:
        raise InputError(name, 'expected pairs of coils equal within a factor of '
                               f'{PLAUSIBLE:g}, found y over x {gain.value:.2g}: check the '
                               'wiring of each coil')


def _offset_std(fit: ModelFit, covariance: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    own = [k for k, (name, _) in enumerate(fit.model.parameters) if name == 'background_field']
    scale = np.array([fit.model.parameters[k][1].scale for k in own])
    before = covariance[np.ix_(own, own)] * np.outer(scale, scale)
    # The library applies a background before the coils' own map.
    std: np.ndarray = np.sqrt(np.diag(matrix @ before @ matrix.T))
    return std


def _deviations(fit: ModelFit) -> Deviations:
    """Return displacements less drift, rotated back by command and φ, summed in each bin."""
    p, = fit.session_fits
    e = p.session
    field = e.commands.field_at(e.times)
    angle = np.arctan2(field[:-1, 1], field[:-1, 0])
    steady = np.all(field[1:] == field[:-1], axis=1) & np.any(field[1:] != 0, axis=1)
    used = e.joined() & steady[:, None]
    steps = np.where(used, np.diff(e.z - p.expected.offset, axis=0), 0.0)
    along = (steps * np.conj(p.velocity_phasor)).sum(axis=1) * np.exp(-1j * angle)
    power = (used * np.abs(p.velocity_phasor) ** 2 * np.diff(e.times)[:, None]).sum(axis=1)
    bins = np.round(angle / (2 * np.pi) * _BINS).astype(int) % _BINS
    filled = [b for b in range(_BINS) if power[bins == b].sum() > 0]
    rows = [(np.angle(np.exp(1j * angle[bins == b]).sum()), np.angle(along[bins == b].sum()),
             np.sqrt(2 * p.diffusion / power[bins == b].sum())) for b in filled]
    commanded, deviation, std = np.array(rows).reshape(-1, 3).T
    return Deviations(commanded, deviation, std)
