"""Every effect that can be hidden, with random shape and one strength that a search can set."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

Parameters = dict[str, float]


@dataclass(frozen=True)
class Hideout:
    """Where an effect is hidden: what its shape is drawn for.

    `extent` [µm] is the half side of the square in which particles start, `duration` [s].
    """

    rng: np.random.Generator
    extent: float
    duration: float

    def sign(self) -> float:
        """+1 or −1."""
        return float(self.rng.choice((-1.0, 1.0)))

    def direction(self) -> tuple[float, float]:
        """A unit vector."""
        angle = self.rng.uniform(-math.pi, math.pi)
        return math.cos(angle), math.sin(angle)

    def frequency(self) -> float:
        """From about three periods in a minute to a half a second [Hz], log-uniform."""
        return float(np.exp(self.rng.uniform(math.log(3 / self.duration), math.log(0.5))))

    def midway(self) -> float:
        """A time well inside the recording [s]."""
        return float(self.rng.uniform(0.3, 0.7) * self.duration)

    def place(self) -> float:
        """A coordinate where particles come by [µm]."""
        return float(self.rng.uniform(-0.5, 0.5) * self.extent)


@dataclass(frozen=True)
class Kind:
    """An effect: `shaped(hideout)` fixes its shape and returns parameters as a function of
    strength; `guess` is a strength from which to search, `most` the largest that a rig may have:
    what would take more to show is not hidden there. `pairs`: needs neighbours close by; `levels`:
    shows only under several field strengths.
    """

    shaped: Callable[[Hideout], Callable[[float], Parameters]]
    guess: float
    most: float
    pairs: bool = False
    levels: bool = False


def _plain(
    name: str, null_value: float = 0.0,
) -> Callable[[Hideout], Callable[[float], Parameters]]:
    """One parameter, that far above its null value."""
    return lambda _: lambda s: {name: null_value + s}


def _signed(
    name: str, null_value: float = 0.0,
) -> Callable[[Hideout], Callable[[float], Parameters]]:
    """One parameter, that far from its null value on either side."""
    def shaped(at: Hideout) -> Callable[[float], Parameters]:
        sign = at.sign()
        return lambda s: {name: null_value + sign * s}
    return shaped


def _vector(x: str, y: str, **rest: float) -> Callable[[Hideout], Callable[[float], Parameters]]:
    """Two parameters that are a vector."""
    def shaped(at: Hideout) -> Callable[[float], Parameters]:
        along, across = at.direction()
        return lambda s: {x: s * along, y: s * across, **rest}
    return shaped


def _linear_flow(at: Hideout) -> Callable[[float], Parameters]:
    gradient = at.rng.standard_normal(4)
    names = ('gxx_per_s', 'gxy_per_s', 'gyx_per_s', 'gyy_per_s')
    return lambda s: {name: s * float(g) for name, g in zip(names, gradient, strict=True)}


def _hot_spot(at: Hideout) -> Callable[[float], Parameters]:
    x, y, width, sign = at.place(), at.place(), float(at.rng.uniform(15, 30)), at.sign()
    return lambda s: {'x_um': x, 'y_um': y, 'speed_um_s': sign * s, 'width_um': width}


def _periodic_drift(at: Hideout) -> Callable[[float], Parameters]:
    fixed = {
        'frequency_hz': at.frequency(), 'direction_rad': float(at.rng.uniform(0, math.pi)),
        'phase_rad': float(at.rng.uniform(-math.pi, math.pi))}
    return lambda s: {'amplitude_um_s': s, **fixed}


def _drive_response(at: Hideout) -> Callable[[float], Parameters]:
    """Either end of the washboard: it sticks below cut-in, or slips beyond step-out.

    Strengths in which the loss of speed is nearly linear, for rollers driven at up to 20 Hz.
    """
    if at.rng.random() < 0.5:
        return lambda s: {'cut_in_hz': math.sqrt(s)}
    return lambda s: {'step_out_hz': 20 * math.exp(-(s**2))}


def _oscillating(strength: str) -> Callable[[Hideout], Callable[[float], Parameters]]:
    def shaped(at: Hideout) -> Callable[[float], Parameters]:
        frequency = at.frequency()
        return lambda s: {strength: s, 'frequency_hz': frequency}
    return shaped


def _lamp_change(at: Hideout) -> Callable[[float], Parameters]:
    time = at.midway()
    return lambda s: {'time_s': time, 'factor': 1 - s}


def _stage_jump(at: Hideout) -> Callable[[float], Parameters]:
    time, (x, y) = at.midway(), at.direction()
    return lambda s: {'time_s': time, 'x_um': s * x, 'y_um': s * y}


LISTED: dict[str, Kind] = {
    'uniform_drift': Kind(_vector('wx_um_s', 'wy_um_s'), 0.2, 5.0),
    'linear_flow': Kind(_linear_flow, 0.005, 0.1),
    'alignment_lag': Kind(_plain('tau_s'), 0.1, 2.0),
    'background_field': Kind(_vector('bx_mT', 'by_mT'), 0.3, 2.0),
    'coil_gain_mismatch': Kind(_signed('gain_ratio', 1.0), 0.1, 0.5),
    'coil_misalignment': Kind(_signed('skew_rad'), 0.1, 0.5),
    'speed_decay': Kind(lambda at: lambda s: {'tau_s': at.duration / s}, 0.3, 10.0),
    'command_delay': Kind(_plain('delay_s'), 0.1, 1.0),
    'heading_slip': Kind(_signed('rate_rad_s'), 0.005, 0.2),
    'dipole_interaction': Kind(_plain('strength_um5_s'), 3e4, 1e6, pairs=True),
    'hydrodynamic_slowdown': Kind(_plain('length_um'), 1.0, 10.0, pairs=True),
    'hot_spot': Kind(_hot_spot, 1.0, 10.0),
    'periodic_drift': Kind(_periodic_drift, 0.3, 10.0),
    'amplifier_deadband': Kind(_plain('deadband_mT'), 0.3, 0.8),
    'pixel_anisotropy': Kind(_signed('aspect', 1.0), 0.05, 0.25),
    'gradient_force': Kind(_signed('rate_per_s_mT'), 0.001, 0.1),
    'coil_pull': Kind(_signed('rate_um_s_mT'), 0.05, 2.0, levels=True),
    'incomplete_alignment': Kind(_plain('field_scale_mT'), 0.2, 5.0, levels=True),
    'drive_response': Kind(_drive_response, 0.3, 5.0),
}
"""Effects of the library under their ids."""

UNLISTED: dict[str, Kind] = {
    'poiseuille_flow': Kind(
        lambda at: lambda s: {'speed_um_s': s, 'half_width_um': 1.5 * at.extent}, 1.0, 20.0),
    'speed_by_place': Kind(lambda at: lambda s: {'length_um': at.extent / s}, 0.2, 1.5),
    'pulsing_speed': Kind(_oscillating('depth'), 0.2, 0.9),
    'speed_by_heading': Kind(_plain('depth'), 0.2, 0.9),
    'lamp_change': Kind(_lamp_change, 0.2, 0.9),
    'stage_jump': Kind(_stage_jump, 1.0, 30.0),
    'heading_wobble': Kind(_oscillating('angle_rad'), 0.2, 1.0),
    'settling_flow': Kind(
        lambda at: _vector('wx_um_s', 'wy_um_s', tau_s=at.duration / 4)(at), 1.0, 20.0),
    'trap': Kind(lambda at: lambda s: {'speed_um_s': s, 'length_um': 0.7 * at.extent}, 1.0, 20.0),
    'repulsion': Kind(
        lambda _: lambda s: {'speed_um_s': s, 'range_um': 8.0}, 5.0, 20.0, pairs=True),
    'swimmer_flow': Kind(_plain('strength_um3_s'), 100.0, 2000.0, pairs=True),
}
"""Effects in no library. (Chirality is not among them: a field that aligns absorbs it in φ.)"""

KINDS = LISTED | UNLISTED
