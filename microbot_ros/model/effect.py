"""Contract of an effect: a named, parametrised change to one of the model's four stages."""

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
"""Stage of the model that an effect changes."""

STAGES: tuple[str, ...] = get_args(Stage)
"""All stages, in the order in which they act."""


@dataclass(frozen=True)
class Effect(ABC):
    """Base class of effects; each overrides the hooks that it changes.

    Fields are the parameters in SI, declared with `parameter(...)`. Hooks broadcast over leading
    time axes and over particles; returned arrays may have size 1 where nothing varies.
    """

    id: ClassVar[str]
    """Unique name."""

    stage: ClassVar[Stage]
    """Stage that it changes."""

    summary: ClassVar[str]
    """One sentence for people."""
    required_excitation: ClassVar[str]
    """Excitation that makes it visible."""
    confounded_with: ClassVar[tuple[str, ...]]
    """Effects that look alike under ordinary commands."""
    needs_position: ClassVar[bool] = False
    """Whether a hook reads `context.position` or the pairs."""
    proportional: ClassVar[bool] = False
    """Whether it is only a `drift` that is linear in its strengths, which saves time in fits."""
    time_invariant: ClassVar[bool] = True
    """Whether it is constant in time under a constant command."""
    prior: ClassVar[tuple[float, float]] = (0.01, 10.0)
    """Prior of the strengths: normal with mean 0 and a standard deviation that is log-uniform
    between these two, in units of `scale`."""
    lookalike_time: ClassVar[float] = 0.0
    """Time [s] of recording for which an unlisted field of place, or change in time, may look like
    this effect. A search that drives a rig does not end on the name before."""
    is_drive_curve: ClassVar[bool] = False
    """Whether it is a curve of the speed over the drive's frequency. The scatter of the gains at
    the levels of the drive about the curve then judges it too."""

    @classmethod
    @cache
    def parameters(cls) -> tuple[Parameter, ...]:
        """Return the parameters in the order of the fields.

        Returns
        -------
        tuple of Parameter
            One for each field.
        """
        return tuple(field.metadata['parameter'] for field in dataclasses.fields(cls))

    @classmethod
    def defaults(cls) -> dict[str, float]:
        """Return the default values of optional fields.

        Returns
        -------
        dict of str to float
            By name of the field, SI.
        """
        return {
            field.name: field.default for field in dataclasses.fields(cls)
            if field.default is not dataclasses.MISSING
        }

    @classmethod
    def null(cls) -> Self:
        """Make the effect of strength zero.

        Returns
        -------
        Effect
            An effect that changes nothing.
        """
        return cls(**{p.field: p.null_value for p in cls.parameters()})

    @classmethod
    def overrides(cls, hook: str) -> bool:
        """Return whether the class overrides a hook.

        Parameters
        ----------
        hook : str
            Name of the hook.

        Returns
        -------
        bool
            Whether it does.
        """
        return getattr(cls, hook) is not getattr(Effect, hook)

    def values(self) -> dict[Parameter, float]:
        """Return all parameters with their values.

        Returns
        -------
        dict of Parameter to float
            Values in SI.
        """
        return {p: getattr(self, p.field) for p in self.parameters()}

    # Stage 1, the field -------------------------------------------------------------------------

    def latency(self) -> float:
        """Return the delay of the field after the command (stage 1).

        Returns
        -------
        float
            Delay [s].
        """
        return 0.0

    def field(self, B: np.ndarray) -> np.ndarray:
        """Change the field (stage 1).

        Parameters
        ----------
        B : ndarray, shape (..., 2)
            Field after the effects before this one [T].

        Returns
        -------
        ndarray, shape (..., 2)
            Field [T].
        """
        return B

    # Stage 2, the heading -----------------------------------------------------------------------

    def heading_offset(self, context: EffectContext) -> np.ndarray | float:
        """Return an angle added to the heading that the field demands (stage 2).

        Parameters
        ----------
        context : EffectContext
            Times, fields and places.

        Returns
        -------
        ndarray, shape (..., 1 or N), or float
            Angle [rad].
        """
        return 0.0

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
        return None

    # Stage 3, the velocity ----------------------------------------------------------------------

    def speed_factor(self, context: EffectContext) -> np.ndarray | float:
        """Return a factor on the self-propulsion (stage 3).

        Parameters
        ----------
        context : EffectContext
            Times, fields and places.

        Returns
        -------
        ndarray, shape (..., 1 or N), or float
            Factor, averaged over the context's span.
        """
        return 1.0

    def drift(self, context: EffectContext) -> np.ndarray | None:
        """Return a velocity added to the propulsion (stage 3).

        Parameters
        ----------
        context : EffectContext
            Times, fields and places.

        Returns
        -------
        ndarray, shape (..., 1 or N, 2), or None
            Velocity [m/s]; None for none.
        """
        return None

    # Stage 4, the observation -------------------------------------------------------------------

    def observe(self, position: np.ndarray) -> np.ndarray:
        """Convert true positions to those that the camera reports (stage 4); linear.

        Parameters
        ----------
        position : ndarray, shape (..., 2)
            True positions [m].

        Returns
        -------
        ndarray, shape (..., 2)
            Reported positions [m].
        """
        return position

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
        return observed

    # Search for the effect ----------------------------------------------------------------------

    @classmethod
    def applies(cls, evidence: Evidence) -> bool:  # noqa: ARG003
        """Return whether data could show the effect; otherwise it is no candidate.

        Parameters
        ----------
        evidence : Evidence
            Recordings and residuals.

        Returns
        -------
        bool
            True by default.
        """
        return True

    @classmethod
    def absorbed_by_phi(cls, evidence: Evidence) -> bool:  # noqa: ARG003
        """Return whether φ absorbs the effect under the commands.

        It is then no candidate, which is remarked.

        Parameters
        ----------
        evidence : Evidence
            Recordings and residuals.

        Returns
        -------
        bool
            False by default.
        """
        return False

    @classmethod
    def starts(cls, evidence: Evidence) -> Sequence[Self]:
        """Return starting points of fits.

        Parameters
        ----------
        evidence : Evidence
            Recordings and residuals.

        Returns
        -------
        sequence of Effect
            At least one; each costs a fit.
        """
        return evidence.near_nothing(cls)

    @classmethod
    def degrees_of_freedom(cls, evidence: Evidence) -> int:  # noqa: ARG003
        """Return how many parameters the data let the effect fit.

        Parameters
        ----------
        evidence : Evidence
            Recordings and residuals.

        Returns
        -------
        int
            By default all parameters.
        """
        return len(cls.parameters())

    def trials(self, evidence: Evidence) -> float:
        """Return the number of independent places, widths, frequencies … that were tried.

        The p-value is corrected for it. An effect without a shape is tried once.

        Parameters
        ----------
        evidence : Evidence
            Recordings and residuals.

        Returns
        -------
        float
            At least 1.
        """
        return 1.0

    def shape_seen(self, evidence: Evidence) -> bool:
        """Return whether the data show the whole shape of the fitted effect.

        An effect of which the data show only a flank could stand in for anything smooth, and does
        not join a model. Nor does one with a strength at a physical bound: then something else is
        the cause.

        Parameters
        ----------
        evidence : Evidence
            Recordings and residuals.

        Returns
        -------
        bool
            By default whether all strengths are within their bounds.
        """
        return self.within_bounds()

    def below_floor(self) -> bool:
        """Return whether all strengths are below the floors of the instrument.

        Returns
        -------
        bool
            Whether an error of camera, time stamps or coils may cause the same.
        """
        return all(abs(value - p.null_value) < p.floor
                   for p, value in self.values().items() if not p.shape)

    def within_bounds(self) -> bool:
        """Return whether all strengths are inside their bounds.

        Returns
        -------
        bool
            True also for a null value on a bound.
        """
        for p, value in self.values().items():
            x, ends = p.to_fit(value), p.fit_bounds
            at_an_end = np.isclose(x, ends, rtol=1e-6, atol=1e-6).any() and abs(x) > 1e-6
            if not p.shape and (at_an_end or not ends[0] <= x <= ends[1]):
                return False
        return True


