"""The controller to rest in: no field."""

from __future__ import annotations

from microbot_ros.control.contract import (
    Controller,
    ControllerInput,
    FieldCommand,
    Input,
    no_field,
)


class Hold(Controller):
    """Keeps the field at zero; catalytic particles swim on and turn by chance."""

    interface_version = 1
    summary = 'No field.'
    takes = frozenset[Input]()

    def compute(self, inputs: ControllerInput) -> FieldCommand:
        """Zero, whatever the `inputs`."""
        return no_field('the field is off')
