"""List of goals of one particle, and its progress."""

from __future__ import annotations

import numpy as np

from microbot_ros.control.contract import (
    NO_PLACES,
    ControllerInput,
    Goals,
    Workspace,
)
from microbot_ros.control.steering.courses import goals_in_reach


class GoalSequence:
    """Goals in order for one particle, given or chosen.

    The particle is the requested one, else the first that the goals name, else the one nearest to
    the first goal. A chosen one that is lost is replaced by the one nearest to its last position,
    which may be the same under a new id. Goals that name particles are used for that one only. A
    new list starts from its first goal, and so does one that is sent again after it was done.
    """

    def __init__(self) -> None:
        self.particle = -1
        self.done = False
        self._next = 0
        self._named = False
        self._position = NO_PLACES
        self._goals: Goals | None = None
        self._stamp = 0.0
        self._workspace: Workspace | None = None
        self._seen: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self._position)

    @property
    def present(self) -> int:
        """Index of the present goal."""
        return self._next

    def __str__(self) -> str:
        return f'particle {self.particle}: goal {self._next + 1} of {len(self)}'

    def update(self, inputs: ControllerInput, asked: int) -> None:
        """Take the goals of `inputs`; `asked` is the requested particle, −1 for any.

        Raises GoalError for a goal outside the workspace.

        Parameters
        ----------
        inputs : ControllerInput
            Input of the tick.
        asked : int
            Identity of the particle; −1 for any.
        """
        if inputs.goals is not self._goals or inputs.workspace is not self._workspace:
            goals_in_reach(inputs)
            self._goals, self._workspace = inputs.goals, inputs.workspace
        named = _first_named(inputs.goals) if asked < 0 else asked
        position = inputs.goals.position
        if inputs.goals.ids is not None:
            position = position[inputs.goals.ids == named]
        again = self.done and inputs.goals.stamp != self._stamp
        other = named >= 0 and named != self.particle
        self._stamp = inputs.goals.stamp
        if again or other or not np.array_equal(position, self._position):
            self._position, self._next, self.done = position, 0, False
            self._seen = None
            self.particle = named
        self._named = named >= 0

    def row(self, inputs: ControllerInput) -> int:
        """Return the particle's row of `inputs`; ParticleLostError if there is none.

        Parameters
        ----------
        inputs : ControllerInput
            Input of the tick.

        Returns
        -------
        int
            The row.
        """
        if not self._named and self.particle not in inputs.ids:
            inputs.require_particles()
            near = self._position[self._next] if self._seen is None else self._seen
            away = np.hypot(*(inputs.position - near).T)
            self.particle = int(inputs.ids[np.argmin(away)])
        row = inputs.index(self.particle)
        self._seen = inputs.position[row]
        return row

    def offset(self, place: complex, arrival: float) -> complex:
        """Return the vector [m] from `place` to the present goal, past goals within `arrival` [m].

        After the last goal, the vector to that one.

        Parameters
        ----------
        place : complex
            Position, complex [m].
        arrival : float
            Distance [m] at which a goal is reached.

        Returns
        -------
        complex
            Vector, complex [m].
        """
        while True:
            offset = complex(*self._position[self._next].tolist()) - place
            last = self._next == len(self) - 1
            if abs(offset) > arrival or last:
                self.done |= last and abs(offset) <= arrival
                return offset
            self._next += 1


def _first_named(goals: Goals) -> int:
    return -1 if goals.ids is None or not len(goals) else int(goals.ids[0])
