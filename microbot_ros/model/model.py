"""The model: four stages, each changed by the effects that belong to it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np

from microbot_ros.common.records import Commands, Conditions
from microbot_ros.model.effect import STAGES, Effect
from microbot_ros.model.effect_context import EffectContext, Places
from microbot_ros.model.effects import BUILT_IN
from microbot_ros.model.learned_term import LearnedTerm
from microbot_ros.model.parameter import Parameter

Propulsion = Literal['catalytic', 'rolling']
_ORDER = {effect.id: rank for rank, effect in enumerate(BUILT_IN)}


def _rank(effect: Effect) -> tuple[int, int, str]:
    """Where it stands in the library, without asking what else is installed."""
    return STAGES.index(effect.stage), _ORDER.get(effect.id, len(_ORDER)), effect.id


@dataclass(frozen=True)
class ParticleParameters:
    """What differs between particles.

    `ids` (N,) integers; `speed` (N,): v [m/s] of catalytic particles, or gain [m/s/Hz] of rolling
    ones; `phi` (N,) [rad], the angle from the field to the direction of travel.
    """

    ids: np.ndarray
    speed: np.ndarray
    phi: np.ndarray

    @cached_property
    def velocity_phasor(self) -> np.ndarray:
        """v e^{iφ} (N,): the velocity in the frame of the field, as complex numbers."""
        return self.speed * np.exp(1j * self.phi)

    @classmethod
    def from_velocity_phasor(cls, ids: np.ndarray, velocity_phasor: np.ndarray,
                             ) -> ParticleParameters:
        """From v e^{iφ} (N,): the inverse of `velocity_phasor`, φ within ±π."""
        return cls(np.asarray(ids), np.abs(velocity_phasor), np.angle(velocity_phasor))


@dataclass(frozen=True)
class Model:
    """The first-order model with its effects; with none it is the paper's dp/dt = v R(φ) u.

    `reference_field` [T] is the strength at which alignment times are stated; with `propulsion`
    'rolling' speeds are gains per rotation frequency. `effects` are kept in the order of the
    library, at most one of a kind, so that models that say the same are equal. `learned` are
    terms that no effect has a name for; they have no parameters to fit.
    """

    reference_field: float
    propulsion: Propulsion = 'catalytic'
    effects: tuple[Effect, ...] = field(default=())
    learned: tuple[LearnedTerm, ...] = field(default=())

    def __post_init__(self) -> None:
        ids = [effect.id for effect in self.effects]
        if len(set(ids)) != len(ids):
            raise ValueError(f'effects must be one of a kind; received {", ".join(ids)}')
        if not 0 < self.reference_field < np.inf:
            received = self.reference_field
            raise ValueError(f'reference_field must be positive; received {received}')
        ordered = sorted(self.effects, key=_rank)
        object.__setattr__(self, 'effects', tuple(ordered))

    @classmethod
    def baseline(cls, conditions: Conditions, commands: Commands) -> Model:
        """The model of a session before anything is discovered.

        Where the conditions do not state the reference field it is the median strength of the
        commands that are not zero, or 1 mT where all are.
        """
        reference = conditions.reference_field
        if reference is None:
            strength = np.hypot(*commands.field.T)
            driven = strength[strength > 0]
            reference = float(np.median(driven)) if driven.size else 1e-3
        return cls(reference, 'rolling' if conditions.propulsion == 'rolling' else 'catalytic')

    # Which effects it has -----------------------------------------------------------------------

    @property
    def _terms(self) -> tuple[Effect | LearnedTerm, ...]:
        return *self.effects, *self.learned

    @property
    def is_first_order(self) -> bool:
        """Whether it is the first-order model and nothing else."""
        return not (self.effects or self.learned)

    def effect(self, name: str) -> Effect | None:
        """The effect of that name, or None."""
        return next((effect for effect in self.effects if effect.id == name), None)

    def with_effect(self, effect: Effect) -> Model:
        """The model with this effect, in place of one of the same name."""
        return replace(self, effects=(*self.without(effect.id).effects, effect))

    def without(self, name: str) -> Model:
        """The model without the effect of that name."""
        return replace(self, effects=tuple(e for e in self.effects if e.id != name))

    def undelayed(self) -> Model:
        """The model without what delays the field, for where the delay is counted already.

        An effect that does more besides is left out whole.
        """
        return replace(self, effects=tuple(e for e in self.effects if not e.latency()))

    def without_swings(self) -> Model:
        """The model without drifts that come and go, whose phase belongs to one recording."""
        return replace(self, effects=tuple(
            e for e in self.effects if e.time_invariant or not e.overrides('drift')),
            learned=tuple(term for term in self.learned
                          if term.against != 'time' or term.acts_on != 'velocity'))

    # Its parameters as one vector ---------------------------------------------------------------

    @property
    def parameters(self) -> list[tuple[str, Parameter]]:
        """(effect, parameter) for every entry of `vector`."""
        return [(effect.id, p) for effect in self.effects for p in effect.parameters()]

    def vector(self) -> np.ndarray:
        """The parameters of all effects in fit coordinates (P,)."""
        values = [p.to_fit(value) for e in self.effects for p, value in e.values().items()]
        return np.array(values, dtype=float)

    def with_vector(self, coordinates: np.ndarray) -> Model:
        """The same effects with parameters at the fit coordinates (P,)."""
        rest = iter(np.asarray(coordinates, dtype=float).tolist())
        effects = tuple(
            type(effect)(**{p.field: p.from_fit(next(rest)) for p in effect.parameters()})
            for effect in self.effects
        )
        return replace(self, effects=effects)

    def answering(self, *hooks: str) -> tuple[Effect, ...]:
        """The effects that answer one of these hooks, by their names."""
        return tuple(e for e in self.effects if any(e.overrides(hook) for hook in hooks))

    # What its effects need ----------------------------------------------------------------------

    @cached_property
    def needs_position(self) -> bool:
        """Whether a particle's velocity depends on where it or others are."""
        return any(one.needs_position for one in self._terms)

    @cached_property
    def turns_by_place(self) -> bool:
        """Whether headings depend on where particles are, or on which they are."""
        return any(term.needs_position and term.acts_on == 'heading' for term in self.learned)

    @cached_property
    def time_invariant(self) -> bool:
        """Whether nothing changes while the command stays."""
        return all(one.time_invariant for one in self._terms)

    @cached_property
    def lags(self) -> bool:
        """Whether headings turn at a finite rate, however fast: they remember then."""
        return any(effect.overrides('alignment_rate') for effect in self.effects)

    @property
    def alignment_time(self) -> float:
        """1/κ [s] at the reference field and the origin; 0 where headings align at once."""
        if not self.lags:
            return 0.0
        zero = np.zeros(1)
        rate = self.alignment_rate(EffectContext(
            zero, zero, np.array([[self.reference_field, 0.0]]), zero, self.reference_field,
            Places(np.zeros((1, 2)))))
        return 0.0 if rate is None else 1 / float(np.squeeze(rate))

    # The four stages ----------------------------------------------------------------------------

    @cached_property
    def delay(self) -> float:
        """Seconds by which the field follows the command late."""
        return sum(effect.latency() for effect in self.effects)

    def field(self, commanded: np.ndarray) -> np.ndarray:
        """Stage 1: the field (..., 2) [T] that a commanded field (..., 2) [T] makes."""
        for effect in self.effects:
            commanded = effect.field(commanded)
        return commanded

    def heading_offset(self, context: EffectContext) -> np.ndarray | float:
        """Stage 2: the angle (..., 1 or N) [rad] by which θ_B + φ is off."""
        return sum(one.heading_offset(context) for one in self._terms)

    def alignment_rate(self, context: EffectContext) -> np.ndarray | None:
        """Stage 2: κ (..., 1 or N) [1/s] of dθ/dt = κ sin(θ_B + φ − θ); None: at once."""
        rates = (effect.alignment_rate(context) for effect in self.effects)
        return next((rate for rate in rates if rate is not None), None)

    def speed_factor(self, context: EffectContext) -> np.ndarray | float:
        """Stage 3: what a particle's `speed` is multiplied by (..., 1 or N)."""
        factor: np.ndarray | float = context.frequency if self.propulsion == 'rolling' else 1.0
        for effect in self.effects:
            if effect.stage == 'velocity':
                factor = factor * effect.speed_factor(context)
        for term in self.learned:
            factor = factor * term.speed_factor(context)
        return factor

    def gain_change_since_start(self, t: float) -> complex:
        """What v e^{iφ} of the beginning has become at `t` [s], by what counts time alone."""
        changed, zero = 1.0 + 0j, np.zeros(1)
        context = EffectContext(np.full(1, t), zero, np.zeros((1, 2)), zero, self.reference_field)
        terms: list[Effect | LearnedTerm] = [e for e in self.effects if not e.time_invariant]
        for one in (*terms, *(term for term in self.learned if term.against == 'time')):
            turn = np.exp(1j * one.heading_offset(context))
            changed *= complex(np.squeeze(one.speed_factor(context) * turn))
        return changed

    @property
    def drifts(self) -> tuple[Effect, ...]:
        """The effects that may add to the propulsion."""
        return tuple(e for e in self.effects if e.stage == 'velocity' and e.overrides('drift'))

    def drift(self, context: EffectContext) -> np.ndarray | None:
        """Stage 3: the velocity (..., 1 or N, 2) [m/s] besides propulsion; None: none."""
        total = None
        for effect in self.drifts:
            drift = effect.drift(context)
            if drift is not None:
                total = drift if total is None else total + drift
        for term in self.learned:
            drift = term.drift(context)
            if drift is not None:
                total = drift if total is None else total + drift
        return total

    def observe(self, position: np.ndarray) -> np.ndarray:
        """Stage 4: what the camera reports (..., 2) [m] of true positions (..., 2)."""
        for effect in self.effects:
            position = effect.observe(position)
        return position

    @property
    def stretch(self) -> tuple[float, float]:
        """How much larger than they are lengths of random direction look along x and along y."""
        x, y = np.linalg.norm(self.observe(np.eye(2)), axis=0)
        return float(x), float(y)

    def true_position(self, observed: np.ndarray) -> np.ndarray:
        """The inverse of `observe`: true positions (..., 2) [m] of `observed` ones (..., 2)."""
        for effect in reversed(self.effects):
            observed = effect.true_position(observed)
        return observed
