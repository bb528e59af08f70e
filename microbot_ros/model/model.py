"""The model: four stages, each changed by its effects."""

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
"""How particles move: by themselves, or rolling with the field."""

_ORDER = {effect.id: rank for rank, effect in enumerate(BUILT_IN)}
"""Rank of each built-in effect."""


def _rank(effect: Effect) -> tuple[int, int, str]:
    """Return the rank of an effect in the library, without a search for other packages."""
    return STAGES.index(effect.stage), _ORDER.get(effect.id, len(_ORDER)), effect.id


@dataclass(frozen=True)
class ParticleParameters:
    """Parameters that differ between N particles.

    Attributes
    ----------
    ids : ndarray of int, shape (N,)
        Particles.
    speed : ndarray, shape (N,)
        v [m/s] of catalytic particles, or gain [m/s/Hz] of rolling ones.
    phi : ndarray, shape (N,)
        Angle from the field to the direction of travel [rad].
    """

    ids: np.ndarray
    speed: np.ndarray
    phi: np.ndarray

    @cached_property
    def velocity_phasor(self) -> np.ndarray:
        """Velocity in the frame of the field, v e^{iφ} (N,)."""
        return self.speed * np.exp(1j * self.phi)

    @classmethod
    def from_velocity_phasor(cls, ids: np.ndarray, velocity_phasor: np.ndarray,
                             ) -> ParticleParameters:
        """Make parameters from v e^{iφ}.

        Parameters
        ----------
        ids : ndarray of int, shape (N,)
            Particles.
        velocity_phasor : ndarray of complex, shape (N,)
            v e^{iφ} [m/s, or m/s/Hz].

        Returns
        -------
        ParticleParameters
            With φ within ±π.
        """
        return cls(np.asarray(ids), np.abs(velocity_phasor), np.angle(velocity_phasor))


