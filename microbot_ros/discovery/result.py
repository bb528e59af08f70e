"""What a search for the missing effect found: numbers in SI, and `result.json` of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from microbot_ros.common.units import from_si, suffix, symbol
from microbot_ros.model.learned_term import LearnedTerm
from microbot_ros.model.model import Model, ParticleParameters
from microbot_ros.model.parameter import Parameter

Verdict = Literal['consistent', 'named', 'unnamed']
FIRES = 0.003
"""Adjusted p-value below which a map says that something is left."""

HORIZON = 1.0
"""Seconds ahead of which a prediction is judged, where the recording is long enough, and within
which a residual map asks how far what is left moves particles."""

WORTH = 0.1
"""Part of the noise floor of a prediction that something must move particles by, to be worth an
explanation: a choice. With it an error of prediction is 0.5 % larger than by noise alone, with
twice of it 2 %. At λ = 100 and 240 s of particles what is steady moves them by 0.45."""

UNEVEN = 1.2
"""Ratio of an interval's two sides from which ± would mislead."""

Status = Literal['established', 'suggested', 'proxy']


@dataclass(frozen=True)
class Estimate:
    """A `value` with its standard deviation `std`, SI; NaN where unknown.

    The 95 % interval is from `low` to `high`; of an effect's parameter within its bounds.
    """

    value: float
    std: float
    low: float
    high: float

    @classmethod
    def normal(cls, value: float, std: float) -> Estimate:
        """With the interval of a normal distribution."""
        return cls(value, std, value - 1.96 * std, value + 1.96 * std)

    @property
    def is_even(self) -> bool:
        """Whether the interval lies about the value as ± tells it."""
        below, above = self.value - self.low, self.high - self.value
        return not max(below, above) > UNEVEN * min(below, above)

    @classmethod
    def of(cls, value: float, std: float, ends: np.ndarray) -> Estimate:
        """From numbers of any kind; `ends` (2,) of the interval."""
        return cls(float(value), float(std), float(ends[0]), float(ends[1]))

    def as_json(self, name: str) -> dict[str, float | None]:
        """All in the unit that `name` carries; null where not finite."""
        return {'value': _edge(name, self.value), 'std': _edge(name, self.std),
                'low_95': _edge(name, self.low), 'high_95': _edge(name, self.high)}


UNKNOWN = Estimate.normal(np.nan, np.nan)
"""An estimate of which nothing is known."""


@dataclass(frozen=True)
class NamedEffect:
    """An effect that the data ask for: its `id`, `status` and `parameters` by name.

    `log_evidence` is the natural log of its Bayes factor: the odds that the recording gives the
    model with it over that without it. By it an effect is named. `delta_bic` and `p_value` compare
    the same two models; `p_value` is local for effects with no shape to search over and corrected
    for the search where there is one. `indistinguishable_from` names the effects that explain the
    same data as well.
    """

    id: str
    status: Status
    parameters: dict[str, Estimate]
    log_evidence: float
    delta_bic: float
    p_value: float
    indistinguishable_from: tuple[str, ...] = ()

    def sentence(self) -> str:
        """With its parameters and 95 % intervals."""
        values = ', '.join(
            f'{name.removesuffix(suffix(name))} = {_told(name, e)}'
            for name, e in self.parameters.items())
        alias = ', '.join(self.indistinguishable_from)
        doubt = f'; cannot be distinguished from {alias}' if alias else ''
        return f'{self.status} {self.id}: {values} (ΔBIC {self.delta_bic:.0f}){doubt}.'

    def as_json(self) -> dict[str, Any]:
        """The entry of `effects`, in the units of the names."""
        return {
            'id': self.id, 'status': self.status,
            'parameters': {name: e.as_json(name) for name, e in self.parameters.items()},
            'log_evidence': self.log_evidence, 'delta_bic': self.delta_bic,
            'p_value': self.p_value,
            'indistinguishable_from': list(self.indistinguishable_from),
        }


