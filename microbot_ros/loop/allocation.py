"""Fourth stage: from a field to the current of each coil, and back."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from microbot_ros.common.errors import InputError
from microbot_ros.common.files import read_yaml
from microbot_ros.common.settings import setting
from microbot_ros.drive.gate import Limits
from microbot_ros.drive.rotation import Turning
from microbot_ros.magnetics import Allocator, CoilSet, CoilSettings

_IN_PLANE = 1e-6
"""Choice: relative out-of-plane part below which a field counts as in the plane."""
_UPRIGHT = 1 - 1e-9  # choice: |cos| of the tilt above which an axis counts as vertical, 45 µrad


@dataclass(frozen=True)
class GateParameters:
    """Coils, and the limits of the gate for each of them. All are fixed at start-up."""

    coils_file: str = setting(
        '', 'YAML file with the coils; empty takes the default rig.', read_only=True)
    full_field_mT: float = setting(
        5.0, 'Strongest field that will be commanded. Limits that do not allow it, or its '
        'immediate reversal, are refused at start-up.', lower=0.001, upper=1000.0, read_only=True)
    current_limit_A: float = setting(
        2.0, 'Largest current the gate lets through.', lower=0.001, upper=100.0, read_only=True)
    step_limit_A: float = setting(
        4.0, 'Largest step of a current.', lower=0.001, upper=200.0, read_only=True)
    slew_limit_A_per_s: float = setting(
        200.0, 'Largest sustained rate of change of a current.', lower=0.01, upper=1e5,
        read_only=True)
    command_timeout_ms: float = setting(
        75.0, 'Time for which a nonzero command holds without a new one.', lower=10.0,
        upper=2000.0, read_only=True)
    deviation_A: float = setting(
        0.2, 'Largest deviation of a measured from the commanded current.', lower=0.001,
        upper=10.0, read_only=True)
    settling_ms: float = setting(
        100.0, 'Time allowed for a measured current to settle.', lower=1.0, upper=2000.0,
        read_only=True)
    feedback_timeout_ms: float = setting(
        200.0, 'Time for which currents may flow without a measurement.', lower=10.0, upper=5000.0,
        read_only=True)
    rated_current_A: float = setting(
        1.5, 'Continuous current rating of a coil.', lower=0.001, upper=100.0, read_only=True)
    thermal_s: float = setting(
        60.0, 'Thermal time constant of a coil.', lower=1.0, upper=3600.0, read_only=True)
    idle_disarm_s: float = setting(
        10.0, 'How long the gate stays armed without any command, zero included.', lower=0.5,
        upper=3600.0, read_only=True)


class AllocationStage:
    """Conversion from fields to the currents of the rig's coils.

    Raises InputError if the coil file of `parameters` cannot be read, and for limits that the
    first full field would violate.

    Parameters
    ----------
    parameters : GateParameters
        Coils and limits.
    """

    def __init__(self, parameters: GateParameters) -> None:
        file = parameters.coils_file
        self.coils = CoilSet(read_yaml(file, CoilSettings) if file else None)
        self._allocator = Allocator(self.coils)
        _refuse_contradictions(parameters, self._allocator)

    def step(self, field: np.ndarray) -> np.ndarray:
        """Return the currents (N,) [A] for a `field` (2,) or (3,) [T].

        NaN, which the gate latches as a fault, if the field is not finite. Raises ValueError if it
        has a part along z that the coils cannot make.

        Parameters
        ----------
        field : ndarray
            Field, (2,) in the plane or (3,) [T].

        Returns
        -------
        ndarray, shape (N,)
            Currents [A].
        """
        strength = math.hypot(*field.tolist())
        if not strength < math.inf:
            return np.full(len(self.coils.names), np.nan)
        return self._allocator.cheapest(self._within(field, strength))[0]

    def turn(self, field: np.ndarray, angular_velocity: np.ndarray) -> Turning:
        """Return the currents of a field that rotates about an axis.

        The part of the field along the axis is constant (the field moves on a cone), the rest
        rotates; if the currents would exceed the limits, the rotating part is reduced. NaN gives
        NaN, which the gate latches as a fault.

        Parameters
        ----------
        field : (3,) array [T]
            Field at the start of the rotation.
        angular_velocity : (3,) array [rad/s]
            Along the axis of the rotation.

        Returns
        -------
        Turning
            Currents as a function of the direction of the rotating part.

        Raises
        ------
        ValueError
            If the field has a part along z that the coils cannot make.
        """
        if not (np.isfinite(field).all() and np.isfinite(angular_velocity).all()):
            nothing = np.full(3, np.nan)
            return Turning(self.step(nothing), np.full((len(self.coils.names), 3), np.nan),
                           nothing, math.nan, nothing)
        rate = float(np.linalg.norm(angular_velocity))
        axis = angular_velocity / rate
        along = (field @ axis) * axis
        strength = float(np.linalg.norm(field - along))
        make = self._allocator.linear
        per_direction = strength * np.pad(make, ((0, 0), (0, 3 - make.shape[1])))
        if make.shape[1] < 3 and strength and not abs(axis[2]) > _UPRIGHT:
            raise ValueError('these coils make no field along z, which the rotation needs')
        steady = make @ (self._within(along, float(np.linalg.norm(field))) - self.coils.background)
        # Amplitude of the current of each coil: the length of its row perpendicular to the axis.
        across = per_direction - np.outer(per_direction @ axis, axis)
        largest = np.linalg.norm(across, axis=1)
        # A little less than what the gate allows: sums round.
        room = np.maximum((1 - 1e-9) * self.coils.reach - np.abs(steady), 0.0)
        share = np.min(np.divide(room, largest, where=largest > room, out=np.ones_like(room)))
        start = (field - along) / (strength or 1.0)
        return Turning(steady, share * per_direction, axis, rate, start, self.coils.driven)

    def _within(self, field: np.ndarray, strength: float) -> np.ndarray:
        """Return the field's components that the coils have; others must be negligible."""
        x, y, z = [*field.tolist(), 0.0][:3]
        if self.coils.axes == 3:
            return np.array([x, y, z])
        if abs(z) > _IN_PLANE * strength:
            raise ValueError(f'these coils make no field along z; commanded: {z * 1e3:.3g} mT')
        return np.array([x, y])

    def field(self, currents: np.ndarray) -> np.ndarray:
        """Return the field (2,) or (3,) [T] at the workspace centre for `currents` (N,) [A].

        Parameters
        ----------
        currents : ndarray, shape (N,)
            Current of each coil [A].

        Returns
        -------
        ndarray, shape (2,)
            Field or (3,) [T].
        """
        return self._allocator.field(currents)


