"""Result of a search for missing effects: numbers in SI, and `result.json`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from microbot_ros.common.units import bare, from_si, symbol
from microbot_ros.model.learned_term import LearnedTerm
from microbot_ros.model.model import Model, ParticleParameters
from microbot_ros.model.parameter import Parameter

Verdict = Literal['consistent', 'named', 'unnamed']
"""`consistent`: no effect is missing; `named`: effects explain the data; `unnamed`: something
else."""

FIRES = 0.003
"""Adjusted p-value below which a residual map shows structure.

Choice: with the number of maps accounted for, 0.3 % of complete models show one; twice of it
doubles these, half of it hides weak structure.
"""

HORIZON = 1.0
"""Prediction horizon [s] for held-out data, where recordings are long enough, and of the size of
what a residual map shows.

Choice: a usual reaction time of closed-loop control. Over longer times diffusion hides more, over
shorter ones the localisation error does."""

WORTH = 0.1
"""Displacement, as a fraction of the noise floor of a prediction, above which a residual needs an
explanation.

Choice: with it a prediction error is 0.5 % larger than by noise alone, with twice of it 2 %. A
steady velocity with an expected evidence λ = 100 in 240 s of particles has a size of 0.45."""

UNEVEN = 1.2
"""Ratio of an interval's two sides above which it is written as a range instead of ±.