@dataclass(frozen=True)
class Gap:
    """Held-out open-loop prediction over `horizon` [s]: excess over the noise floor [m].

    `before`, `after` and (where the truth is known) `truth` are √(RMS² − floor²) of one axis,
    0 where there is no excess and NaN where nothing could be judged, all over the same
    displacements; `floor` = √(2D·horizon + 2σ²). `learned`: after the learned term besides, where
    there is one. `closed` and `closed_by_learned`: the squared error [m²] before less that after,
    or less that after the learned term, of the same displacement: their mean.
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
        """Return the gap for people, in one or two sentences."""
        if not np.isfinite([self.before, self.after, self.floor]).all():
            return ['The accuracy of the prediction is unknown: no particle is seen long '
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
    """What is left of the data against one covariate.

    `statistic` is χ² with `dof` degrees of freedom where nothing is left, `p_value` corrected for
    the number of maps. For drawing: `curves` {component: (mean, standard error)} of the residual
    velocity [m/s] in bins whose middles are `middles` (B,) in the unit of `label`.
    """

    against: str
    label: str
    statistic: float
    dof: int
    p_value: float
    middles: np.ndarray
    curves: dict[str, tuple[np.ndarray, np.ndarray]]
    cut_out: bool = False
    """Whether it decides nothing: steps too large for any motion, which are cut out of the fit."""
    size: float = np.inf
    """How far what is left moves particles in a second, in units of the noise floor of a
    prediction; infinite where it is not known."""

    @property
    def log_p(self) -> float:
        """Logarithm of the p-value, as far as numbers go."""
        return float(np.log(max(self.p_value, 1e-300)))

    @property
    def fires(self) -> bool:
        """Whether there is something left."""
        return self.p_value < FIRES

    @property
    def decides(self) -> bool:
        """Whether what is left calls a model into question: it is not cut out, and not small."""
        return self.fires and not self.cut_out and self.size > WORTH


@dataclass(frozen=True)
class Considered:
    """An effect `id` that is not in the model, and what adding it would bring.

    `log_evidence`, natural log of its Bayes factor; `likelihood_ratio` LR with `dof` degrees of
    freedom, `delta_bic` and `p_value` of it.
    """

    id: str
    log_evidence: float
    likelihood_ratio: float
    dof: int
    delta_bic: float
    p_value: float


@dataclass(frozen=True)
class Limit:
    """A `parameter` of an effect `id` that is not supported, and its `upper_limit` (95 %), SI.

    NaN where the data do not bound it.
    """

    id: str
    parameter: Parameter
    upper_limit: float


@dataclass(frozen=True)
class Particle:
    """One particle of that `name`: `speed` [m/s] or gain [m/s/Hz], `phi` [rad], `force` [N]."""

    name: str
    speed: Estimate
    phi: Estimate
    force: Estimate


FRAMES = {'laboratory': 'in the laboratory', 'heading': 'along the heading',
          'radial': 'towards neighbours'}
"""Of learned terms, in words."""


@dataclass(frozen=True)
class Learned:
    """A `term` of no known cause, and the known physics that it `looks_like`, '' for none.

    `log_evidence` over nothing, all that was looked at paid for; `odds` of covariate, frame and
    what it acts on, the likeliest first; `left`: what still shows structure with it.
    """

    term: LearnedTerm
    looks_like: str
    log_evidence: float
    odds: dict[tuple[str, str, str], float]
    left: tuple[str, ...] = ()

    def sentence(self) -> str:
        """What it is, for people."""
        term = self.term
        form = f': {term.formula}' if term.formula else ', a curve that no formula fits'
        like = f' It looks like {self.looks_like}.' if self.looks_like else ''
        rest = f' Residuals remain against {", ".join(self.left[:3])}.' if self.left else ''
        return (f'A term of the {term.acts_on} was learned against {term.against} '
                f'({FRAMES[term.frame]}){form}.{like}{rest} A fitted curve does not name a '
                'cause.')

    def as_json(self, gap: float) -> dict[str, Any]:
        """The entry of `learned`; `gap` [m] is what is left with all that was learned."""
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
        """Of a velocity that depends on the place: x, y [µm] and the velocity there [µm/s] at each
        knot that data were at. Of all else none."""
        term = self.term
        if (term.against, term.acts_on) != ('position', 'velocity'):
            return []
        x, y = np.meshgrid(*term.axes, indexing='ij')
        rows = np.column_stack([x.ravel(), y.ravel(), term.values])[term.seen]
        return [[_edge('_um', value) for value in row] for row in rows.tolist()]


@dataclass(frozen=True)
class NextExperiment:
    """What to record to tell apart what this recording can't: a `sentence`, and `minutes`."""

    sentence: str
    minutes: float


@dataclass(frozen=True)
class Discovery:
    """The whole result. `model` and `particles` (those of the last session) make `model.yaml`.

    `verdict`; `effects`, the surest first; `gap` in prediction; `maps_before`, `maps_after` of
    the residual; `considered`: what is not in the model, the likeliest first; `limits` of what is
    not supported; `baseline`: every particle under the final model, with `diffusion` [m²/s] and
    `localisation` [m], means over sessions; `next_experiment`, None where nothing is open;
    `remarks`: sentences.
    `unexplained`: what no effect explains, and what is small beside one, the worst first.
    `learned`: terms for what is unnamed,
    parts of the model.
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
        """The verdict for people, the effects, the gap, remarks."""
        against = ', '.join(m.against for m in self.unexplained)
        said = {
            'consistent': [('The first-order model explains the data' + (
                ', with one hint:' if self.effects else ': nothing is missing.')),
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
        """`result.json`, in units at the edge."""
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
                {'id': limit.id, 'parameter': limit.parameter.name,
                 'upper_limit_95': _edge(limit.parameter.name, limit.upper_limit)}
                for limit in self.limits
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
