"""One candidate at a time: where its fit may begin, its maximum, and how likely that is by chance.

Effects with a place, a width or a frequency have many local maxima, and where nothing is hidden
the largest of them is larger than χ² says: they are scanned first, and pay for every independent
place they were looked for at (the look-elsewhere effect: Davies 1987, Gross and Vitells 2010).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from microbot_ros.discovery.starting_points import likely_spots, rotating_components
from microbot_ros.discovery.tail_probabilities import log_chi_square_tail, log_of_any
from microbot_ros.estimation.expected_displacement import ExpectedDisplacement
from microbot_ros.estimation.model_fit import ModelFit, fit_with_noise, maximise
from microbot_ros.estimation.prepared_session import PreparedSession
from microbot_ros.model.effect import Effect
from microbot_ros.model.effects import EFFECTS
from microbot_ros.model.effects.hot_spot import HotSpot
from microbot_ros.model.effects.periodic_drift import PeriodicDrift
from microbot_ros.session.folder import NOMINAL_FIELD

COARSE = (0.3, 2.0, 10.0)
"""Fit coordinates, both signs, from which effects of one parameter may start."""

LATE = ('command_delay', 'alignment_lag')
ABSORBED = 0.05
"""Part of its information below which a late heading can't be told from φ."""

OF_STRENGTH = frozenset((
    'amplifier_deadband', 'background_field', 'incomplete_alignment', 'gradient_force',
    'coil_pull', 'dipole_interaction'))
"""Effects that mean nothing where the strength of the field is not known."""

PERIODS = 2.0
"""Periods that a recording must hold to be said to swing."""

TRIED = 3
"""Starting points worth a full fit."""

NEGLIGIBLE = 8.0
"""Likelihood ratio below which neither better noise nor a better place makes evidence."""


@dataclass(frozen=True)
class CandidateFit:
    """A `fit` with the effect `id` more, beside one without it.

    `likelihood_ratio` LR with `dof` degrees of freedom; `trials`: independent places at which the
    effect was looked for; `shape_seen`: whether the recording shows the shape that was found, not
    only its flank.
    """

    fit: ModelFit
    id: str
    likelihood_ratio: float
    dof: int
    trials: float
    shape_seen: bool

    @property
    def has_shape(self) -> bool:
        """Whether the effect has a place, a width or a frequency to be found."""
        return any(p.shape for p in EFFECTS[self.id].parameters())

    @property
    def log_p(self) -> float:
        """Logarithm of the chance of so much evidence where nothing is there, scan included."""
        return log_of_any(log_chi_square_tail(self.likelihood_ratio, self.dof), self.trials)

    @property
    def p_value(self) -> float:
        """The chance itself."""
        return float(np.exp(max(self.log_p, -700.0)))

    @property
    def delta_bic(self) -> float:
        """Positive where the effect is worth its parameters."""
        return float(self.likelihood_ratio - self.dof * np.log(self.fit.count))


def compare(fit: ModelFit, rest: ModelFit, effect_id: str) -> CandidateFit:
    """What the effect `effect_id` of a `fit` brings beside the `rest`, the fit without it."""
    return CandidateFit(
        fit, effect_id, rest.cost - fit.cost, _degrees_of_freedom(fit, EFFECTS[effect_id]),
        _trials(fit, effect_id), shape_is_seen(fit, effect_id))


def fit_candidate(fit: ModelFit, effect_id: str) -> CandidateFit | None:
    """The best fit of a model with `effect_id` added to that of a `fit`.

    None where the data can't show it.
    """
    effect = EFFECTS[effect_id]
    if not _applies(fit, effect):
        return None
    tried = [maximise(fit.under(fit.model.with_effect(start))) for start in _starts(fit, effect)]
    best = min((compare(one, fit, effect_id) for one in tried), key=lambda one: one.log_p)
    if best.likelihood_ratio <= NEGLIGIBLE:
        return best
    return compare(fit_with_noise(best.fit), fit, effect_id)


