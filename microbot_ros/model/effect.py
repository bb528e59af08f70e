"""The contract of an effect: a named, parametrised change to one of the model's four stages."""

from __future__ import annotations

import dataclasses
from abc import ABC
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import ClassVar, Literal, Protocol, Self, TypeVar, get_args

import numpy as np

from microbot_ros.common.records import Commands
from microbot_ros.model.effect_context import EffectContext
from microbot_ros.model.parameter import Parameter

Stage = Literal['field', 'heading', 'velocity', 'observation']
STAGES: tuple[str, ...] = get_args(Stage)
"""In the order in which they act."""


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
    prior: ClassVar[tuple[float, float]] = (0.01, 10.0)
    """Prior of the strengths: normal about nothing, with a standard deviation between these two,
    in units of `scale`; every order of magnitude in between is equally likely."""
    lookalike_time: ClassVar[float] = 0.0
    """Seconds of recording for which a field of place, or a change in time, that no effect has may
    look like this effect. A search that drives a rig does not end on the name before."""
    is_drive_curve: ClassVar[bool] = False
    """Whether it is a curve of the speed over the drive's frequency: how the gains at the levels
    of the drive scatter about the curve then judges it too."""

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
    def overrides(cls, hook: str) -> bool:
        """Whether it answers a `hook`, by its name, with anything of its own."""
        return getattr(cls, hook) is not getattr(Effect, hook)

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

    # How it is looked for -----------------------------------------------------------------------

    @classmethod
    def applies(cls, evidence: Evidence) -> bool:  # noqa: ARG003
        """Whether the `evidence` could show it: else it is no candidate."""
        return True

    @classmethod
    def absorbed_by_phi(cls, evidence: Evidence) -> bool:  # noqa: ARG003
        """Whether φ absorbs it under the commands: then it is no candidate, which is remarked."""
        return False

    @classmethod
    def starts(cls, evidence: Evidence) -> Sequence[Self]:
        """Where fits may begin, one instance or more, each of which costs a fit."""
        return evidence.near_nothing(cls)

    @classmethod
    def degrees_of_freedom(cls, evidence: Evidence) -> int:  # noqa: ARG003
        """How many numbers the `evidence` lets it fit."""
        return len(cls.parameters())

    def trials(self, evidence: Evidence) -> float:
        """Independent places, widths, frequencies … at which it was looked for, ≥ 1.

        What its p-value pays for: an effect without a shape is looked for once.
        """
        return 1.0

    def shape_seen(self, evidence: Evidence) -> bool:
        """Whether the `evidence` shows its shape whole, now that it is fitted.

        What shows a flank only could stand in for anything smooth, and is not added to a model.
        Nor is what has a strength at a bound that physics sets: something else is there then.
        """
        return self.within_bounds()

    def below_floor(self) -> bool:
        """Return whether all strengths are below what the instrument can be trusted with."""
        return all(abs(value - p.null_value) < p.floor
                   for p, value in self.values().items() if not p.shape)

    def within_bounds(self) -> bool:
        """Whether all strengths lie inside their bounds; doing nothing does, even at a bound."""
        for p, value in self.values().items():
            x, ends = p.to_fit(value), p.fit_bounds
            at_an_end = np.isclose(x, ends, rtol=1e-6, atol=1e-6).any() and abs(x) > 1e-6
            if not p.shape and (at_an_end or not ends[0] <= x <= ends[1]):
                return False
        return True


AnyEffect = TypeVar('AnyEffect', bound=Effect)


class Recorded(Protocol):
    """One recording; `timeline.Timeline` is one.

    `times` (T,) [s] of the frames; `positions` (T, N, 2) [m] or None.
    """

    commands: Commands
    times: np.ndarray
    positions: np.ndarray | None


class Evidence(Protocol):
    """The recordings, and what a model that was fitted to them leaves; discovery has the one.

    An effect never sees more: it says what it would take to be seen, and discovery judges all
    alike.
    """

    @property
    def propulsion(self) -> Literal['catalytic', 'rolling']:
        """How the particles move."""

    @property
    def recordings(self) -> Sequence[Recorded]:
        """The recordings, one or more."""

    @property
    def duration(self) -> float:
        """Of the longest recording [s]."""

    @property
    def fastest(self) -> float:
        """The highest frequency that the frames can show and that is looked at [Hz]."""

    @property
    def frequencies(self) -> np.ndarray:
        """The different rotation frequencies that were used (K,) [Hz], not negative, ascending."""

    @property
    def strength_known(self) -> bool:
        """Whether the strength of the field was told, not only its direction."""

    @property
    def has_neighbours(self) -> bool:
        """Whether a recording has more than one particle."""

    def absorbs(self, little: Effect, beside: Sequence[Effect] = ()) -> bool:
        """Whether speeds and φ absorb a `little` of an effect, so that it can't be told.

        Together with a little of the effects `beside`.
        """

    def near_nothing(self, kind: type[AnyEffect]) -> Sequence[AnyEffect]:
        """Of a `kind`, with little strength; for one parameter the best of a coarse row too."""

    def swings(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What is left, as a sum of swings: frequencies (F,) [Hz], from one period a recording to
        `fastest`, and the complex amplitudes (F,) of what turns forwards, and backwards.
        """

    def likely(self, starts: Iterable[AnyEffect],
               near: Callable[[AnyEffect, AnyEffect], bool]) -> Sequence[AnyEffect]:
        """A few of many `starts` whose drift, at the strength 1, is most like what is left.

        A coarse look for slow drifts with one strength; none is `near` another.
        """

    def promising(self, starts: Iterable[AnyEffect],
                  price: Callable[[AnyEffect], float] = ...,
                  ) -> Sequence[AnyEffect]:
        """The few of `starts` that are worth a fit, each with the strength that suits best.

        For effects with one linear strength. `price` is the likelihood ratio that a start has to
        bring for being one of many alike.
        """

    def deviations(self, effect: Effect) -> Mapping[str, float]:
        """The standard deviation of each field of a fitted `effect`, in SI; may be infinite."""
