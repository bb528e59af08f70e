"""The library of effects. A new one is a file here and a line in `_LIBRARY`."""

from __future__ import annotations

from microbot_ros.model.effect import Effect
from microbot_ros.model.effects.alignment_lag import AlignmentLag
from microbot_ros.model.effects.background_field import BackgroundField
from microbot_ros.model.effects.uniform_drift import UniformDrift

# In the order in which they act: within a stage the effects of a model compose in this order.
_LIBRARY: tuple[type[Effect], ...] = (
    BackgroundField,
    AlignmentLag,
    UniformDrift,
)

EFFECTS: dict[str, type[Effect]] = {effect.id: effect for effect in _LIBRARY}
"""Every known effect by its name."""