def shape_is_seen(fit: ModelFit, effect_id: str) -> bool:
    """Whether the recording of a `fit` shows the shape of `effect_id`, not only its flank.

    Half a swing or the far slope of a spot could stand in for anything smooth.
    """
    effect = fit.model.effect(effect_id)
    if isinstance(effect, PeriodicDrift):
        return effect.frequency * _duration(fit) >= PERIODS
    if isinstance(effect, HotSpot):
        within = all(p.low < value < p.high for p, value in effect.values().items())
        std = {p.field: p.scale * s for (e, p), s in zip(
            fit.model.parameters, np.sqrt(np.diag(fit.covariance)), strict=True) if e == effect_id}
        placed = 3 * std['width'] < effect.width > max(std['x'], std['y'])
        return within and placed and std['speed'] < abs(effect.speed)
    return True


def _applies(fit: ModelFit, effect: type[Effect]) -> bool:
    if effect.id == 'drive_response':
        return fit.model.propulsion == 'rolling' and _frequencies(fit) > 1
    if effect.id in LATE and absorbed_by_phi(fit, effect):
        return False
    if effect.id in OF_STRENGTH and all(_strength_unknown(p.session) for p in fit.session_fits):
        return False
    if effect.id in ('dipole_interaction', 'hydrodynamic_slowdown'):
        return any(len(p.session.ids) > 1 for p in fit.session_fits)
    return True


def absorbed_by_phi(fit: ModelFit, late: type[Effect]) -> bool:
    """Whether φ absorbs an effect `late`, as where the command of a `fit` turns one way only.

    What little is left of it then shows in the likelihood only through what else is wrong.
    """
    parameter, = late.parameters()
    bare = ModelFit(replace(fit.model, effects=()), fit.session_fits)
    little = late(**{parameter.field: parameter.from_fit(1e-2)})
    tried = bare.under(bare.model.with_effect(little))
    power = sum(float((np.abs(jacobian) ** 2).sum()) for jacobian in tried.jacobian)
    return bool(tried.normal[0][0, 0] < ABSORBED * power)


def _strength_unknown(session: PreparedSession) -> bool:
    """Whether only the direction of a rolling field was told, not its strength."""
    if session.commands.frequency is None or session.conditions.reference_field:
        return False
    strength = np.hypot(*session.commands.field.T)
    return bool(np.allclose(strength[strength > 0], NOMINAL_FIELD, rtol=1e-6))


def _frequencies(fit: ModelFit) -> int:
    """How many rotation frequencies were used."""
    used = [np.abs(p.session.commands.frequency_at(p.session.times)) for p in fit.session_fits]
    return len(np.unique(np.concatenate(used)))


def _degrees_of_freedom(fit: ModelFit, effect: type[Effect]) -> int:
    count = len(effect.parameters())
    if effect.id == 'drive_response':
        return min(count, _frequencies(fit) - 1)
    return count


def _trials(fit: ModelFit, effect_id: str) -> float:
    """Independent places of the shape of an effect at which a recording lets one look.

    Chance is shared out evenly over octaves of frequency or width, since either may be of any
    size: among fast swings and narrow spots there are more to look at, and each pays for all.
    """
    effect = fit.model.effect(effect_id)
    if isinstance(effect, PeriodicDrift):
        periods = effect.frequency * _duration(fit)
        return float(max(periods * np.log(_fastest(fit) * _duration(fit) / PERIODS), 1.0))
    if isinstance(effect, HotSpot):
        grid = effect.starts(fit.session_fits[0].session.timeline)
        area = np.ptp([spot.x for spot in grid]) * np.ptp([spot.y for spot in grid])
        # A spot reaches over two widths each way.
        return float(max(len({spot.width for spot in grid}) * area / (4 * effect.width) ** 2, 1.0))
    return 1.0


def _starts(fit: ModelFit, effect: type[Effect]) -> list[Effect]:
    """Starting points worth a full fit."""
    if effect.id == 'periodic_drift':
        return _swing_starts(fit)
    if not any(p.shape for p in effect.parameters()):
        return _near_nothing(fit, effect)
    timeline = fit.session_fits[0].session.timeline
    if issubclass(effect, HotSpot):
        spots = likely_spots(fit, effect.starts(timeline), TRIED)
        return _promising([_with_best_strength(fit, spot) for spot in spots])
    return list(effect.starts(timeline))


