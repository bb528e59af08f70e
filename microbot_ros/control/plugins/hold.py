"""Controller without a field."""

from __future__ import annotations

from microbot_ros.control.contract import (
    Controller,
    ControllerInput,
    FieldCommand,
    Input,
    no_field,
)


class Hold(Controller):
    """Keeps the field at zero; catalytic particles swim on and turn randomly."""

    interface_version = 1
    summary = 'No field.'
    takes = frozenset[Input]()

    def compute(self, inputs: ControllerInput) -> FieldCommand:
        """Return zero field for all `inputs`."""
        return no_field('the field is off')
