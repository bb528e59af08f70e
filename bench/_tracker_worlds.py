"""Random virtual microscopes: what the tracker must learn to look for without being told."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ros.virtual_rig.microscope import Microscope, MicroscopeSettings

LEARNING = 10
"""Frames 1/60 s apart that a world begins with; the others follow so slowly that focus changes."""

_FAST, _SLOW = 1 / 60, 0.15
_LARGEST_SPEED = 4e-6


@dataclass(frozen=True)
class World:
    """Frames of a few swimming spheres among debris, and the truth of each frame.

    `places` per frame (N, 2) [px], `caps` (N,) direction of the cap [rad, image sense];
    `bright` where the picture is inverted, as in a dark field; `radius_px` of all spheres.
    """

    frames: list[np.ndarray]
    places: list[np.ndarray]
    caps: list[np.ndarray]
    bright: bool
    radius_px: float


def world(seed: int, frames: int) -> World:
    """`LEARNING` frames and so many more of 3 to 8 spheres 5 to 18 px wide, bare to well capped.

    Size, cap, lamp, noise and debris are drawn from the seed; half of all pictures are inverted.
    """
    rng = np.random.default_rng(seed + 100)
    settings = MicroscopeSettings(
        radius_um=rng.uniform(1.2, 4.0), cap_absorption=rng.choice([0, 0.4, 0.75, 0.9]),
        brightness=rng.uniform(80, 200), vignette=rng.uniform(0, 0.4), slope=rng.uniform(0, 0.3),
        specks=int(rng.integers(0, 40)), smudges=int(rng.integers(0, 40)),
        drifting=int(rng.integers(0, 8)), electrons_per_level=rng.uniform(10, 60))
    bright = bool(rng.integers(0, 2))
    scope = Microscope(settings, seed)
    steps = np.repeat([_FAST, _SLOW], [LEARNING, frames])
    room = 2.6 * settings.radius_um * 1e-6 + 2 * _LARGEST_SPEED * steps.sum()
    place = _apart(int(rng.integers(3, 9)), room, settings, rng)
    heading = rng.uniform(-np.pi, np.pi, len(place))
    speed = rng.uniform(0.2, 1, (len(place), 1)) * _LARGEST_SPEED
    result = World([], [], [], bright, settings.radius_um / settings.pixel_size_um)
    for t, dt in zip(np.cumsum(steps), steps, strict=True):
        heading = heading + rng.normal(0, 0.4 * np.sqrt(dt), len(place))
        place = place + dt * speed * np.column_stack([np.cos(heading), np.sin(heading)])
        picture = scope.render(place, heading, float(t))
        result.frames.append(255 - picture if bright else picture)
        result.places.append(scope.pixels(place))
        result.caps.append(np.pi - heading)
    return result


def _apart(
    count: int, room: float, settings: MicroscopeSettings, rng: np.random.Generator
) -> np.ndarray:
    """Places (N, 2) [m] in view, `room` [m] from one another."""
    half = np.array([settings.width_px, settings.height_px]) / 2 * settings.pixel_size
    while True:
        place = rng.uniform(-0.85, 0.85, (count, 2)) * half
        distance = np.linalg.norm(place[:, None] - place, axis=2) + np.eye(count)
        if distance.min() > room:
            return place