Choice: up to it, ± errs at either end by less than a tenth of the half-width.
"""

Status = Literal['established', 'suggested', 'proxy']
"""`established`: named; `suggested`: in the model only; `proxy`: beside something unexplained."""


@dataclass(frozen=True)
class Estimate:
    """A value with standard deviation and 95 % interval, SI; NaN where unknown.

    Attributes
    ----------
    value, std : float
        Estimate and standard deviation.
    low, high : float
        Ends of the 95 % interval; for a parameter of an effect within its bounds.
    """

    value: float
    std: float
    low: float
    high: float

    @classmethod
    def normal(cls, value: float, std: float) -> Estimate:
        """Make an estimate with the interval of a normal distribution.

        Parameters
        ----------
        value : float
            Mean, SI.
        std : float
            Standard deviation, SI.

        Returns
        -------
        Estimate
            With the interval value ± 1.96 std.
        """
        return cls(value, std, value - 1.96 * std, value + 1.96 * std)

    @property
    def is_even(self) -> bool:
        """Whether the interval is symmetric enough to be written with ±."""
        below, above = self.value - self.low, self.high - self.value
        return not max(below, above) > UNEVEN * min(below, above)

    @classmethod
    def of(cls, value: float, std: float, ends: np.ndarray) -> Estimate:
        """Make an estimate from numbers of any type.

        Parameters
        ----------
        value : float
            Estimate, SI.
        std : float
            Standard deviation, SI.
        ends : ndarray, shape (2,)
            Ends of the 95 % interval.

        Returns
        -------
        Estimate
            With Python floats.
        """
        return cls(float(value), float(std), float(ends[0]), float(ends[1]))

    def as_json(self, name: str) -> dict[str, float | None]:
        """Return the estimate for a JSON file.

        Parameters
        ----------
        name : str
            Name whose suffix gives the unit, e.g. `v_um_s`.

        Returns
        -------
        dict of str to float or None
            `value`, `std`, `low_95` and `high_95` in that unit; None where not finite.
        """
        return {'value': _edge(name, self.value), 'std': _edge(name, self.std),
                'low_95': _edge(name, self.low), 'high_95': _edge(name, self.high)}


UNKNOWN = Estimate.normal(np.nan, np.nan)
"""Estimate of an unknown value: NaN."""


@dataclass(frozen=True)
class NamedEffect:
    """An effect that the data support.

    Attributes
    ----------
    id : str
        Id of the effect.
    status : Status
        How certain it is.
    parameters : dict of str to Estimate
        By name of the parameter, SI.
    log_evidence : float
        Natural log of the Bayes factor: the odds that the recording gives the model with the
        effect over the model without it. An effect is named by it.
    delta_bic, p_value : float
        Comparison of the same two models. The p-value is local for effects without a shape, and
        corrected for the search where there is one.
    indistinguishable_from : tuple of str
        Effects that explain the same data as well.
    """

    id: str
    status: Status
    parameters: dict[str, Estimate]
    log_evidence: float
    delta_bic: float
    p_value: float
    indistinguishable_from: tuple[str, ...] = ()

    def sentence(self) -> str:
        """Return the effect with its parameters and 95 % intervals as a sentence.

        Returns
        -------
        str
            In units for people.
        """
        values = ', '.join(
            f'{bare(name)} = {_told(name, e)}'
            for name, e in self.parameters.items())
        alias = ', '.join(self.indistinguishable_from)
        doubt = f'; cannot be distinguished from {alias}' if alias else ''
        return f'{self.status} {self.id}: {values} (ΔBIC {self.delta_bic:.0f}){doubt}.'

    def as_json(self) -> dict[str, Any]:
        """Return the entry of `effects` in `result.json`.

        Returns
        -------
        dict
            Numbers in the units of their names.
        """
        return {
            'id': self.id, 'status': self.status,
            'parameters': {name: e.as_json(name) for name, e in self.parameters.items()},
            'log_evidence': self.log_evidence, 'delta_bic': self.delta_bic,
            'p_value': self.p_value,
            'indistinguishable_from': list(self.indistinguishable_from),
        }


@dataclass(frozen=True)
class Gap:
    """Error of open-loop prediction on held-out data, in excess of the noise floor.

    Errors are √(RMS² − floor²) [m] of one axis over the same displacements: 0 without excess, NaN
    where nothing could be judged.

    Attributes
    ----------
    horizon : float
        Prediction horizon [s].
    before, after : float
        Error of the first-order model, and with the effects [m].
    floor : float
        Noise floor √(2D·horizon + 2σ²) [m].
    truth : float
        Error of the true model [m]; NaN where it is not known.
    learned : float
        Error with the learned term as well [m]; NaN without one.
    closed, closed_by_learned : Estimate
        Mean decrease of the squared error of a displacement [m²], by the effects or with the
        learned term as well.
    """

    horizon: float
    before: float
    after: float
    floor: float
    truth: float = np.nan
    learned: float = np.nan
    closed: Estimate = UNKNOWN
    closed_by_learned: Estimate = UNKNOWN

    def sentences(self) -> list[str]:
        """Return the gap in one or two sentences.

        Returns
        -------
        list of str
            In µm.
        """
        if not np.isfinite([self.before, self.after, self.floor]).all():
            return ['The accuracy of the prediction is not known: no particle is seen long '
                    f'enough in a held-out part of the recording, {self.horizon:.3g} s at '
                    'least.']
        has_learned = np.isfinite(self.learned)
        told = [
            f'Prediction {self.horizon:.3g} s ahead, held out: {self.before * 1e6:.2f} µm over '
            f'the noise floor of {self.floor * 1e6:.2f} µm before, {self.after * 1e6:.2f} µm after'
            + (f', {self.learned * 1e6:.2f} µm with the learned term.' if has_learned else '.')]
        closed = self.closed_by_learned if has_learned else self.closed
        if closed.std > 0:
            value, low, high = (x * 1e12 for x in (closed.value, closed.low, closed.high))
            told.append(f'On the same displacements the mean squared error falls by {value:.2g} '
                        f'µm² (95 % interval {low:.2g} to {high:.2g} µm²).')
        return told


@dataclass(frozen=True)
class ResidualMap:
    """Dependence of the residual on one covariate.

    Attributes
    ----------
    against : str
        Name of the covariate.
    label : str
        Axis label, with unit.
    statistic : float
        χ² with `dof` degrees of freedom if the model is complete.
    dof : int
        Degrees of freedom.
    p_value : float
        Corrected for the number of maps.
    middles : ndarray, shape (B,)
        Middles of the bins, in the unit of `label`.
    curves : dict of str to (ndarray, ndarray)
        Mean and standard error of the residual velocity [m/s] in each bin, by component.
    """

    against: str
    label: str
    statistic: float
    dof: int
    p_value: float
    middles: np.ndarray
    curves: dict[str, tuple[np.ndarray, np.ndarray]]
    cut_out: bool = False
    """Whether the map shows only steps too large for any motion, which the fit excludes."""
    size: float = np.inf
    """How far the residual moves particles in HORIZON, in units of the noise floor of a
    prediction; a rhythm in half a period if that is shorter. Infinite where unknown."""

    @property
    def log_p(self) -> float:
        """Natural log of the p-value, at least that of 1e-300."""
        return float(np.log(max(self.p_value, 1e-300)))

    @property
    def fires(self) -> bool:
        """Whether the residual depends on the covariate: p-value below FIRES."""
        return self.p_value < FIRES

    @property
    def decides(self) -> bool:
        """Whether the residual questions the model: neither excluded from the fit nor small."""
        return self.fires and not self.cut_out and self.size > WORTH


@dataclass(frozen=True)
class Considered:
    """An effect that is not in the model, and what adding it would bring.

    Attributes
    ----------
    id : str
        Id of the effect.
    log_evidence : float
        Natural log of its Bayes factor.
    likelihood_ratio : float
        −2 log likelihood that it gains, with `dof` degrees of freedom.
    dof : int
        Degrees of freedom.
    delta_bic, p_value : float
        Of the likelihood ratio.
    """

    id: str
    log_evidence: float
    likelihood_ratio: float
    dof: int
    delta_bic: float
    p_value: float


@dataclass(frozen=True)
class Limit:
    """Limit of a parameter of an effect that is not supported.

    Attributes
    ----------
    id : str
        Id of the effect.
    parameter : Parameter
        The parameter.
    limit : float
        95 % limit of its magnitude, SI, beyond which the effect would be stronger: an upper one,
        or a lower one of an inverse parameter, such as a time of decay. NaN where the data do not
        bound it.
    """

    id: str
    parameter: Parameter
    limit: float

    def as_json(self) -> dict[str, Any]:
        """Return the limit as in `result.json`.

        Returns
        -------
        dict of str to object
            Effect, parameter, and its two limits, one of which is None.
        """
        edge = _edge(self.parameter.name, self.limit)
        lower, upper = (edge, None) if self.parameter.inverse else (None, edge)
        return {'id': self.id, 'parameter': self.parameter.name, 'upper_limit_95': upper,
                'lower_limit_95': lower}


@dataclass(frozen=True)
class Particle:
    """Estimates of one particle.

    Attributes
    ----------
    name : str
        Id; with several sessions `session:id`.
    speed : Estimate
        Speed [m/s], or gain [m/s/Hz] of a roller.
    phi : Estimate
        Angle of travel from the field [rad].
    force : Estimate
        Propulsive force [N].
    """

    name: str
    speed: Estimate
    phi: Estimate
    force: Estimate


FRAMES = {'laboratory': 'in the laboratory', 'heading': 'along the heading',
          'radial': 'towards neighbours'}
"""Frames of learned terms in words."""


@dataclass(frozen=True)
class Learned:
    """A learned term of unknown cause.

    Attributes
    ----------
    term : LearnedTerm
        The term.
    looks_like : str
        Known physics that it resembles; '' for none.
    log_evidence : float
        Natural log of its Bayes factor, less the cost of all terms tried.
    odds : dict of (str, str, str) to float
        Probability of covariate, frame and acted-on quantity, largest first.
    left : tuple of str
        Covariates that still show structure with the term.
    """

    term: LearnedTerm
    looks_like: str
    log_evidence: float
    odds: dict[tuple[str, str, str], float]
    left: tuple[str, ...] = ()

    def sentence(self) -> str:
        """Return the term as sentences.

        Returns
        -------
        str
            Quantity, covariate, formula and resemblance.
        """
        term = self.term
        form = f': {term.formula}' if term.formula else ', a curve that no formula fits'
        like = f' It looks like {self.looks_like}.' if self.looks_like else ''
        rest = f' Residuals remain against {", ".join(self.left[:3])}.' if self.left else ''
        return (f'A term of the {term.acts_on} was learned against {term.against} '
                f'({FRAMES[term.frame]}){form}.{like}{rest} A fitted curve does not name a '
                'cause.')

    def as_json(self, gap: float) -> dict[str, Any]:
        """Return the entry of `learned` in `result.json`.

        Parameters
        ----------
        gap : float
            Prediction error [m] with all learned terms.

        Returns
        -------
        dict
            Numbers in the units of their names.
        """
        term = self.term
        return {
            'against': term.against, 'frame': term.frame, 'acts_on': term.acts_on,
            'formula': term.formula, 'parameters': dict(term.parameters),
            'looks_like': self.looks_like, 'gap_after_um': _edge('_um', gap),
            'band_95': 'in model.yaml', 'log_evidence': self.log_evidence,
            'odds': [{'against': against, 'frame': frame, 'acts_on': acts_on, 'odds': odds}
                     for (against, frame, acts_on), odds in self.odds.items() if odds > 1e-3],
            'left_against': list(self.left), 'sentence': self.sentence(),
            'arrows': self._arrows(),
        }

    def _arrows(self) -> list[list[float | None]]:
        """Return rows of x, y [µm] and velocity [µm/s] at the knots with data.

        Only of a velocity that depends on place; else none.
        """
        term = self.term
        if (term.against, term.acts_on) != ('position', 'velocity'):
            return []
        x, y = np.meshgrid(*term.axes, indexing='ij')
        rows = np.column_stack([x.ravel(), y.ravel(), term.values])[term.seen]
        return [[_edge('_um', value) for value in row] for row in rows.tolist()]


@dataclass(frozen=True)
class NextExperiment:
    """A recording to decide between open explanations: a `sentence`, and `minutes` of it."""

    sentence: str
    minutes: float


@dataclass(frozen=True)
class Discovery:
    """The whole result of a search.

    Attributes
    ----------
    verdict : Verdict
        Summary of the search.
    effects : tuple of NamedEffect
        Effects of the model, largest evidence first.
    gap : Gap
        Error of prediction on held-out data.
    maps_before, maps_after : tuple of ResidualMap
        Residual of the first-order model and of the final one.
    unexplained : tuple of ResidualMap
        What no effect explains, and what is small beside one, smallest p-value first.
    considered : tuple of Considered
        Effects that are not in the model, largest evidence first.
    limits : tuple of Limit
        Upper limits of effects that are not supported.
    baseline : tuple of Particle
        Every particle under the final model.
    diffusion : Estimate
        D [m²/s], mean over sessions.
    localisation : Estimate
        σ [m], mean over sessions.
    next_experiment : NextExperiment or None
        None where no question is open.
    model : Model
        Final model, with learned terms.
    particles : ParticleParameters
        Particles of the last session; with `model` they make `model.yaml`.
    remarks : tuple of str
        Sentences on reservations.
    learned : tuple of Learned
        Terms for what no effect explains; parts of `model`.
    """

    verdict: Verdict
    effects: tuple[NamedEffect, ...]
    gap: Gap
    maps_before: tuple[ResidualMap, ...]
    maps_after: tuple[ResidualMap, ...]
    unexplained: tuple[ResidualMap, ...]
    considered: tuple[Considered, ...]
    limits: tuple[Limit, ...]
    baseline: tuple[Particle, ...]
    diffusion: Estimate
    localisation: Estimate
    next_experiment: NextExperiment | None
    model: Model
    particles: ParticleParameters
    remarks: tuple[str, ...] = ()
    learned: tuple[Learned, ...] = ()

    def sentences(self) -> list[str]:
        """Return verdict, effects, gap and remarks as sentences.

        Returns
        -------
        list of str
            In units for people.
        """
        against = ', '.join(m.against for m in self.unexplained)
        said = {
            'consistent': [('The first-order model explains the data' + (
                ', with one hint:' if self.effects else ': no effect was found.')),
                *([f'The residuals against {against} do not improve the prediction.']
                  if against else [])],
            'named': [f'The residuals, against {against}, are small compared with:' if against else
                      'The model is complete with:'],
            'unnamed': ['The data show an effect that is not in the library; it depends on '
                        f'{against}.'],
        }[self.verdict]
        said += [effect.sentence() for effect in self.effects]
        said += [one.sentence() for one in self.learned]
        return [*said, *self.gap.sentences(), *(f'! {remark}' for remark in self.remarks)]

    def as_json(self) -> dict[str, Any]:
        """Return the content of `result.json`.

        Returns
        -------
        dict
            Numbers in the units of their names.
        """
        speed = 'gain_um_s_hz' if self.model.propulsion == 'rolling' else 'v_um_s'
        return {
            'verdict': self.verdict,
            'effects': [effect.as_json() for effect in self.effects],
            'gap': {
                'horizon_s': self.gap.horizon,
                'before_um': _edge('_um', self.gap.before),
                'after_um': _edge('_um', self.gap.after),
                'floor_um': _edge('_um', self.gap.floor),
                'closed_um2': self.gap.closed.as_json('_um2'),
                'closed_by_learned_um2': self.gap.closed_by_learned.as_json('_um2'),
            },
            'unexplained': [
                {'against': m.against, 'p_value': m.p_value} for m in self.unexplained
            ],
            'learned': [one.as_json(self.gap.learned) for one in self.learned],
            'not_supported': [
                limit.as_json() for limit in self.limits
            ],
            'baseline': {
                'particles': {
                    p.name: {
                        speed: p.speed.as_json(speed), 'phi_rad': p.phi.as_json('phi_rad'),
                        'force_pN': p.force.as_json('force_pN'),
                    } for p in self.baseline
                },
                'diffusion_um2_s': self.diffusion.as_json('_um2_s'),
                'localisation_um': self.localisation.as_json('_um'),
            },
            'next_experiment': self.next_experiment.sentence if self.next_experiment else '',
            'remarks': list(self.remarks),
        }


def _told(name: str, estimate: Estimate) -> str:
    value, low, high = (from_si(name, x) for x in (estimate.value, estimate.low, estimate.high))
    unit = symbol(name)
    if not np.isfinite(value):
        return 'not known'
    if np.isnan([low, high]).any():
        return f'{value:.3g} {unit}'.strip() + ' (interval not known)'
    if estimate.is_even:
        return f'{value:.3g} ± {(high - low) / 2:.2g} {unit}'.strip()
    ends = ' to '.join(f'{end:.3g}'.replace('inf', '∞') for end in (low, high))
    return f'{value:.3g} ({ends}) {unit}'.strip()


def _edge(name: str, value: float) -> float | None:
    return float(from_si(name, float(value))) if np.isfinite(value) else None
