"""User's statements about a table, as on the command line and in `archive.yaml`."""

from __future__ import annotations

import math
from typing import Literal

from microbot_ros.common.checked import Field, PositiveFloat, Settings, SettingsError
from microbot_ros.common.units import to_si
from microbot_ros.session.spreadsheets.columns import ROLES
from microbot_ros.session.spreadsheets.sheets import Answers

PositionUnit = Literal['um', 'mm', 'm', 'px']
FieldUnit = Literal['mT', 'T', 'G', 'fraction']


class Stated(Settings):
    """Options of an import, named as on the command line; None if not stated."""

    columns: dict[str, str] = Field(default_factory=dict)
    position_unit: PositionUnit | None = None
    pixel_size_um: PositiveFloat | None = None
    y: Literal['up', 'down'] | None = None
    time_unit: Literal['s', 'ms'] | None = None
    times: Literal['moments', 'intervals'] | None = None
    frame_rate_hz: PositiveFloat | None = None
    angle_unit: Literal['deg', 'rad'] | None = None
    angle_sense: Literal['counterclockwise', 'clockwise'] | None = None
    angle_offset_deg: float | None = Field(default=None, ge=-3600, le=3600)
    field_unit: FieldUnit | None = None
    full_scale_mT: PositiveFloat | None = None
    ignore_speed: bool = False

    def __post_init__(self) -> None:
        if not self.columns.keys() <= set(ROLES):
            raise SettingsError(f'expected roles of {", ".join(ROLES)}', 'columns')

    def answers(self) -> Answers:
        """Return the same in SI, for `import_session`.

        Returns
        -------
        Answers
            The answers.
        """
        def suffix(unit: str | None) -> str | None:
            return unit and f'_{unit}'

        def si(name: str) -> float | None:
            value = getattr(self, name)
            return None if value is None else to_si(name, value)

        offset = self.angle_offset_deg
        return Answers(
            columns=dict(self.columns), position_unit=suffix(self.position_unit),
            pixel_size=si('pixel_size_um'), y_axis=self.y, time_unit=suffix(self.time_unit),
            times=self.times, frame_rate=self.frame_rate_hz, angle_unit=suffix(self.angle_unit),
            angle_sense=self.angle_sense,
            angle_offset=None if offset is None else math.radians(offset),
            field_unit=suffix(self.field_unit), full_scale=si('full_scale_mT'),
            ignore_speed=self.ignore_speed)