AnyEffect = TypeVar('AnyEffect', bound=Effect)
"""Any subclass of Effect."""


class Recorded(Protocol):
    """Protocol of one recording, such as `timeline.Timeline`.

    Attributes
    ----------
    commands : Commands
        Commands.
    times : ndarray, shape (T,)
        Times of the frames [s].
    positions : ndarray, shape (T, N, 2), or None
        Positions [m].
    """

    commands: Commands
    times: np.ndarray
    positions: np.ndarray | None


class Evidence(Protocol):
    """Protocol of recordings and the residuals of a fitted model, implemented by discovery.

    An effect sees nothing else: it states what makes it visible, and discovery judges all effects
    by the same rules.
    """

    @property
    def propulsion(self) -> Literal['catalytic', 'rolling']:
        """How the particles move."""

    @property
    def recordings(self) -> Sequence[Recorded]:
        """The recordings, one or more."""

    @property
    def duration(self) -> float:
        """Duration of the longest recording [s]."""

    @property
    def fastest(self) -> float:
        """Highest frequency that is searched [Hz], limited by the frame rate."""

    @property
    def frequencies(self) -> np.ndarray:
        """Distinct rotation frequencies (K,) [Hz], not negative, ascending."""

    @property
    def strength_known(self) -> bool:
        """Whether the strength of the field was recorded, not only its direction."""

    @property
    def has_neighbours(self) -> bool:
        """Whether a recording has more than one particle."""

    def absorbs(self, little: Effect, beside: Sequence[Effect] = ()) -> bool:
        """Return whether speeds and φ absorb a weak effect, so that it cannot be identified.

        Parameters
        ----------
        little : Effect
            The effect at a small strength.
        beside : sequence of Effect, optional
            Other effects at small strengths that absorb it too.

        Returns
        -------
        bool
            Whether hardly any of its information remains.
        """

    def near_nothing(self, kind: type[AnyEffect]) -> Sequence[AnyEffect]:
        """Return starting points of small strength.

        Parameters
        ----------
        kind : type of Effect
            The effect.

        Returns
        -------
        sequence of Effect
            For one parameter also the best of a coarse grid.
        """

    def swings(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the residual as a sum of oscillations.

        Returns
        -------
        frequencies : ndarray, shape (F,)
            Frequencies [Hz], from one period per recording to `fastest`.
        forward, backward : ndarray of complex, shape (F,)
            Amplitudes of the parts that rotate either way.
        """

    def is_line(self, effect: Effect, frequency: float, direction: float) -> bool:
        """Return whether the residual without a fitted effect has a peak at a frequency.

        Parameters
        ----------
        effect : Effect
            Effect of the fit.
        frequency : float
            Its frequency [Hz].
        direction : float
            Direction of its motion [rad].

        Returns
        -------
        bool
            Whether the peak is above the noise around it: False for a part of broad noise.
        """

    def likely(self, starts: Iterable[AnyEffect],
               near: Callable[[AnyEffect, AnyEffect], bool]) -> Sequence[AnyEffect]:
        """Return the starting points whose drift, at strength 1, best matches the residual.

        A coarse search for slow drifts with one strength.

        Parameters
        ----------
        starts : iterable of Effect
            Starting points.
        near : callable
            Whether two starting points are too close to be both returned.

        Returns
        -------
        sequence of Effect
            A few of them.
        """

    def promising(self, starts: Iterable[AnyEffect],
                  price: Callable[[AnyEffect], float] = ...,
                  ) -> Sequence[AnyEffect]:
        """Return the starting points that are worth a fit, each with its best strength.

        For effects with one linear strength.

        Parameters
        ----------
        starts : iterable of Effect
            Starting points.
        price : callable, optional
            Likelihood ratio that a start must gain because it is one of many.

        Returns
        -------
        sequence of Effect
            A few of them.
        """

    def deviations(self, effect: Effect) -> Mapping[str, float]:
        """Return the standard deviation of each field of a fitted effect.

        Parameters
        ----------
        effect : Effect
            An effect of the fitted model.

        Returns
        -------
        mapping of str to float
            SI; may be infinite.
        """
