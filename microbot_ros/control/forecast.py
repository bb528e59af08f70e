"""Where particles will be when a command given now takes effect."""

from __future__ import annotations

import dataclasses

import numpy as np

from microbot_ros.control.contract import Situation

KNOWN_WELL_ENOUGH = 0.5
"""Standard deviation of φ [rad] up to which a forecast beats the measured position."""


def look_ahead(situation: Situation) -> Situation:
    """The situation with `expected` (N, 2) filled in by the first-order model.

    A particle moves v e^{iφ} ∫u dt from its exposure until a command of now takes effect. Where
    φ is not known well enough to do better, the measured position stands.
    """
    rolling = situation.model is not None and situation.model.propulsion == 'rolling'
    begin, end = situation.t - situation.age, situation.t + situation.delay
    known = situation.learned(KNOWN_WELL_ENOUGH) & np.isfinite(situation.speed)
    velocity = situation.speed[known] * np.exp(1j * situation.phi[known])
    shared = situation.record.shared(begin, end, rolling)
    moved = np.zeros((len(known), 2))
    moved[known] = (velocity * shared).view(float).reshape(-1, 2)
    return dataclasses.replace(situation, expected=situation.position + moved)
