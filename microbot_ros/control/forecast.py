"""Where particles will be when a command given now takes effect."""

from __future__ import annotations

import dataclasses

import numpy as np

from microbot_ros.control.contract import ControllerInput

KNOWN_WELL_ENOUGH = 0.5
"""Standard deviation of φ [rad] up to which a forecast beats the measured position."""


def look_ahead(inputs: ControllerInput) -> ControllerInput:
    """The `inputs` with `expected` (N, 2) filled in by the first-order model.

    A particle moves v e^{iφ} ∫u dt from its exposure until a command of now takes effect. Where
    φ is not known well enough to do better, the measured position stands.
    """
    rolling = inputs.model is not None and inputs.model.propulsion == 'rolling'
    begin, end = inputs.t - inputs.age, inputs.t + inputs.delay
    known = inputs.learned(KNOWN_WELL_ENOUGH) & np.isfinite(inputs.speed)
    velocity = inputs.speed[known] * np.exp(1j * inputs.phi[known])
    shared = inputs.record.shared(begin, end, rolling)
    moved = np.zeros((len(known), 2))
    moved[known] = (velocity * shared).view(float).reshape(-1, 2)
    return dataclasses.replace(inputs, expected=inputs.position + moved)
