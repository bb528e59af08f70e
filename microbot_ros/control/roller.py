"""Drives a rolling particle, whose speed follows the field's frequency: it can stop."""

from __future__ import annotations

import cmath
from dataclasses import dataclass
from typing import Any

import numpy as np

from microbot_ros import units
from microbot_ros.control.contract import (
    Controller,
    FieldCommand,
    ModelError,
    Progress,
    Situation,
    no_field,
)
from microbot_ros.control.itinerary import Itinerary
from microbot_ros.control.steering import Excitation, field_along
from microbot_ros.settings import setting


@dataclass(frozen=True)
class RollerParameters:
    """Whom to drive, how fast, and how closely."""

    particle: int = setting(
        -1, 'Identity of the particle to drive; -1 takes the one nearest to the first goal.',
        lower=-1, upper=2**31 - 1)
    field_mT: float = setting(5.0, 'Strength of the rotating field.', lower=0.01, upper=100.0)
    slowest_hz: float = setting(
        0.5, 'Below this frequency particles do not roll evenly.', lower=0.0, upper=1000.0)
    fastest_hz: float = setting(
        5.0, 'Highest frequency used, below the step-out.', lower=0.01, upper=1000.0)
    braking_s: float = setting(
        0.5, 'Time constant with which a goal is approached.', lower=0.02, upper=60.0)
    arrival_um: float = setting(
        0.5, 'A goal counts as reached from this close.', lower=0.05, upper=1000.0)
    learn_phi_std_rad: float = setting(
        0.2, 'The goal is headed for once φ is known this well.', lower=0.01, upper=1.5)
    learn_leg_s: float = setting(
        1.0, 'Until then: time on each side of a triangle.', lower=0.1, upper=60.0)


class Roller(Controller):
    """One roller through the goals in order, and at rest at the last.

    dp/dt = g f R(φ) u with the gain g [m/s/Hz]: the frequency f follows the distance, within
    the range in which particles roll evenly.
    """

    interface_version = 1
    summary = 'One rolling particle to a goal or through a list.'
    Parameters = RollerParameters

    def __init__(self) -> None:
        super().__init__()
        self.reset()

    def reset(self) -> None:
        """Forget the goals, how far they were done, and whom it drove."""
        self._itinerary = Itinerary()
        self._excitation = Excitation()

    def configure(self, parameters: Any) -> None:
        """ValueError where the slowest frequency lies above the fastest."""
        if not parameters.slowest_hz <= parameters.fastest_hz:
            raise ValueError(f'slowest_hz must be at most fastest_hz; received '
                             f'{parameters.slowest_hz:g} and {parameters.fastest_hz:g}')
        super().configure(parameters)

    def activate(self, situation: Situation) -> None:
        """ModelError where the model is of particles that do not roll."""
        self._excitation.stop()
        if situation.model is not None and situation.model.propulsion != 'rolling':
            raise ModelError('drives rollers; the model is of particles that propel themselves')
        if self.parameters.particle >= 0:
            situation.index(self.parameters.particle)

    def compute(self, situation: Situation) -> FieldCommand:
        """Direction and frequency towards the next goal."""
        p, itinerary = self.parameters, self._itinerary
        itinerary.update(situation, p.particle)
        if not len(itinerary):
            return no_field('waits for a goal')
        row = itinerary.row(situation)
        strength = units.to_si('field_mT', p.field_mT)
        fastest = min(p.fastest_hz, situation.limits.frequency)
        gain = float(situation.speed[row])
        if not (situation.learned(p.learn_phi_std_rad)[row] and gain > 0):
            return self._excitation.command(situation, p.learn_leg_s, strength, fastest)
        self._excitation.stop()
        arrival = units.to_si('arrival_um', p.arrival_um)
        offset = itinerary.offset(situation.expected[row], arrival)
        distance = abs(offset)
        progress = Progress(f'{itinerary}, {distance * 1e6:.1f} µm', itinerary.done, distance)
        if distance <= arrival:
            return FieldCommand(np.zeros(2), progress=progress)
        frequency = min(max(distance / (gain * p.braking_s), p.slowest_hz), fastest)
        angle = cmath.phase(offset) - situation.phi[row]
        return FieldCommand(field_along(situation, angle, strength), frequency, progress)
