"""What an effect may ask of the recordings that are searched for it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Literal, Protocol, TypeVar

import numpy as np

from microbot_ros.common.records import Commands

if TYPE_CHECKING:
    from microbot_ros.model.effect import Effect

AnyEffect = TypeVar('AnyEffect', bound='Effect')


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
