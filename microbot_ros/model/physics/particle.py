"""A sphere in a fluid at low Reynolds number: drag, diffusion and time constants.

Stokes drag on a translating and a rotating sphere far from neighbours, and from walls except for
the floor that a `Fluid` may have; diffusion by the Einstein relation (Happel & Brenner, "Low
Reynolds number hydrodynamics", 1983). Every function takes one radius or an array and returns the
same shape. ValueError if a sphere does not fit above the floor.
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
"""A number or an array."""


@dataclass(frozen=True)
class Fluid:
    """The fluid, and the height of particles in it.

    Attributes
    ----------
    viscosity : float
        Viscosity [Pa·s].
    temperature : float
        Temperature [K].
    height : float or None
        Height of a particle's centre above a floor [m]; None far from any.

    Raises
    ------
    ValueError
        Unless all are positive and finite.
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
    """One sphere.

    Attributes
    ----------
    radius : float
        Radius [m].
    mass : float
        Mass [kg].
    force : float
        Propulsive force [N].
    phi : float
        Angle from the field to the direction of travel [rad].
    moment : float
        Magnetic moment [A·m²].

    Raises
    ------
    ValueError
        Unless radius and mass are positive and all numbers finite.
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
        """Moment of inertia of a uniform solid sphere, ⅖ m r² [kg·m²]."""
        return 0.4 * self.mass * self.radius**2


def _require_positive(name: str, value: float) -> None:
    if not 0 < value < math.inf:
        raise ValueError(f'{name} must be positive and finite; received {value!r}')


def stokes_drag(fluid: Fluid, radius: Values) -> Values:
    """Return the translational drag coefficient 6πηr; above a floor, for motion along it.

    Parameters
    ----------
    fluid : Fluid
        The fluid.
    radius : float or ndarray
        r [m].

    Returns
    -------
    float or ndarray
        Drag coefficient [N·s/m].
    """
    return _near_floor(6 * math.pi * fluid.viscosity * radius, sliding_factor, fluid, radius)


def rotational_drag(fluid: Fluid, radius: Values) -> Values:
    """Return the rotational drag coefficient 8πηr³.

    Above a floor, for rotation about its normal, as of a heading in the plane.

    Parameters
    ----------
    fluid : Fluid
        The fluid.
    radius : float or ndarray
        r [m].

    Returns
    -------
    float or ndarray
        Drag coefficient [N·m·s].
    """
    return _near_floor(8 * math.pi * fluid.viscosity * radius**3, spinning_factor, fluid, radius)


def rolling_drag(fluid: Fluid, radius: Values) -> Values:
    """Return the rotational drag coefficient about an axis along the floor; 8πηr³ without one.

    Parameters
    ----------
    fluid : Fluid
        The fluid.
    radius : float or ndarray
        r [m].

    Returns
    -------
    float or ndarray
        Drag coefficient [N·m·s].
    """
    return _near_floor(8 * math.pi * fluid.viscosity * radius**3, rolling_factor, fluid, radius)


def _near_floor(bulk: Values, factor: Callable[..., Any], fluid: Fluid, radius: Values) -> Values:
    if fluid.height is None:
        return bulk
    raised: Values = bulk * factor(fluid.height, radius)
    return raised


def translational_diffusion(fluid: Fluid, radius: Values) -> Values:
    """Return the diffusion coefficient kT/(6πηr) (Stokes–Einstein).

    Each coordinate spreads as √(2Dt).

    Parameters
    ----------
    fluid : Fluid
        The fluid.
    radius : float or ndarray
        r [m].

    Returns
    -------
    float or ndarray
        D [m²/s].
    """
    return BOLTZMANN * fluid.temperature / stokes_drag(fluid, radius)


def rotational_diffusion(fluid: Fluid, radius: Values) -> Values:
    """Return the rotational diffusion coefficient kT/(8πηr³) (Stokes–Einstein–Debye).

    The heading spreads as √(2 D_r t).

    Parameters
    ----------
    fluid : Fluid
        The fluid.
    radius : float or ndarray
        r [m].

    Returns
    -------
    float or ndarray
        D_r [rad²/s].
    """
    return BOLTZMANN * fluid.temperature / rotational_drag(fluid, radius)


def translational_time(fluid: Fluid, radius: Values, mass: Values) -> Values:
    """Return the time constant m/(6πηr) of the velocity.

    Parameters
    ----------
    fluid : Fluid
        The fluid.
    radius : float or ndarray
        r [m].
    mass : float or ndarray
        m [kg].

    Returns
    -------
    float or ndarray
        Time constant [s].
    """
    return mass / stokes_drag(fluid, radius)


def rotational_time(fluid: Fluid, radius: Values, mass: Values) -> Values:
    """Return the time constant I/(8πηr³) = m/(20πηr) of the angular velocity of a uniform sphere.

    It is not the time in which the heading aligns with a field: that is `alignment_time`.

    Parameters
    ----------
    fluid : Fluid
        The fluid.
    radius : float or ndarray
        r [m].
    mass : float or ndarray
        m [kg].

    Returns
    -------
    float or ndarray
        Time constant [s].
    """
    return 0.4 * mass * radius**2 / rotational_drag(fluid, radius)


def alignment_time(fluid: Fluid, radius: Values, moment: Values, field: Values) -> Values:
    """Return the time constant 8πηr³/(dB) with which the heading aligns with a field.

    Parameters
    ----------
    fluid : Fluid
        The fluid.
    radius : float or ndarray
        r [m].
    moment : float or ndarray
        Magnitude of the moment d [A·m²].
    field : float or ndarray
        Magnitude of the field B [T].

    Returns
    -------
    float or ndarray
        Time constant [s]; infinite if moment or field is zero.
    """
    with np.errstate(divide='ignore'):
        time: Values = np.divide(rotational_drag(fluid, radius), np.multiply(moment, field))
    return time


def speed_from_force(fluid: Fluid, radius: Values, force: Values) -> Values:
    """Return the terminal speed F/(6πηr).

    Parameters
    ----------
    fluid : Fluid
        The fluid.
    radius : float or ndarray
        r [m].
    force : float or ndarray
        F [N].

    Returns
    -------
    float or ndarray
        Speed [m/s].
    """
    return force / stokes_drag(fluid, radius)


def force_from_speed(fluid: Fluid, radius: Values, speed: Values) -> Values:
    """Return the force 6πηr·v that Stokes drag balances at a steady speed.

    Parameters
    ----------
    fluid : Fluid
        The fluid.
    radius : float or ndarray
        r [m].
    speed : float or ndarray
        v [m/s].

    Returns
    -------
    float or ndarray
        Force [N].
    """
    return speed * stokes_drag(fluid, radius)


def sphere_mass(radius: Values, density: float) -> Values:
    """Return the mass of a sphere.

    Parameters
    ----------
    radius : float or ndarray
        Radius [m].
    density : float
        Density [kg/m³].

    Returns
    -------
    float or ndarray
        Mass [kg].
    """
    return 4 / 3 * math.pi * radius**3 * density
