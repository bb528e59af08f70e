"""View of `microbot track` on the pictures of a film: sum of colours, and rows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from microbot_ros.tracking.locate.colour import Weights


@dataclass(frozen=True)
class View:
    """Conversion of a decoded picture to grey values.

    Attributes
    ----------
    colour : Weights or None
        Weights of the colours; None for brightness.
    interlaced : bool
        Whether only the even rows are used.
    """

    colour: Weights | None = None
    interlaced: bool = False

    def __call__(self, picture: np.ndarray) -> np.ndarray | None:
        """Convert a picture (H, W) or (H, W, 3 or 4), blue first, to grey values (H, W).

        None if it is no picture. InputError if it lacks the colour.
        """
        from microbot_ros.cameras.interlaced import one_field
        from microbot_ros.cameras.source import decoded, grey
        from microbot_ros.tracking.locate.colour import weighted

        if decoded(picture) is None:
            return None
        if self.interlaced:
            picture = one_field(picture)
        return grey(picture) if self.colour is None else weighted(picture, self.colour)
