"""Parameter of an effect: name with unit, range, and fit coordinate."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

from microbot_ros.common import units


@dataclass(frozen=True)
class Parameter:
    """A parameter of an effect; all values in SI.

    A strength vanishes at `null_value`: an effect whose strengths are all there does nothing. A
    `shape` parameter (a place, a width, a frequency) means nothing without a strength.

    Attributes
    ----------
    name : str
        Name in files and on screens, with its unit as suffix.
    meaning : str
        A phrase for people.
    low, high : float
        Bounds.
    scale : float
        Typical size.
    null_value : float
        Value of a strength without effect; of a shape a placeholder.
    shape : bool
        Whether it is a shape.
    inverse : bool
        Whether the effect vanishes at infinity: the fit coordinate is then the reciprocal.
    floor : float
        Distance of a strength from `null_value` below which an error of camera, time stamps or
        coils may cause the same.
    """

    name: str
    meaning: str
    low: float
    high: float
    scale: float
    null_value: float = 0.0
    shape: bool = False
    inverse: bool = False
    floor: float = 0.0

    @property
    def field(self) -> str:
        """Name of the field that holds the value in SI, without unit: `wx` for `wx_um_s`."""
        return units.bare(self.name)

    @property
    def is_angle(self) -> bool:
        """Whether it has period 2π: the direction or the phase of a shape."""
        return self.shape and self.name.endswith('_rad')

    def to_fit(self, value: float) -> float:
        """Convert a value to the dimensionless coordinate of fits.

        Parameters
        ----------
        value : float
            Value, SI.

        Returns
        -------
        float
            0 at `null_value`.
        """
        return self.scale / value if self.inverse else (value - self.null_value) / self.scale

    def from_fit(self, coordinate: float) -> float:
        """Convert a fit coordinate to a value.

        Parameters
        ----------
        coordinate : float
            Dimensionless coordinate; beyond the bounds, as by rounding, it gives the bound.

        Returns
        -------
        float
            Value within the bounds, SI. The reciprocal of 0 is infinity.
        """
        if self.inverse:
            coordinate = max(coordinate, self.fit_bounds[0])
            value = self.scale / coordinate if coordinate else float('inf')
        else:
            value = self.null_value + coordinate * self.scale
        return min(max(value, self.low), self.high)

    @property
    def fit_bounds(self) -> tuple[float, float]:
        """Lower and upper bound of the fit coordinate."""
        ends = (self.to_fit(self.low), self.to_fit(self.high))
        return min(ends), max(ends)

    def display_units(self, value: float) -> float:
        """Convert a value to the unit of the name.

        Parameters
        ----------
        value : float
            Value, SI.

        Returns
        -------
        float
            Value in the unit of the name.
        """
        return units.from_si(self.name, value)


STAMPS = 3e-3
"""Floor [s] of a time.

The scatter of time stamps that a program gives to frames, and a bias of the tracker of 10 nm along
the heading at 3 µm/s. Measured through the real graph: delays of 1.5 to 2.1 ms were fitted that no
coil had. At half of it some would be named; at twice of it the delay of 4 ms in the benchmark of
discovery would not be.
"""

COILS = 2e-5
"""Floor [T] of a field.

The horizontal field of the Earth, in which every rig stands, and 0.4 % of 5 mT, to which currents
are read back. At half of it that field is named where tracks are long; at twice of it a magnet at
30 cm is missed.
"""

ALIKE = 0.01
"""Floor of a ratio or an angle [rad] of coils: 1 %, the tolerance of winding and mounting.

At half of it good coils are named in long recordings; at twice of it a lean of 1° is missed.
"""


def parameter(name: str, meaning: str, low: float, high: float, scale: float, *,
              default: float | None = None, **how: Any) -> Any:
    """Declare a `Parameter` as a dataclass field.

    Parameters
    ----------
    name, meaning, low, high, scale
        As for `Parameter`.
    default : float, optional
        Default value, which makes the field optional in files.
    **how
        Other attributes of `Parameter`.

    Returns
    -------
    dataclasses.Field
        The field.
    """
    declared = Parameter(name, meaning, low, high, scale, **how)
    metadata = {'parameter': declared}
    if default is None:
        return dataclasses.field(metadata=metadata)
    return dataclasses.field(default=default, metadata=metadata)
