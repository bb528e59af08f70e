"""Gather, spread, arrange or carry particles, as far as one field allows."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from microbot_ros.common import units
from microbot_ros.common.settings import setting
from microbot_ros.control.contract import ANY_GOALS, NO_IDS, ControllerInput
from microbot_ros.control.planning.shared import allowed_corners, as_complex, borders
from microbot_ros.control.plugins.ensemble import Aim, SharedField, SharedFieldParameters
from microbot_ros.control.steering.courses import goals_in_reach

SHAPES = ('gather', 'spread', 'carry', 'line', 'ring', 'grid')
_TURNS = np.exp(2j * np.pi * np.arange(24) / 24)  # choice: initial rotations tried, every 15°


@dataclass(frozen=True)
class FormationParameters(SharedFieldParameters):
    """The shape, besides the parameters of all that share a field."""

    shape: str = setting(
        'gather', 'gather: move together; spread: move apart; carry: move to the '
                  'goal in their present arrangement; line, ring, grid: that '
                  'shape.', choices=SHAPES)
    spacing_um: float = setting(
        20.0, 'Distance of neighbours in a line, ring or grid.', lower=1.0, upper=1000.0)


class Formation(SharedField):
    """Forms a shape with all tracked particles; the first goal, if any, is its centre.

    Without a goal the shape is formed where it costs least. Its rotation and the assignment of
    places are always chosen like that, once when the shape is requested; the displacement follows
    each tick.
    """

    interface_version = 1
    summary = 'Gather, spread, arrange or carry all particles.'
    takes = ANY_GOALS
    Parameters = FormationParameters

    def reset(self) -> None:
        """Choose places and rotation anew."""
        super().reset()
        self._asked: tuple[Any, ...] = ()
        self._ids = NO_IDS
        self._place = np.empty(0, complex)
        self._turn = 1 + 0j

    def configure(self, parameters: Any) -> None:
        """Take `parameters`; a new shape is planned at the next tick."""
        import scipy.optimize  # noqa: F401  its import takes longer than a tick

        super().configure(parameters)

    def activate(self, inputs: ControllerInput) -> None:
        """Start with the particles of `inputs`."""
        super().activate(inputs)
        self._asked = ()

    def involved(self, inputs: ControllerInput) -> np.ndarray:
        """Return all rows of `inputs`; none for `carry` without a goal."""
        if self.parameters.shape == 'carry' and not len(inputs.goals):
            return NO_IDS
        return np.arange(len(inputs.ids))

    def aim(self, inputs: ControllerInput, rows: np.ndarray, velocity: np.ndarray) -> Aim:
        """Return the aim for `rows` of `inputs` of known `velocity`: places, or furthest apart."""
        centre = goals_in_reach(inputs)[:1]
        if self.parameters.shape == 'spread':
            return self._spread(inputs, rows, velocity)
        z = as_complex(inputs.expected[rows])
        # Without a goal the centre is free, and only relative positions count.
        z = z - (z.mean() if not len(centre) else as_complex(centre)[0])
        answer = velocity if len(centre) else velocity - velocity.mean()
        self._settle(inputs, rows, z, answer, centre)
        place = self._place[np.searchsorted(self._ids, inputs.ids[rows])]
        aim = Aim.least_squares(answer, self._turn * place - z)
        if self.parameters.shape != 'carry':
            self._turn = _rotation(place, z + answer * aim.displacement)
        return aim

    def _settle(self, inputs: ControllerInput, rows: np.ndarray, z: np.ndarray, answer: np.ndarray,
                centre: np.ndarray) -> None:
        """Assign places, if shape, centre or particles are new."""
        ids = inputs.ids[rows]
        asked = (self.parameters, centre.tobytes(), tuple(sorted(ids.tolist())))
        if asked == self._asked:
            return
        places = _places(self.parameters, len(ids), z - z.mean())
        if self.parameters.shape in ('gather', 'carry'):
            self._turn, order = 1 + 0j, np.arange(len(ids))
        else:
            self._turn, order = _match(z, answer, places)
        by_id = np.argsort(ids)
        self._ids, self._place, self._asked = ids[by_id], places[order][by_id], asked

    def _spread(self, inputs: ControllerInput, rows: np.ndarray, velocity: np.ndarray) -> Aim:
        """Return the aim for the corner of the allowed region with the largest spread (convex)."""
        margin = units.to_si('margin_um', self.parameters.margin_um)
        normal, room = borders(inputs.workspace, inputs.expected[rows], velocity, margin)
        z = as_complex(inputs.expected[rows])
        ends = allowed_corners(normal, np.maximum(room, 0.0))
        best = max(ends.tolist(), key=lambda U: float(np.var(z + velocity * U)))
        return Aim(best, velocity * best, velocity)


def _places(parameters: FormationParameters, count: int, now: np.ndarray) -> np.ndarray:
    """Return places (N,) [m] around the centre for `count` particles."""
    spacing = units.to_si('spacing_um', parameters.spacing_um)
    if parameters.shape == 'gather':
        return np.zeros(count, complex)
    if parameters.shape == 'carry':
        return now
    index = np.arange(count)
    if parameters.shape == 'line':
        places = index + 0j
    elif parameters.shape == 'ring':
        radius = 0.5 / math.sin(math.pi / count) if count > 1 else 0.0
        places = radius * np.exp(2j * np.pi * index / count)
    else:
        side = math.ceil(math.sqrt(count))
        places = index % side + 1j * (index // side)
    return np.asarray(spacing * (places - places.mean()))


def _rotation(place: np.ndarray, reached: np.ndarray) -> complex:
    """Return e^{iα} that best rotates places onto `reached` (Procrustes)."""
    overlap = complex(np.vdot(place, reached))
    return overlap / abs(overlap) if overlap else 1 + 0j


def _match(z: np.ndarray, answer: np.ndarray, places: np.ndarray) -> tuple[complex, np.ndarray]:
    """Return the rotation and the order of places with the smallest remaining error."""
    from scipy.optimize import linear_sum_assignment

    best: tuple[float, complex, np.ndarray] = (math.inf, 1 + 0j, np.arange(len(z)))
    for turn in _TURNS:
        reached = z
        for _ in range(2):
            cost = np.abs(reached[:, None] - turn * places[None, :]) ** 2
            order = linear_sum_assignment(cost)[1]
            aim = Aim.least_squares(answer, turn * places[order] - z)
            reached = z + answer * aim.displacement
            turn = _rotation(places[order], reached)
        left = Aim.least_squares(answer, turn * places[order] - z).floor
        if left < best[0]:
            best = left, turn, order
    return best[1], best[2]
