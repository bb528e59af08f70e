"""How `microbot track` sees the pictures of a film: in which sum of colours, in which rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from microbot_ros.cli.track.learn import Point
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


def telling_colour(
    like: Sequence[Point], unlike: Sequence[Point], named: dict[int, np.ndarray]
) -> tuple[Weights | None, list[str]]:
    """The weights that tell best what was pointed at in the `named` frames, and a sentence.

    None, and no sentence, where brightness does as well.
    """
    from microbot_ros.tracking.locate.colour import Spot, telling_weights

    found = telling_weights([
        *(Spot(named[point.frame], point.x, point.y, point.kind or '') for point in like),
        *(Spot(named[point.frame], point.x, point.y, None) for point in unlike)])
    if found is None:
        return None, []
    weights, gain = found
    return weights, ['seen by its colour, which tells it {:.1f} times better than brightness: '
                     '{:+g} red {:+g} green {:+g} blue'.format(gain, *weights)]
