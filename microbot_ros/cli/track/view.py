"""How `microbot track` sees the pictures of a film: in which sum of colours, in which rows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from microbot_ros.tracking.locate.colour import Weights


@dataclass(frozen=True)
class View:
    """What a decoded picture is seen as: grey by the weights of a `colour`, or by brightness where
    that is None, and where it is `interlaced` by its even rows alone.
    """

    colour: Weights | None = None
    interlaced: bool = False

    def __call__(self, picture: np.ndarray) -> np.ndarray | None:
        """The `picture` (H, W) or (H, W, 3 or 4), blue first, as (H, W); None if it is no picture.

        InputError where it lacks the colour.
        """
        from microbot_ros.cameras.interlaced import one_field
        from microbot_ros.cameras.source import decoded, grey
        from microbot_ros.tracking.locate.colour import weighted

        if decoded(picture) is None:
            return None
        if self.interlaced:
            picture = one_field(picture)
        return grey(picture) if self.colour is None else weighted(picture, self.colour)
