"""Plays a plan that comes by topic, once, and then lets go."""

from __future__ import annotations

from microbot_ros.common.records import Commands
from microbot_ros.control.contract import (
    Controller,
    ControllerInput,
    FieldCommand,
    Input,
    Progress,
    no_field,
)
from microbot_ros.control.plugins.open_loop import check_limits


class Experiment(Controller):
    """Each plan is played once, from the tick that first has it; before and after it no field.

    A plan that came before this controller drives is not played: what was planned for other
    places says nothing of these. The last row of a plan is its end.
    """

    interface_version = 1
    summary = 'A plan of fields that comes by topic, played once.'
    takes = frozenset({Input.PLAN})

    def __init__(self) -> None:
        super().__init__()
        self._plan: Commands | None = None
        self._begun: float | None = None

    def activate(self, inputs: ControllerInput) -> None:
        """Begin with nothing: the plan of `inputs` was another's."""
        self._plan, self._begun = inputs.plan, None

    def compute(self, inputs: ControllerInput) -> FieldCommand:
        """The row of the moment of `inputs`; NoSolutionError for a plan beyond the limits."""
        plan = inputs.plan
        if plan is not self._plan:
            self._plan, self._begun = plan, inputs.t
        if plan is None or self._begun is None:
            return no_field('waiting for a plan')
        check_limits(plan, inputs.limits)
        elapsed, length = inputs.t - self._begun, float(plan.t[-1])
        if not 0 <= elapsed < length:
            return no_field('the plan has been played', done=elapsed >= length)
        return FieldCommand(plan.field_at(elapsed), float(plan.frequency_at(elapsed)),
                            Progress(f'{elapsed:.1f} of {length:.1f} s of a plan'))

    def reset(self) -> None:
        """Forget the plan: it is not played again."""
        self._begun = None
