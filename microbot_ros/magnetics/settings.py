"""Settings of the coils, written by the user in a YAML file."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np

from microbot_ros.common.checked import (
    Field,
    PositiveFloat,
    PositiveInt,
    Settings,
    SettingsError,
)
from microbot_ros.common.files import beside
from microbot_ros.magnetics.saturation import Saturation
from microbot_ros.magnetics.sources import Loop, Placed, Polyline, Source

Vector = tuple[float, float, float]

_MOST = 16  # choice; twice as many coils make four times the faces that the allocator checks
_ALONG_AXIS = ('radius_mm', 'rectangle_mm')
_WOUND = (*_ALONG_AXIS, 'vertices_mm')
_SHAPES = (*_WOUND, 'field_map', 'source')


class Winding(Settings):
    """One coil: wire around a circle, a rectangle or a path, or a measured field.

    Lengths are in the workspace frame: origin at the workspace centre, x right, y up, z towards
    the camera. Positive current makes a field along `axis` (for a path: its right-hand normal);
    `sign` −1 means that the coil is connected in reverse. `gain` is the measured field per ampere
    over that of the geometry.

    * `radius_mm` and `axis`: a circle about `position_mm`.
    * `rectangle_mm` (width, height) and `axis`: the width lies in the plane of the workspace, the
      height perpendicular to it; for an axis along z the width lies along x.
    * `vertices_mm`, relative to `position_mm`: a path. It is closed automatically; with
      `closed: false` it must end where it begins.
    * `field_map`: a file with the field per ampere, its origin at `position_mm` (`field_map.py`).
      A relative path starts at the folder of the coil file.
    * `source`: a coil that a package provides by the entry point `microbot_ros.coils`
      (`adapters.py`), its origin at `position_mm`.

    `saturation`, for a core: pairs [A, effective A] (`saturation.py`) up to `max_current_A`.
    """

    name: str = Field(min_length=1)
    position_mm: Vector
    axis: Vector | None = None
    radius_mm: PositiveFloat | None = None
    rectangle_mm: tuple[PositiveFloat, PositiveFloat] | None = None
    vertices_mm: tuple[Vector, ...] | None = Field(default=None, min_length=3)
    closed: bool | None = None
    field_map: Annotated[Path, beside] | None = None
    source: str | None = None
    turns: PositiveInt | None = None
    resistance_ohm: PositiveFloat
    max_current_A: PositiveFloat
    saturation: tuple[tuple[PositiveFloat, PositiveFloat], ...] | None = None
    gain: PositiveFloat = 1.0
    sign: Literal[1, -1] = 1

    def __post_init__(self) -> None:
        shapes = [name for name in _SHAPES if getattr(self, name) is not None]
        if len(shapes) != 1 or (self.axis is None) == (shapes[0] in _ALONG_AXIS):
            raise ValueError('expected radius_mm and axis, rectangle_mm and axis, or one of '
                             'vertices_mm, field_map and source alone')
        if (self.turns is None) == (shapes[0] in _WOUND):
            raise ValueError('expected turns of a wire, and none of a field_map or a source')
        ends = self.vertices_mm and self.vertices_mm[0] == self.vertices_mm[-1]
        if self.closed is False and not ends:
            raise ValueError('expected a closed path: its end must be its start')
        if self.saturation is not None:
            self.curve()
            if not self.saturation[-1][0] >= self.max_current_A:
                raise ValueError('expected a saturation up to max_current_A')
        self.made_by()  # runs its checks now, while file and line are known

    def made_by(self) -> Source:
        """Return the field source of this coil, gain and sign included.

        Returns
        -------
        Source
            The source.
        """
        centre, factor = 1e-3 * np.array(self.position_mm), self.gain * self.sign
        if self.field_map is not None:
            from microbot_ros.magnetics.field_map import read_field_map
            return Placed(read_field_map(self.field_map), centre, factor)
        if self.source is not None:
            from microbot_ros.magnetics.adapters import installed_source
            return Placed(installed_source(self.source), centre, factor)
        turns = (self.turns or 0) * factor
        if self.radius_mm is not None:
            return Loop(1e-3 * self.radius_mm, centre, np.array(self.axis), turns)
        corners = centre + 1e-3 * self._corners()
        if (corners[0] != corners[-1]).any():
            corners = np.vstack([corners, corners[:1]])
        return Polyline(corners, turns)

    def curve(self) -> Saturation:
        """Return the saturation curve of the core; InputError for pairs that do not increase.

        Returns
        -------
        Saturation
            The curve.
        """
        return Saturation(self.saturation or ())

    def coincides_with(self, other: Winding) -> bool:
        """Return whether the `other` coil occupies the same place, in either winding direction.

        Parameters
        ----------
        other : Winding
            The other coil.

        Returns
        -------
        bool
            Whether it does.
        """
        alike = all(getattr(self, name) == getattr(other, name)
                    for name in ('position_mm', *_SHAPES))
        if alike and self.axis is not None and other.axis is not None:
            return not np.any(np.cross(self.axis, other.axis))
        return alike

    def _corners(self) -> np.ndarray:
        """Return the path relative to the position (V, 3) [mm]."""
        if self.rectangle_mm is None:
            return np.array(self.vertices_mm)
        axis = np.array(self.axis)
        if not axis.any():
            raise ValueError('axis: expected a direction; received a vector of no length')
        axis /= np.linalg.norm(axis)
        across = np.cross((0.0, 0.0, 1.0), axis)
        across = across / np.linalg.norm(across) if across.any() else np.array([1.0, 0.0, 0.0])
        width, height = np.array(self.rectangle_mm) / 2
        along, up = width * across, height * np.cross(axis, across)
        return np.array([-along - up, along - up, along + up, up - along])


def _four_in_plane() -> tuple[Winding, ...]:
    """Return four identical coils around the workspace: 2.1 mT/A each, 4.3 mT/A per opposite pair.

    They are in the order of the amplifier channels, each with its axis outwards: a uniform field
    needs opposite currents in opposite coils, as the boards of the Delaware lab expect.
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
    """The 2 to 16 coils of a rig and the background field.

    Currents are in the order of `windings`, which is the order of the amplifier channels. The
    default is a bench rig: four coils of 400 turns of 0.5 mm copper wire on a 20 mm radius, 30 mm
    from the centre. `background_mT` has two components or three. `axes` selects the axes along
    which fields are commanded, `xy` or `xyz`; by default those that the coils can make. Every wire
    must be further than `workspace_mm` from the workspace centre, and every field map must cover
    that radius.
    """

    workspace_mm: PositiveFloat = 1.0
    windings: tuple[Winding, ...] = Field(default_factory=_four_in_plane)
    background_mT: tuple[float, float] | Vector = (0.0, 0.0)
    axes: Literal['xy', 'xyz'] | None = None

    @classmethod
    def from_content(cls, content: Any) -> Self:
        """Return the coils of a file, which has all of them under the key `coils` or not.

        Parameters
        ----------
        content : object
            Content of the file.

        Returns
        -------
        CoilSettings
            The coils.
        """
        if isinstance(content, dict) and 'coils' in content:
            content = _CoilsFile.from_content(content).coils
        return super().from_content(content)

    def __post_init__(self) -> None:
        if not 2 <= len(self.windings) <= _MOST:
            raise SettingsError(f'expected 2 to {_MOST} coils, found {len(self.windings)}',
                                'windings')
        for one, other in combinations(self.windings, 2):
            if one.name == other.name:
                raise SettingsError(f"expected different names, found '{one.name}' twice",
                                    'windings')
            if one.coincides_with(other):
                raise SettingsError(f"'{one.name}' and '{other.name}' lie in the same place",
                                    'windings')
        for winding in self.windings:
            margin = 1e3 * winding.made_by().margin(np.zeros(3))
            if not margin > self.workspace_mm:
                what = 'a map that ends' if winding.field_map else 'its wire'
                raise SettingsError(
                    f"'{winding.name}' has {what} {max(margin, 0.0):.3g} mm from the workspace "
                    f'centre; expected more than workspace_mm, {self.workspace_mm:g} mm',
                    'windings')


class _CoilsFile(Settings):
    coils: CoilSettings