def _promising(scored: Sequence[tuple[float, Effect]]) -> list[Effect]:
    """The best start, and others that are not far behind one that is worth anything."""
    scored = sorted(scored, key=lambda one: -one[0])[:TRIED]
    best = scored[0][0]
    return [start for score, start in scored
            if score == best or score > max(NEGLIGIBLE, best / 2)]


def _near_nothing(fit: ModelFit, effect: type[Effect]) -> list[Effect]:
    """Near nothing; and for effects of one parameter the best of a coarse row of values."""
    parameters = effect.parameters()
    small = {p.field: p.from_fit(min(1e-3, p.fit_bounds[1])) for p in parameters}
    starts = [effect(**small)]
    if len(parameters) > 1:
        return starts
    low, high = parameters[0].fit_bounds
    coarse = [effect(**{parameters[0].field: parameters[0].from_fit(x)})
              for size in COARSE for x in (size, -size) if low <= x <= high]
    costs = [fit.under(fit.model.with_effect(start)).cost for start in coarse]
    best = int(np.argmin(costs))
    return [*starts, coarse[best]] if costs[best] < fit.cost + 20 else starts


def _with_best_strength(fit: ModelFit, start: Effect) -> tuple[float, Effect]:
    """The evidence for a start whose one strength is linear, and the start with that strength."""
    strength = next(p for p in start.parameters() if not p.shape)
    unit = replace(start, **{strength.field: strength.from_fit(1.0)})
    model = fit.model.with_effect(unit)
    information, slope = 1e-30, 0.0
    for p in fit.session_fits:
        expected = ExpectedDisplacement.of(model, p.session.timeline)
        moved = expected.at(p.velocity_phasor) - p.expected.at(p.velocity_phasor)
        column = p.whiten(np.broadcast_to(moved, p.session.z.shape)[..., None])[..., 0]
        information += float((np.abs(column) ** 2).sum())
        slope += float((column.conj() * p.residual).real.sum())
    low, high = strength.fit_bounds
    size = float(np.clip(slope / information, low, high))
    return slope**2 / information, replace(start, **{strength.field: strength.from_fit(size)})


def _duration(fit: ModelFit) -> float:
    return max(float(np.ptp(p.session.times)) for p in fit.session_fits)


def _fastest(fit: ModelFit) -> float:
    """The highest frequency that is looked at [Hz]."""
    return min(3.0, 0.4 / max(p.session.interval for p in fit.session_fits))


def _swing_starts(fit: ModelFit) -> list[Effect]:
    """Frequencies at which what is left of the longest session swings most.

    White residuals summed over particles; turning both ways, so that any ellipse counts.
    """
    longest = max(fit.session_fits, key=lambda p: float(np.ptp(p.session.times)))
    frequency, forward, back = rotating_components(
        longest.session.times, longest.residual.sum(axis=1), _fastest(fit))
    duration = _duration(fit)
    power = np.abs(forward) ** 2 + np.abs(back) ** 2
    known = next(p for p in PeriodicDrift.parameters() if p.field == 'frequency')
    peaks = [k for k in np.argsort(-power) if power[k] == power[max(k - 3, 0):k + 4].max()
             and known.low <= frequency[k] <= known.high]
    scored = []
    for k in peaks[:2 * TRIED]:
        # x + iy = ½ a (e^{i(α+ψ)} e^{iωt} + e^{i(α−ψ)} e^{−iωt}): the two turning parts.
        ahead, behind = np.angle(forward[k]), np.angle(back[k])
        direction, phase = (ahead + behind) / 2, (ahead - behind) / 2
        # The other way round half a period later is the same: directions are told from 0 to π.
        turns = np.floor(direction / np.pi)
        direction -= turns * np.pi
        phase = (phase - turns * np.pi + np.pi) % (2 * np.pi) - np.pi
        score, start = _with_best_strength(fit, PeriodicDrift(
            0.0, float(frequency[k]), float(direction), float(phase)))
        scored.append((score - 2 * np.log(frequency[k] * duration), start))  # as `_trials` counts
    return _promising(scored)
