"""Library of effects: built-in ones, and those of other packages (`microbot_ros.effects`).

A new built-in effect is a file and a line in `BUILT_IN`. In other packages it is a class that an
entry point names (docs/how-to/effect.md).
"""

from __future__ import annotations

from collections.abc import Mapping

from microbot_ros.model.effect import Effect
from microbot_ros.model.effects.field.amplifier_deadband import AmplifierDeadband
from microbot_ros.model.effects.field.background_field import BackgroundField
from microbot_ros.model.effects.field.coil_gain_mismatch import CoilGainMismatch
from microbot_ros.model.effects.field.coil_misalignment import CoilMisalignment
from microbot_ros.model.effects.field.command_delay import CommandDelay
from microbot_ros.model.effects.heading.alignment_lag import AlignmentLag
from microbot_ros.model.effects.heading.heading_slip import HeadingSlip
from microbot_ros.model.effects.observation.pixel_anisotropy import PixelAnisotropy
from microbot_ros.model.effects.velocity.coil_pull import CoilPull
from microbot_ros.model.effects.velocity.dipole_interaction import DipoleInteraction
from microbot_ros.model.effects.velocity.drive_response import DriveResponse
from microbot_ros.model.effects.velocity.gradient_force import GradientForce
from microbot_ros.model.effects.velocity.hot_spot import HotSpot
from microbot_ros.model.effects.velocity.hydrodynamic_slowdown import HydrodynamicSlowdown
from microbot_ros.model.effects.velocity.incomplete_alignment import IncompleteAlignment
from microbot_ros.model.effects.velocity.linear_flow import LinearFlow
from microbot_ros.model.effects.velocity.periodic_drift import PeriodicDrift
from microbot_ros.model.effects.velocity.speed_decay import SpeedDecay
from microbot_ros.model.effects.velocity.uniform_drift import UniformDrift
from microbot_ros.model.library import Library

# In the order in which they act: within a stage the effects of a model compose in this order.
BUILT_IN: tuple[type[Effect], ...] = (
    CommandDelay,
    AmplifierDeadband,
    CoilGainMismatch,
    CoilMisalignment,
    BackgroundField,
    AlignmentLag,
    HeadingSlip,
    IncompleteAlignment,
    DriveResponse,
    SpeedDecay,
    HydrodynamicSlowdown,
    UniformDrift,
    LinearFlow,
    PeriodicDrift,
    HotSpot,
    GradientForce,
    CoilPull,
    DipoleInteraction,
    PixelAnisotropy,
)

EFFECTS: Mapping[str, type[Effect]] = Library(BUILT_IN)
"""All installed effects by name.

Those of other packages are read on first use, with an InputError of one line if one cannot be
used.
"""
