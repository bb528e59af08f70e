"""The coils as a person describes them, in a YAML file of their own."""

from __future__ import annotations

from itertools import combinations
from typing import Any, Literal, Self

import numpy as np
import pydantic
from pydantic import Field, PositiveFloat, PositiveInt

from microbot_ros.files import Settings
from microbot_ros.magnetics.sources import Loop, Polyline, Source

Vector = tuple[float, float, float]


class Winding(Settings):
    """One coil: turns round a circle, or along a closed polyline.

    Lengths are in the workspace frame: origin at the workspace centre, x right, y up, z towards
    the camera. Positive current makes a field along `axis` (along the polyline's right-hand
    normal), unless `sign` −1 says that the coil is connected the other way round. `gain` is the
    measured field per ampere over the one of the geometry.
    """

    name: str = Field(min_length=1)
    position_mm: Vector
    axis: Vector | None = None
    radius_mm: PositiveFloat | None = None
    vertices_mm: tuple[Vector, ...] | None = Field(None, min_length=3)
    turns: PositiveInt
    resistance_ohm: PositiveFloat
    max_current_A: PositiveFloat
    gain: PositiveFloat = 1.0
    sign: Literal[1, -1] = 1

    @pydantic.model_validator(mode='after')
    def _is_a_coil(self) -> Self:
        given = (self.axis is not None, self.radius_mm is not None, self.vertices_mm is not None)
        if given not in ((True, True, False), (False, False, True)):
            raise ValueError('expected radius_mm and axis, or vertices_mm alone')
        self.source()  # its own checks, while there is still a file and a line to name
        return self

    def source(self) -> Source:
        """The wire that makes this coil's field, its gain and sign included."""
        turns = self.turns * self.gain * self.sign
        centre = 1e-3 * np.array(self.position_mm)
        if self.vertices_mm is not None:
            vertices = centre + 1e-3 * np.array(self.vertices_mm)
            return Polyline(np.vstack([vertices, vertices[:1]]), turns)
        return Loop(1e-3 * (self.radius_mm or 0.0), centre, np.array(self.axis), turns)

    def coincides_with(self, other: Winding) -> bool:
        """Whether both wires lie in the same place, whatever way they are wound."""
        alike = (self.position_mm, self.radius_mm, self.vertices_mm) == (
            other.position_mm, other.radius_mm, other.vertices_mm)
        if alike and self.axis is not None and other.axis is not None:
            return not np.any(np.cross(self.axis, other.axis))
        return alike


def _four_in_plane() -> tuple[Winding, ...]:
    """Four identical coils around the workspace: 2.1 mT/A each, 4.3 mT/A an opposite pair.

    In the order of the amplifiers' channels, each with its axis outwards: a uniform field takes
    opposite currents in opposite coils, as the boards of the Delaware lab expect.
    """
    places: dict[str, tuple[Vector, Vector]] = {
        'coil_plus_y': ((0.0, 30.0, 0.0), (0.0, 1.0, 0.0)),
        'coil_plus_x': ((30.0, 0.0, 0.0), (1.0, 0.0, 0.0)),
        'coil_minus_y': ((0.0, -30.0, 0.0), (0.0, -1.0, 0.0)),
        'coil_minus_x': ((-30.0, 0.0, 0.0), (-1.0, 0.0, 0.0)),
    }
    return tuple(
        Winding(name=name, position_mm=position, axis=axis, radius_mm=20.0, vertices_mm=None,
                turns=400, resistance_ohm=4.3, max_current_A=2.0)
        for name, (position, axis) in places.items()
    )


class CoilSettings(Settings):
    """Four coils and the field that is there without them.

    Currents are ordered as `windings`, which are in the order of the amplifier's channels. The
    default is a bench rig: 400 turns of 0.5 mm copper wire on a 20 mm radius, 30 mm from the
    centre, four times.
    """

    windings: tuple[Winding, ...] = Field(default_factory=_four_in_plane)
    background_mT: tuple[float, float] = (0.0, 0.0)

    @pydantic.model_validator(mode='wrap')
    @classmethod
    def _from_a_file(cls, content: Any, validated: pydantic.ModelWrapValidatorHandler[Self],
                     ) -> CoilSettings:
        """A file of coils has them under the one key `coils`; those without it are read too."""
        if isinstance(content, dict) and 'coils' in content:
            return _CoilsFile.model_validate(content).coils
        return validated(content)

    @pydantic.field_validator('windings')
    @classmethod
    def _are_four_apart(cls, windings: tuple[Winding, ...]) -> tuple[Winding, ...]:
        if len(windings) != 4:
            raise ValueError('expected four coils')
        for one, other in combinations(windings, 2):
            if one.name == other.name:
                raise ValueError(f"expected four different names, found '{one.name}' twice")
            if one.coincides_with(other):
                raise ValueError(f"'{one.name}' and '{other.name}' lie in the same place")
        return windings


class _CoilsFile(Settings):
    coils: CoilSettings
