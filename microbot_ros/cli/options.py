"""What options of several commands have in common."""

from __future__ import annotations

import math
from typing import Any

import click

from microbot_ros.common.plausible import plausible_range

namespace_option = click.option(
    '--namespace', default='/', show_default=True, metavar='NAME',
    help="ROS namespace of the rig's nodes.")


cockpit_option = click.option(
    '--cockpit', is_flag=True, help="Also serve the operator's page; see `microbot cockpit`.")


force_option = click.option(
    '--force', is_flag=True, help='Replace the results of an earlier run.')


class FiniteFloatRange(click.FloatRange):
    """The type of a number within a range, in which NaN is not, as it is in click's own."""

    def convert(self, value: Any, param: click.Parameter | None,
                ctx: click.Context | None) -> float:
        """The number that `value` stands for; click's `BadParameter` where it is not allowed.

        `param` and `ctx` are click's own, for its message.
        """
        number: float = super().convert(value, param, ctx)
        return number if math.isfinite(number) else self.fail(f'{value} is no number', param, ctx)


def plausible_number(name: str) -> FiniteFloatRange:
    """The type of an option for a number of that `name`, within what a rig can have."""
    return FiniteFloatRange(*plausible_range(name))
