"""A sphere in a fluid at low Reynolds number: drag, diffusion and the times that follow.

Stokes' drag on a translating and a rotating sphere far from neighbours, and from walls but for
the floor that a `Fluid` may have; diffusion by the Einstein relation (Happel & Brenner, "Low
Reynolds number hydrodynamics", 1983). Every function takes one radius or an array of them and
returns the same shape. ValueError where a sphere does not fit above the floor.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from microbot_ros.common.units import BOLTZMANN
from microbot_ros.model.physics.floor import rolling_factor, sliding_factor, spinning_factor

Values = TypeVar('Values', float, np.ndarray)


@dataclass(frozen=True)
class Fluid:
    """What the particle swims in, and where: viscosity [Pa·s], temperature [K].

    `height` [m] of its centre above a floor; None is far from any. ValueError unless all are
    positive and finite.
    """

    viscosity: float
    temperature: float = 298.15
    height: float | None = None

    def __post_init__(self) -> None:
        _require_positive('viscosity [Pa·s]', self.viscosity)
        _require_positive('temperature [K]', self.temperature)
        if self.height is not None:
            _require_positive('height [m]', self.height)


@dataclass(frozen=True)
class Particle:
    """One sphere: radius [m], mass [kg], propulsive force [N], offset φ [rad], moment [A·m²].

    `phi` is the angle from the field to the direction of travel. ValueError unless radius and mass
    are positive and finite and the rest is finite.
    """

    radius: float
    mass: float
    force: float
    phi: float = 0.0
    moment: float = 0.0

    def __post_init__(self) -> None:
        _require_positive('radius [m]', self.radius)
        _require_positive('mass [kg]', self.mass)
        for name in ('force', 'phi', 'moment'):
            if not math.isfinite(getattr(self, name)):
                raise ValueError(f'{name} must be finite; received {getattr(self, name)!r}')

    @property
    def moment_of_inertia(self) -> float:
        """Of a uniform solid sphere, ⅖ m r² [kg·m²]."""
        return 0.4 * self.mass * self.radius**2


def _require_positive(name: str, value: float) -> None:
    if not 0 < value < math.inf:
        raise ValueError(f'{name} must be positive and finite; received {value!r}')


def stokes_drag(fluid: Fluid, radius: Values) -> Values:
    """Translational drag coefficient 6πηr [N·s/m] of a sphere of `radius` r [m].

    Above a floor, of moving along it.
    """
    return _near_floor(6 * math.pi * fluid.viscosity * radius, sliding_factor, fluid, radius)


def rotational_drag(fluid: Fluid, radius: Values) -> Values:
    """Rotational drag coefficient 8πηr³ [N·m·s] of a sphere of `radius` r [m].

    Above a floor, of turning about the axis across it, as a heading in the plane does.
    """
    return _near_floor(8 * math.pi * fluid.viscosity * radius**3, spinning_factor, fluid, radius)


def rolling_drag(fluid: Fluid, radius: Values) -> Values:
    """Rotational drag coefficient [N·m·s] of a sphere of `radius` r [m] about an axis along the
    floor; 8πηr³ without one.
    """
    return _near_floor(8 * math.pi * fluid.viscosity * radius**3, rolling_factor, fluid, radius)


def _near_floor(bulk: Values, factor: Callable[..., Any], fluid: Fluid, radius: Values) -> Values:
    if fluid.height is None:
        return bulk
    raised: Values = bulk * factor(fluid.height, radius)
    return raised


def translational_diffusion(fluid: Fluid, radius: Values) -> Values:
    """Stokes–Einstein kT/(6πηr) [m²/s], `radius` r [m]: each coordinate spreads as √(2Dt)."""
    return BOLTZMANN * fluid.temperature / stokes_drag(fluid, radius)


def rotational_diffusion(fluid: Fluid, radius: Values) -> Values:
    """Stokes–Einstein–Debye kT/(8πηr³) [rad²/s], `radius` r [m]: the heading spreads as √(2 D_r
    t).
    """
    return BOLTZMANN * fluid.temperature / rotational_drag(fluid, radius)


def translational_time(fluid: Fluid, radius: Values, mass: Values) -> Values:
    """Time constant m/(6πηr) [s] with which the velocity of a `mass` [kg], `radius` [m] follows.
    """
    return mass / stokes_drag(fluid, radius)


def rotational_time(fluid: Fluid, radius: Values, mass: Values) -> Values:
    """Time constant I/(8πηr³) = m/(20πηr) [s] with which ω follows the torque.

    Of a uniform sphere of `radius` r [m] and `mass` m [kg]. Not the time in which the heading
    aligns with a field: that is `alignment_time`.
    """
    return 0.4 * mass * radius**2 / rotational_drag(fluid, radius)


def alignment_time(fluid: Fluid, radius: Values, moment: Values, field: Values) -> Values:
    """Time constant 8πηr³/(dB) [s] with which the heading turns into a field.

    `radius` r [m]; `moment` d [A·m²] and `field` B [T] are magnitudes. Where either is zero
    nothing turns the particle, and the time is infinite.
    """
    with np.errstate(divide='ignore'):
        time: Values = np.divide(rotational_drag(fluid, radius), np.multiply(moment, field))
    return time


def speed_from_force(fluid: Fluid, radius: Values, force: Values) -> Values:
    """Terminal speed F/(6πηr) [m/s] of a sphere of `radius` r [m] under a `force` F [N]."""
    return force / stokes_drag(fluid, radius)


def force_from_speed(fluid: Fluid, radius: Values, speed: Values) -> Values:
    """The force 6πηr·v [N], `radius` r [m], that Stokes' drag balances at a steady speed v [m/s].
    """
    return speed * stokes_drag(fluid, radius)


def sphere_mass(radius: Values, density: float) -> Values:
    """Mass [kg] of a sphere of the given `radius` [m] and density [kg/m³]."""
    return 4 / 3 * math.pi * radius**3 * density
