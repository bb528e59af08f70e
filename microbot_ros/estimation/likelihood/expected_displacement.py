"""Expected displacement since the first frame, by a model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ros.model.increments import respond
from microbot_ros.model.model import Model
from microbot_ros.model.physics.vectors import as_complex
from microbot_ros.model.timeline import Timeline


@dataclass(frozen=True)
class ExpectedDisplacement:
    """Complex displacements [m] since the first frame, for any v e^{iφ}.

    A particle with v e^{iφ} = a + ib is displaced by `offset` + a·`along` + b·`across`.

    Attributes
    ----------
    offset : ndarray of complex, shape (T, 1 or N)
        Displacement by drift [m].
    along, across : ndarray of complex, shape (T, 1 or N)
        Displacement per unit v e^{iφ} [s], for rollers [s·Hz].
    isotropic : bool
        Whether `across` is i·`along`, as for square pixels.
    """

    offset: np.ndarray
    along: np.ndarray
    across: np.ndarray
    isotropic: bool

    @classmethod
    def of(cls, model: Model, timeline: Timeline) -> ExpectedDisplacement:
        """Compute the displacements of a model.

        Parameters
        ----------
        model : Model
            The model.
        timeline : Timeline
            Commands and frames. A particle out of view does not move.

        Returns
        -------
        ExpectedDisplacement
            At the frames of the timeline.
        """
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
        """Return the displacements of particles.

        Parameters
        ----------
        velocity_phasor : ndarray of complex, shape (N,)
            v e^{iφ} [m/s].

        Returns
        -------
        ndarray of complex, shape (T, N)
            Displacements [m].
        """
        own = self.along * velocity_phasor if self.isotropic else (
            self.along * velocity_phasor.real + self.across * velocity_phasor.imag)
        moved: np.ndarray = self.offset + own
        return moved

    def beyond(self, other: ExpectedDisplacement, velocity_phasor: np.ndarray) -> np.ndarray:
        """Return the displacements of particles, less those by another model.

        Parameters
        ----------
        other : ExpectedDisplacement
            Displacements by the other model.
        velocity_phasor : ndarray of complex, shape (N,)
            v e^{iφ} [m/s].

        Returns
        -------
        ndarray of complex, shape (T, N)
            Differences [m].
        """
        if not (self.isotropic and other.isotropic):
            return self.at(velocity_phasor) - other.at(velocity_phasor)
        # Columns that all particles share are subtracted once.
        further: np.ndarray = (self.offset - other.offset) + (
            self.along - other.along) * velocity_phasor
        return further


def _accumulate(steps: np.ndarray) -> np.ndarray:
    """Return sums (T, N) of steps (T − 1, N); a particle out of view makes none."""
    sums = np.zeros((len(steps) + 1, steps.shape[1]), complex)
    known = np.isfinite(steps)
    np.cumsum(steps if known.all() else np.where(known, steps, 0), axis=0, out=sums[1:])
    return sums
