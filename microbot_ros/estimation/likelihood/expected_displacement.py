"""What a model expects of every frame, as displacements accumulated since the first."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ros.model.increments import respond
from microbot_ros.model.model import Model
from microbot_ros.model.physics.vectors import as_complex
from microbot_ros.model.timeline import Timeline


@dataclass(frozen=True)
class ExpectedDisplacement:
    """Complex displacements [m] since the first frame, before v e^{iφ} is known.

    A particle with v e^{iφ} = a + ib is at `offset` [m] + a·`along` + b·`across`, each
    (T, 1 or N); `along` and `across` [s], for rollers [s·Hz]. `isotropic`: across is i·along, as
    it is where pixels are square.
    """

    offset: np.ndarray
    along: np.ndarray
    across: np.ndarray
    isotropic: bool

    @classmethod
    def of(cls, model: Model, timeline: Timeline) -> ExpectedDisplacement:
        """Of a `model` at the frames of a `timeline`; a particle not in view does not move."""
        response = respond(model, timeline)
        if not any(effect.stage == 'observation' for effect in model.effects):
            along = _accumulate(response.propulsion)
            still = model.is_first_order
            offset = np.zeros_like(along) if still else _accumulate(as_complex(response.drift))
            return cls(offset, along, 1j * along, True)
        columns = response.columns()
        along, across = (_accumulate(as_complex(columns[..., k])) for k in (0, 1))
        return cls(_accumulate(as_complex(response.offset())), along, across, False)

    def at(self, velocity_phasor: np.ndarray) -> np.ndarray:
        """Displacements (T, N) [m] of particles with `velocity_phasor` v e^{iφ} (N,)."""
        own = self.along * velocity_phasor if self.isotropic else (
            self.along * velocity_phasor.real + self.across * velocity_phasor.imag)
        moved: np.ndarray = self.offset + own
        return moved

    def beyond(self, other: ExpectedDisplacement, velocity_phasor: np.ndarray) -> np.ndarray:
        """How much further (T, N) [m] particles of that `velocity_phasor` are than by an `other`.
        """
        if not (self.isotropic and other.isotropic):
            return self.at(velocity_phasor) - other.at(velocity_phasor)
        # What all particles share is compared once.
        further: np.ndarray = (self.offset - other.offset) + (
            self.along - other.along) * velocity_phasor
        return further


def _accumulate(steps: np.ndarray) -> np.ndarray:
    """Sums (T, N) of steps (T−1, N); a particle that is not in view makes none."""
    sums = np.zeros((len(steps) + 1, steps.shape[1]), complex)
    known = np.isfinite(steps)
    np.cumsum(steps if known.all() else np.where(known, steps, 0), axis=0, out=sums[1:])
    return sums
