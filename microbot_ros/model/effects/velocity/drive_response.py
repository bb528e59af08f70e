"""Speed of rollers that is not proportional to the frequency of the drive."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from microbot_ros.model.effect import Effect, Evidence
from microbot_ros.model.effect_context import EffectContext
from microbot_ros.model.parameter import parameter


@dataclass(frozen=True)
class DriveResponse(Effect):
    """v = gain · f · r(f), with r = c(f) · (1 − slip · s(f)).

    c = fⁿ/(fⁿ + f_cⁿ) rises from 0 to 1 about the cut-in f_c, below which the particle hardly
    follows. s = fᵐ/(fᵐ + f_sᵐ) rises about the step-out f_s, above which the gain has lost the
    part `slip`: all of it where the particle loses the field (slip 1), some where it slides. f_c
    is at most f_s: a particle follows before it loses the field. The gain is that of proportional
    rolling between the two, so it stays identifiable. Hill’s curve covers the known shapes: a dead
    zone f − f_c (n near 1), a threshold (large n), the 1/f² of a rotor beyond step-out (slip 1, m
    near 2 to 4).
    """

    id = 'drive_response'
    stage = 'velocity'
    summary = 'The rolling speed is not proportional to the frequency: cut-in, slip or step-out.'
    required_excitation = (
        'several rotation frequencies, in an order that does not follow time')
    confounded_with = ('speed_decay', 'incomplete_alignment', 'coil_pull')
    is_drive_curve = True

    cut_in: float = parameter('cut_in_hz', 'frequency of half the gain', 0.0, 20.0, 1.0)
    slip: float = parameter('slip', 'fraction of the gain that is lost above it', -2.0, 1.0, 0.3)
    step_out: float = parameter(
        'step_out_hz', 'frequency at which half the slip is reached', 0.1, 200.0, 10.0,
        null_value=10.0, shape=True,
    )
    cut_in_steepness: float = parameter(
        'cut_in_steepness', 'n', 0.5, 16.0, 2.0, null_value=2.0, shape=True, default=2.0,
    )
    step_out_steepness: float = parameter(
        'step_out_steepness', 'm', 0.5, 16.0, 4.0, null_value=4.0, shape=True, default=4.0,
    )

    def speed_factor(self, context: EffectContext) -> np.ndarray:
        f = np.abs(context.frequency)
        follows = hill(f, min(self.cut_in, self.step_out), self.cut_in_steepness)
        return follows * (1 - self.slip * hill(f, self.step_out, self.step_out_steepness))

    @classmethod
    def applies(cls, evidence: Evidence) -> bool:
        return evidence.propulsion == 'rolling' and len(evidence.frequencies) > 1

    @classmethod
    def degrees_of_freedom(cls, evidence: Evidence) -> int:
        return min(len(cls.parameters()), len(evidence.frequencies) - 1)

    def shape_seen(self, evidence: Evidence) -> bool:
        """Return True: its bounds are limits of the curve, as a slip of the whole gain."""
        return True

    @classmethod
    def starts(cls, evidence: Evidence) -> Sequence[Self]:
        driven = evidence.frequencies[evidence.frequencies > 0]
        if not driven.size:
            return (cls.null(),)
        low, *corners = np.quantile(driven, [0.1, 0.25, 0.5, 0.75]).tolist()
        return tuple(cls(low / 2, slip, corner) for corner in corners for slip in (0.0, 0.5))


def hill(f: np.ndarray, half: float, steepness: float) -> np.ndarray:
    """Return Hill's curve fⁿ/(fⁿ + halfⁿ).

    Parameters
    ----------
    f : ndarray
        Frequencies, not negative [Hz].
    half : float
        Frequency at which the curve is one half [Hz].
    steepness : float
        n.

    Returns
    -------
    ndarray
        From 0 to 1; 1 everywhere for `half` = 0.
    """
    if half == 0:
        return np.ones_like(f)
    with np.errstate(divide='ignore', over='ignore'):
        return 1 / (1 + (half / f) ** steepness)
