"""Assignment of goals to particles, stable while particles come and go."""

from __future__ import annotations

import numpy as np

from microbot_ros.control.contract import NO_IDS, ControllerInput, Goals, ParticleLostError
from microbot_ros.control.steering.courses import goals_in_reach


class Assignment:
    """Assigns each goal to a particle from the tick on which the goals were new.

    Goals without ids go to the particles tracked then, in ascending order of their ids.
    """

    def __init__(self) -> None:
        self._goals = Goals()
        self._ids = NO_IDS

    def update(self, inputs: ControllerInput) -> bool:
        """Take the goals of `inputs` and return whether they are new.

        Raises GoalError for a goal outside the workspace.

        Parameters
        ----------
        inputs : ControllerInput
            Input of the tick.

        Returns
        -------
        bool
            Whether goals or assigned particles differ from those of the last call.
        """
        goals, kept = inputs.goals, self._goals
        same = np.array_equal(goals.position, kept.position)
        if same and np.array_equal(_ids(goals), _ids(kept)):
            return False
        goals_in_reach(inputs)
        if len(goals):
            inputs.require_particles()
        self._goals = goals
        self._ids = np.sort(inputs.ids)[:len(goals)] if goals.ids is None else goals.ids
        return True

    def pairs(self, inputs: ControllerInput) -> tuple[np.ndarray, np.ndarray]:
        """Return rows (K,) in `inputs` of the particles with goals, and the goals (K, 2) [m].

        Both are empty without goals; ParticleLostError if there are goals but none of their
        particles.

        Parameters
        ----------
        inputs : ControllerInput
            Input of the tick.

        Returns
        -------
        tuple[ndarray, ndarray]
            Rows (K,) and goals (K, 2) [m].
        """
        _, rows, goals = np.intersect1d(inputs.ids, self._ids, return_indices=True)
        if len(self._ids) and not len(rows):
            raise ParticleLostError('no particle with a goal is tracked')
        return rows, self._goals.position[goals]


def _ids(goals: Goals) -> np.ndarray:
    return NO_IDS if goals.ids is None else goals.ids
