"""What a table cannot say of itself, as people answer it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal


@dataclass(frozen=True)
class Answers:
    """Answers to what a file leaves open, in SI; None where it is left to detection.

    `columns` gives the name of the column for a role; units are suffixes as `units` knows them;
    `angle_offset` is what the table's angles are too large by.
    """

    columns: dict[str, str] = field(default_factory=dict)
    position_unit: str | None = None
    pixel_size: float | None = None
    y_axis: Literal['up', 'down'] | None = None
    time_unit: str | None = None
    times: Literal['moments', 'intervals'] | None = None
    frame_rate: float | None = None
    angle_unit: str | None = None
    angle_sense: Literal['counterclockwise', 'clockwise'] | None = None
    angle_offset: float | None = None
    field_unit: str | None = None


class Said(list[str]):
    """What was taken for granted, a sentence each and no sentence twice."""

    def add(self, sentence: str) -> None:
        """Say it unless it was said."""
        if sentence not in self:
            self.append(sentence)
