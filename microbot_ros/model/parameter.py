"""One number of an effect: its name with its unit, its range, the coordinate it is fitted in."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

from microbot_ros.common import units


@dataclass(frozen=True)
class Parameter:
    """A parameter of an effect; all values in SI.

    `name` is the name in files and on screens, with its unit as suffix, `meaning` one phrase for
    people; the field that holds it in SI is `field`, the name without the unit. `low` and `high`
    bound it, `scale` is a typical size. A strength vanishes at `null_value`: with all its
    strengths there, an effect does nothing. A `shape` parameter (a place, a width, a frequency)
    means nothing without a strength; its `null_value` only stands in until there is one. Where the
    effect vanishes at infinity (`inverse`), the natural coordinate for a fit is the reciprocal.
    A strength whose distance from `null_value` is below the `floor` cannot be told from an error
    of camera, time stamps or coils.
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
        """The name of the field that holds the value in SI: `wx` for `wx_um_s`."""
        return self.name.removesuffix(units.suffix(self.name))

    @property
    def is_angle(self) -> bool:
        """Whether it is the same again a turn on: the direction or the phase of a shape."""
        return self.shape and self.name.endswith('_rad')

    def to_fit(self, value: float) -> float:
        """The dimensionless coordinate used in fits: 0 at `null_value`."""
        return self.scale / value if self.inverse else (value - self.null_value) / self.scale

    def from_fit(self, coordinate: float) -> float:
        """The SI value at a fit coordinate, within the bounds; the reciprocal of 0 is infinity.

        A coordinate beyond the bounds by rounding gives the bound itself.
        """
        if self.inverse:
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
        """An SI `value` in the unit of the name."""
        return units.from_si(self.name, value)


STAMPS = 3e-3
"""Floor [s] of a time: the scatter of stamps that a program gives to frames, and a bias of the
tracker of 10 nm along the heading at 3 µm/s. Through the real graph delays of 1.5 to 2.1 ms were
fitted that no coil had: at half of it some would be named; at twice of it the delay of 4 ms on the
card would not be."""

COILS = 2e-5
"""Floor [T] of a field: the horizontal field of the Earth, in which every rig stands, and 0.4 % of
5 mT, to which currents are read back. At half of it that field is named where tracks are long; at
twice of it a magnet at 30 cm is missed."""

ALIKE = 0.01
"""Floor of a ratio or an angle [rad] of coils: 1 %, as tightly as pairs are wound and mounted. At
half of it good coils are named in long recordings; at twice of it a lean of 1° is missed."""


def parameter(name: str, meaning: str, low: float, high: float, scale: float, *,
              default: float | None = None, **how: Any) -> Any:
    """A dataclass field that declares a `Parameter`; `default` makes it optional in files.

    `name`, `meaning`, `low`, `high`, `scale` and `how`, the rest, are those of `Parameter`.
    """
    declared = Parameter(name, meaning, low, high, scale, **how)
    metadata = {'parameter': declared}
    if default is None:
        return dataclasses.field(metadata=metadata)
    return dataclasses.field(default=default, metadata=metadata)
