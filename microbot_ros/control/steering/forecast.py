"""Where particles will be when a command given now takes effect."""

from __future__ import annotations

import cmath
import math

import numpy as np

from microbot_ros.common.compiled import numba
from microbot_ros.control.contract import ControllerInput
from microbot_ros.control.field_record import FieldRecord

KNOWN_WELL_ENOUGH = 0.5
"""Standard deviation of φ [rad] up to which a forecast beats the measured position."""


def look_ahead(inputs: ControllerInput, record: FieldRecord) -> np.ndarray:
    """Where the particles of `inputs` will be (N, 2) [m], by the first-order model.

    A particle moves v e^{iφ} ∫u dt, under the fields of a `record`, from its exposure until a
    command of now takes effect. Where φ is not known well enough to do better, the measured
    position stands.
    """
    rolling = inputs.model is not None and inputs.model.propulsion == 'rolling'
    shared = record.shared(inputs.t - inputs.age, inputs.t + inputs.delay, rolling)
    expected: np.ndarray = _moved(
        inputs.position, inputs.speed, inputs.phi, inputs.phi_std, shared)
    return expected


@numba.njit(cache=True)
def _moved(position, speed, phi, phi_std, shared):  # type: ignore[no-untyped-def]
    expected = position.copy()
    for n in range(len(speed)):
        if (math.isfinite(phi[n]) and phi_std[n] <= KNOWN_WELL_ENOUGH
                and math.isfinite(speed[n])):
            way = cmath.rect(speed[n], phi[n]) * shared
            expected[n, 0] += way.real
            expected[n, 1] += way.imag
    return expected
