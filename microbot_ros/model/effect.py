"""The contract of an effect: a named, parametrised change to one of the model's four stages."""

from __future__ import annotations

import dataclasses
from abc import ABC
from dataclasses import dataclass
from functools import cache
from typing import ClassVar, Literal, Protocol, Self

import numpy as np

from microbot_ros.model.effect_context import EffectContext
from microbot_ros.model.parameter import Parameter
from microbot_ros.records import Commands

Stage = Literal['field', 'heading', 'velocity', 'observation']


class Recorded(Protocol):
    """What one recording shows, as far as an effect may ask; `timeline.Timeline` is one.

    `times` (T,) [s] of the frames; `positions` (T, N, 2) [m] or None.
    """

    commands: Commands
    times: np.ndarray
    positions: np.ndarray | None


@dataclass(frozen=True)
class Effect(ABC):
    """Base of the effects; each overrides the one hook that it changes.

    Fields are the parameters in SI, declared with `parameter(...)`. Hooks broadcast over leading
    time axes and over particles; what they return may have size 1 where nothing varies.
    """

    id: ClassVar[str]
    stage: ClassVar[Stage]
    summary: ClassVar[str]
    """One sentence for people."""
    required_excitation: ClassVar[str]
    """The excitation that it needs to be seen."""
    confounded_with: ClassVar[tuple[str, ...]]
    """Effects that look alike under ordinary commands."""
    needs_position: ClassVar[bool] = False
    """Whether a hook reads `context.position` or the pairs."""
    proportional: ClassVar[bool] = False
    """Whether all it does is a `drift` that is linear in its strengths: fits use it to save time.
    """
    time_invariant: ClassVar[bool] = True
    """Whether it is the same at all times while the command stays."""

    @classmethod
    @cache
    def parameters(cls) -> tuple[Parameter, ...]:
        """The parameters in the order of the fields."""
        return tuple(field.metadata['parameter'] for field in dataclasses.fields(cls))

    @classmethod
    def defaults(cls) -> dict[str, float]:
        """The fields that need not be given, with their values."""
        return {
            field.name: field.default for field in dataclasses.fields(cls)
            if field.default is not dataclasses.MISSING
        }

    @classmethod
    def null(cls) -> Self:
        """The effect at strength zero: it does nothing."""
        return cls(**{p.field: p.null_value for p in cls.parameters()})

    @classmethod
    def starts(cls, recorded: Recorded) -> tuple[Self, ...]:  # noqa: ARG003
        """Where fits may begin: shapes spread over what was `recorded`, ≥ 1 instance."""
        return (cls.null(),)

    def values(self) -> dict[Parameter, float]:
        """Every parameter with its value in SI."""
        return {p: getattr(self, p.field) for p in self.parameters()}

    # Stage 1, the field -------------------------------------------------------------------------

    def latency(self) -> float:
        """Seconds by which the field follows the command late."""
        return 0.0

    def field(self, B: np.ndarray) -> np.ndarray:
        """The field (..., 2) [T] made of the field `B` (..., 2) that the effects before it left.
        """
        return B

    # Stage 2, the heading -----------------------------------------------------------------------

    def heading_offset(self, context: EffectContext) -> np.ndarray | float:
        """An angle (..., 1 or N) [rad] added to the heading that the field asks for."""
        return 0.0

    def alignment_rate(self, context: EffectContext) -> np.ndarray | None:
        """Rate κ (..., 1 or N) [1/s] of dθ/dt = κ sin(θ_B + φ − θ); None: aligned at once."""
        return None

    # Stage 3, the velocity ----------------------------------------------------------------------

    def speed_factor(self, context: EffectContext) -> np.ndarray | float:
        """A factor (..., 1 or N) on the self-propulsion, averaged over the context's span."""
        return 1.0

    def drift(self, context: EffectContext) -> np.ndarray | None:
        """Velocity (..., 1 or N, 2) [m/s] added to the propulsion; None: nothing."""
        return None

    # Stage 4, the observation -------------------------------------------------------------------

    def observe(self, position: np.ndarray) -> np.ndarray:
        """What the camera reports (..., 2) [m] of true positions (..., 2); linear."""
        return position

    def true_position(self, observed: np.ndarray) -> np.ndarray:
        """The inverse of `observe`: true positions (..., 2) [m] of `observed` ones (..., 2)."""
        return observed
