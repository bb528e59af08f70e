"""The field that came against the one commanded, from which way particles swam.

What tracks tell of B = M B_cmd + b is its direction. How strong the y pair of coils is beside the
x pair, how far it leans, and b over the field bend the path differently for every direction of
the command. One factor on all of the field is not seen, and a common turn is seen as φ of every
particle: neither is fitted, M keeps B_cmd along x.
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
BESIDE = ('uniform_drift', 'command_delay')
"""Fitted with them, as they bend paths too."""

KNOWN = 0.1
"""Standard deviation of gain ratio and skew above which they are not known: 3° of direction."""

PLAUSIBLE = 3.0
"""Pairs of coils are alike to this factor; what is beyond has a coil that is dead or reversed."""

CLEARLY = 10.0
"""Gain in −2 log likelihood for which the mirrored command is the likelier one."""

_BINS = 24


@dataclass(frozen=True)
class Deviations:
    """Which way particles went beside the command, in K bins of its direction; (K,) [rad] each.

    `commanded`: middles of the bins, `deviation` from them, `std` of it.
    """

    commanded: np.ndarray
    deviation: np.ndarray
    std: np.ndarray


@dataclass(frozen=True)
class CoilMap:
    """B = `matrix` (2, 2) B_cmd + `offset` ± `offset_std` (2,) [T], to a common factor and turn.

    `gain_ratio` is that of the y coils to the x coils, `skew` the lean of the y coils towards +x
    [rad]; `strength` [T] is the median of the commands; `unexplained` names what the residuals
    still depend on; `deviations` are what was fitted, for a picture.
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
        """Deviation [rad] of the field from the commanded `direction` (...) [rad]."""
        command = self.strength * np.stack([np.cos(direction), np.sin(direction)], axis=-1)
        field = command @ self.matrix.T + self.offset
        turned: np.ndarray = np.arctan2(field[..., 1], field[..., 0]) - direction
        return (turned + np.pi) % (2 * np.pi) - np.pi

    def summary(self) -> dict[str, object]:
        """The numbers as people read them, and what the tracks leave open."""
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
    """Fit the map to a `session` of catalytic particles; InputError where that can't tell it."""
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
    """Of the effects' parameters in fit coordinates; next to infinite in what can't be told apart.

    Not a pseudo-inverse, which takes what the data leave open for known.
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
    """Displacements less the drift, turned back by command and φ, summed over each bin."""
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
    commanded, deviation, std = np.array(rows).T
    return Deviations(commanded, deviation, std)