def limits(values: GateParameters) -> Limits:
    """Return the limits of the gate in SI units from the parameter `values`.

    Parameters
    ----------
    values : GateParameters
        Parameters of the gate.

    Returns
    -------
    Limits
        The limits.
    """
    return Limits(
        current_A=values.current_limit_A, step_A=values.step_limit_A,
        slew_A_per_s=values.slew_limit_A_per_s,
        command_timeout_s=values.command_timeout_ms * 1e-3,
        deviation_A=values.deviation_A, settling_s=values.settling_ms * 1e-3,
        feedback_timeout_s=values.feedback_timeout_ms * 1e-3,
        rated_current_A=values.rated_current_A,
        thermal_s=values.thermal_s, idle_s=values.idle_disarm_s)


def _refuse_contradictions(values: GateParameters, allocator: Allocator) -> None:
    """Raise InputError for limits that the first full field would violate."""
    needed = allocator.largest_current(values.full_field_mT * 1e-3)
    reversal = 2 * needed
    for name, limit, least, what in (
            ('current_limit_A', values.current_limit_A, needed, 'needs'),
            ('step_limit_A', values.step_limit_A, reversal, 'needs to be reversed')):
        if not limit >= least:
            raise InputError(name, f'expected at least {math.ceil(least * 1e3) / 1e3:g} A, '
                                   f'which a field of {values.full_field_mT:g} mT {what} with '
                                   f'these coils; received {limit:g} A')