@dataclass(frozen=True)
class Model:
    """First-order model with effects; without any it is the paper's dp/dt = v R(φ) u.

    Effects are kept in the order of the library, at most one of a kind, so that equal models
    compare equal.

    Attributes
    ----------
    reference_field : float
        Field at which alignment times are stated [T].
    propulsion : Propulsion
        With 'rolling', speeds are gains per rotation frequency.
    effects : tuple of Effect
        The effects.
    learned : tuple of LearnedTerm
        Learned terms, without parameters to fit.

    Raises
    ------
    ValueError
        For two effects of a kind, or a reference field that is not positive.
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
        """Make the model of a session before discovery.

        If the conditions do not state the reference field, it is the median strength of the
        commands that are not zero, or 1 mT if all are.

        Parameters
        ----------
        conditions : Conditions
            Conditions of the session.
        commands : Commands
            Commands of the session.

        Returns
        -------
        Model
            Without effects.
        """
        reference = conditions.reference_field
        if reference is None:
            strength = np.hypot(*commands.field.T)
            driven = strength[strength > 0]
            reference = float(np.median(driven)) if driven.size else 1e-3
        return cls(reference, 'rolling' if conditions.propulsion == 'rolling' else 'catalytic')

    # Effects of the model -----------------------------------------------------------------------

    @property
    def _terms(self) -> tuple[Effect | LearnedTerm, ...]:
        return *self.effects, *self.learned

    @property
    def is_first_order(self) -> bool:
        """Whether it is the first-order model without effects or learned terms."""
        return not (self.effects or self.learned)

    def effect(self, name: str) -> Effect | None:
        """Return an effect of the model.

        Parameters
        ----------
        name : str
            Id of the effect.

        Returns
        -------
        Effect or None
            None if the model does not have it.
        """
        return next((effect for effect in self.effects if effect.id == name), None)

    def with_effect(self, effect: Effect) -> Model:
        """Add an effect, or replace the one of the same id.

        Parameters
        ----------
        effect : Effect
            The effect.

        Returns
        -------
        Model
            The new model.
        """
        return replace(self, effects=(*self.without(effect.id).effects, effect))

    def without(self, name: str) -> Model:
        """Remove an effect.

        Parameters
        ----------
        name : str
            Id of the effect.

        Returns
        -------
        Model
            The new model.
        """
        return replace(self, effects=tuple(e for e in self.effects if e.id != name))

    def undelayed(self) -> Model:
        """Remove all effects that delay the field, for data whose delay is corrected already.

        An effect that does more is removed entirely.

        Returns
        -------
        Model
            The new model.
        """
        return replace(self, effects=tuple(e for e in self.effects if not e.latency()))

    def without_swings(self) -> Model:
        """Remove drifts that vary in time, whose phase belongs to one recording.

        Returns
        -------
        Model
            The new model.
        """
        return replace(self, effects=tuple(
            e for e in self.effects if e.time_invariant or not e.overrides('drift')),
            learned=tuple(term for term in self.learned
                          if term.against != 'time' or term.acts_on != 'velocity'))

    # Its parameters as one vector ---------------------------------------------------------------

    @property
    def parameters(self) -> list[tuple[str, Parameter]]:
        """Effect and parameter for every entry of `vector`."""
        return [(effect.id, p) for effect in self.effects for p in effect.parameters()]

    def vector(self) -> np.ndarray:
        """Return the parameters of all effects in fit coordinates.

        Returns
        -------
        ndarray, shape (P,)
            Dimensionless coordinates.
        """
        values = [p.to_fit(value) for e in self.effects for p, value in e.values().items()]
        return np.array(values, dtype=float)

    def with_vector(self, coordinates: np.ndarray) -> Model:
        """Return the same effects with other parameters.

        Parameters
        ----------
        coordinates : ndarray, shape (P,)
            Fit coordinates.

        Returns
        -------
        Model
            The new model.
        """
        rest = iter(np.asarray(coordinates, dtype=float).tolist())
        effects = tuple(
            type(effect)(**{p.field: p.from_fit(next(rest)) for p in effect.parameters()})
            for effect in self.effects
        )
        return replace(self, effects=effects)

    def answering(self, *hooks: str) -> tuple[Effect, ...]:
        """Return the effects that override one of several hooks.

        Parameters
        ----------
        *hooks : str
            Names of the hooks.

        Returns
        -------
        tuple of Effect
            In the order of the model.
        """
        return tuple(e for e in self.effects if any(e.overrides(hook) for hook in hooks))

    # Needs of the effects -----------------------------------------------------------------------

    @cached_property
    def needs_position(self) -> bool:
        """Whether velocities depend on places of particles."""
        return any(one.needs_position for one in self._terms)

    @cached_property
    def turns_by_place(self) -> bool:
        """Whether headings depend on places or identities of particles."""
        return any(term.needs_position and term.acts_on == 'heading' for term in self.learned)

    @cached_property
    def time_invariant(self) -> bool:
        """Whether the model is constant in time under a constant command."""
        return all(one.time_invariant for one in self._terms)

    @cached_property
    def lags(self) -> bool:
        """Whether headings turn at a finite rate, however fast: they then have a memory."""
        return any(effect.overrides('alignment_rate') for effect in self.effects)

    @property
    def alignment_time(self) -> float:
        """1/κ [s] at the reference field and the origin; 0 for immediate alignment."""
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
        """Delay of the field after the command [s]."""
        return sum(effect.latency() for effect in self.effects)

    def field(self, commanded: np.ndarray) -> np.ndarray:
        """Return the actual field of a commanded field (stage 1).

        Parameters
        ----------
        commanded : ndarray, shape (..., 2)
            Commanded field [T].

        Returns
        -------
        ndarray, shape (..., 2)
            Field [T].
        """
        for effect in self.effects:
            commanded = effect.field(commanded)
        return commanded

    def heading_offset(self, context: EffectContext) -> np.ndarray | float:
        """Return the deviation of the demanded heading from θ_B + φ (stage 2).

        Parameters
        ----------
        context : EffectContext
            Times, fields and places.

        Returns
        -------
        ndarray, shape (..., 1 or N), or float
            Angle [rad].
        """
        return sum(one.heading_offset(context) for one in self._terms)

    def alignment_rate(self, context: EffectContext) -> np.ndarray | None:
        """Return the rate κ of dθ/dt = κ sin(θ_B + φ − θ) (stage 2).

        Parameters
        ----------
        context : EffectContext
            Times, fields and places.

        Returns
        -------
        ndarray, shape (..., 1 or N), or None
            κ [1/s]; None for immediate alignment.
        """
        rates = (effect.alignment_rate(context) for effect in self.effects)
        return next((rate for rate in rates if rate is not None), None)

    def speed_factor(self, context: EffectContext) -> np.ndarray | float:
        """Return the factor on a particle's `speed` (stage 3).

        Parameters
        ----------
        context : EffectContext
            Times, fields and places.

        Returns
        -------
        ndarray, shape (..., 1 or N), or float
            Factor; for rollers it includes the frequency [Hz].
        """
        factor: np.ndarray | float = context.frequency if self.propulsion == 'rolling' else 1.0
        for effect in self.effects:
            if effect.stage == 'velocity':
                factor = factor * effect.speed_factor(context)
        for term in self.learned:
            factor = factor * term.speed_factor(context)
        return factor

    def gain_change_since_start(self, t: float) -> complex:
        """Return the factor by which v e^{iφ} has changed since the start, by time alone.

        Parameters
        ----------
        t : float
            Time of the session [s].

        Returns
        -------
        complex
            Factor.
        """
        changed, zero = 1.0 + 0j, np.zeros(1)
        context = EffectContext(np.full(1, t), zero, np.zeros((1, 2)), zero, self.reference_field)
        terms: list[Effect | LearnedTerm] = [e for e in self.effects if not e.time_invariant]
        for one in (*terms, *(term for term in self.learned if term.against == 'time')):
            turn = np.exp(1j * one.heading_offset(context))
            changed *= complex(np.squeeze(one.speed_factor(context) * turn))
        return changed

    @property
    def drifts(self) -> tuple[Effect, ...]:
        """Effects that may add to the propulsion."""
        return tuple(e for e in self.effects if e.stage == 'velocity' and e.overrides('drift'))

    def drift(self, context: EffectContext) -> np.ndarray | None:
        """Return the velocity besides propulsion (stage 3).

        Parameters
        ----------
        context : EffectContext
            Times, fields and places.

        Returns
        -------
        ndarray, shape (..., 1 or N, 2), or None
            Velocity [m/s]; None for none.
        """
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
        """Convert true positions to those that the camera reports (stage 4).

        Parameters
        ----------
        position : ndarray, shape (..., 2)
            True positions [m].

        Returns
        -------
        ndarray, shape (..., 2)
            Reported positions [m].
        """
        for effect in self.effects:
            position = effect.observe(position)
        return position

    @property
    def stretch(self) -> tuple[float, float]:
        """Factors by which lengths of random direction appear larger along x and along y."""
        x, y = np.linalg.norm(self.observe(np.eye(2)), axis=0)
        return float(x), float(y)

    def true_position(self, observed: np.ndarray) -> np.ndarray:
        """Convert reported positions to true ones, the inverse of `observe`.

        Parameters
        ----------
        observed : ndarray, shape (..., 2)
            Reported positions [m].

        Returns
        -------
        ndarray, shape (..., 2)
            True positions [m].
        """
        for effect in reversed(self.effects):
            observed = effect.true_position(observed)
        return observed
