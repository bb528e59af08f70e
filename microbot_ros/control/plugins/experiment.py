"""Play a plan that arrives by topic once, then switch off."""

from __future__ import annotations

import math

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
    """Plays each plan once, from the first tick that has it; no field before and after.

    A plan from before the activation is not played: it was made for other positions. The last row
    of a plan is its end.
    """

    interface_version = 1
    summary = 'Play a plan of fields, received by topic, once.'
    takes = frozenset({Input.PLAN})

    def __init__(self) -> None:
        super().__init__()
        self._plan: Commands | None = None
        self._begun: float | None = None

    def activate(self, inputs: ControllerInput) -> None:
        """Discard the plan in `inputs`, made before the activation."""
        self._plan, self._begun = inputs.plan, None

    def compute(self, inputs: ControllerInput) -> FieldCommand:
        """Return the present row of the plan; NoSolutionError beyond the limits of `inputs`."""
        plan = inputs.plan
        if plan is not self._plan:
            self._plan, self._begun = plan, inputs.t
        if plan is None or self._begun is None:
            return no_field('waiting for a plan')
        check_limits(plan, inputs.limits)
        elapsed, length = inputs.t - self._begun, float(plan.t[-1])
        if elapsed < 0:  # the clock was set back: it must not go on by itself one day
            self._begun, elapsed = -math.inf, math.inf
        if elapsed >= length:
            return no_field('the plan has been played', done=True)
        return FieldCommand(plan.field_at(elapsed), float(plan.frequency_at(elapsed)),
                            Progress(f'{elapsed:.1f} of {length:.1f} s of a plan'))

    def reset(self) -> None:
        """Forget the plan: it is not played again."""
        self._begun = None
