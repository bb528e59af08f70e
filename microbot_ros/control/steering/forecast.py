"""Predicted positions of particles when a command given now takes effect."""

from __future__ import annotations

import cmath
import math

import numpy as np

from microbot_ros.common.compiled import numba
from microbot_ros.control.contract import ControllerInput
from microbot_ros.control.field_record import FieldRecord

KNOWN_WELL_ENOUGH = 0.5
"""Choice: standard deviation of φ [rad] up to which a forecast replaces the measured position."""


def look_ahead(inputs: ControllerInput, record: FieldRecord) -> np.ndarray:
    """Predict the positions (N, 2) [m] of `inputs` by the first-order model.

    A particle moves by v e^{iφ} ∫u dt, under the fields of `record`, from its exposure until a
    command given now takes effect. If φ is not known well enough, the measured position is
    returned.

    Parameters
    ----------
    inputs : ControllerInput
        Input of the tick.
    record : FieldRecord
        Commands of the past.

    Returns
    -------
    ndarray, shape (N, 2)
        Positions [m].
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
