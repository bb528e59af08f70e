"""Filming a simulated world: a session as a real rig would have recorded it, and the truth."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from microbot_ros.common.records import Commands, Conditions, Session, Tracks
from microbot_ros.model.physics.langevin import Path
from microbot_ros.model.physics.particle import Fluid, rotational_drag
from microbot_ros.virtual_rig.body import bodies
from microbot_ros.virtual_rig.world import FieldHistory, World

Feedback = Callable[[float, np.ndarray], np.ndarray]
"""From the time [s] and the positions seen (N, 2) [m] to the field wanted (2,) [T]."""


@dataclass(frozen=True)
class Camera:
    """How positions are seen.

    `frame_rate` [1/s]; `exposure`, the part of the frame interval during which the shutter is
    open, 0 a strobe and 1 always; `noise`, standard deviation of each coordinate [m]; `missed`,
    the fraction of detections that fail, in runs of `run` frames on average; `dropped`, the
    fraction of whole frames that never arrive. ValueError where runs are too short for so many
    misses: `run` is at least missed/(1 − missed), and 1.
    """

    frame_rate: float
    exposure: float = 0.0
    noise: float = 0.0
    missed: float = 0.0
    run: float = 1.0
    dropped: float = 0.0

    def __post_init__(self) -> None:
        least = max(self.missed / (1 - self.missed), 1.0)
        if not self.run >= least:
            raise ValueError(f'run must be at least {least:.3g}; received {self.run}')


def record_session(
    world: World, control: Commands | Feedback, camera: Camera, duration: float,
    rng: np.random.Generator, conditions: Conditions | None = None,
) -> tuple[Session, Path]:
    """Film `world` for `duration` [s] under commands, or under feedback from every frame.

    A frame is stamped with the middle of its exposure; its positions are means over the
    exposure. Feedback is asked at the end of each exposure and answered at once, from what was
    seen, gaps (NaN) and noise included. Returns the session and the true path at the stamps.
    """
    shutter = camera.exposure / camera.frame_rate
    count = math.floor((duration - shutter) * camera.frame_rate + 1e-9) + 1
    opens = np.arange(count) / camera.frame_rate
    errors = detection_errors(camera, count, len(world.bodies), rng)
    path = Path(opens + shutter / 2, *_empty(count, len(world.bodies)))
    seen = np.empty_like(path.position)
    if isinstance(control, Commands):
        told, rows = control, len(control.t)
    else:
        told, rows = Commands(np.empty(count), np.empty((count, 2))), 0
    for k, begin in enumerate(opens.tolist()):
        history = FieldHistory.uniform(told if rows == len(told.t) else Commands(
            told.t[:rows], told.field[:rows]))
        world.advance(begin, history)
        first = world.advance(path.t[k], history)
        path.position[k], path.heading[k] = world.position, world.heading
        second = world.advance(begin + shutter, history) if shutter else first
        shown = picture(world.bodies, (first + second) / 2, path.t[k])
        seen[k] = world.observe(shown) + errors[k]
        if not isinstance(control, Commands):
            told.t[k], told.field[k], rows = world.t, control(world.t, seen[k]), k + 1
    recorded = replace(conditions or Conditions(), frame_rate=camera.frame_rate)
    return Session(as_tracks(path.t, seen), told, recorded), path


def _empty(frames: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    return np.empty((frames, count, 2)), np.empty((frames, count))


def picture(bodies: np.ndarray, position: np.ndarray, t: float | np.ndarray) -> np.ndarray:
    """What the camera's pixels and the stage make of true positions (..., N, 2) [m] at `t` [s].

    `bodies` (..., N) are of type BODY.
    """
    seen = position.copy()
    seen[..., 1] *= bodies['aspect']
    jumped = t >= bodies['jump_time']
    if jumped.any():
        seen[..., 0] += jumped * bodies['jump_x']
        seen[..., 1] += jumped * bodies['jump_y']
    return seen


def detection_errors(
    camera: Camera, frames: int, count: int, rng: np.random.Generator,
) -> np.ndarray:
    """What to add to true positions (frames, N, 2) [m] of `count` = N particles: noise, or NaN.

    NaN where one was missed. Misses of a particle are a two-state chain; a dropped frame misses
    all.
    """
    visible = np.ones((frames, count), dtype=bool)
    if camera.missed > 0:
        found_again = 1 / camera.run
        lost = found_again * camera.missed / (1 - camera.missed)
        visible[0] = rng.random(count) >= camera.missed
        for k in range(1, frames):
            chance = np.where(visible[k - 1], 1 - lost, found_again)
            visible[k] = rng.random(count) < chance
    visible[rng.random(frames) < camera.dropped] = False
    noise = camera.noise * rng.standard_normal((frames, count, 2))
    return np.where(visible[..., None], noise, np.nan)


def as_tracks(t: np.ndarray, seen: np.ndarray) -> Tracks:
    """Tracks of positions `seen` (T, N, 2) [m] at times `t` (T,) [s]; NaN where there is no row.
    """
    frame, particle = np.nonzero(np.isfinite(seen[..., 0]))
    unknown = np.full(len(frame), np.nan)
    return Tracks(t[frame], particle, seen[frame, particle], unknown, unknown.copy())


def scatter(
    rng: np.random.Generator, count: int, half_extent: float, spacing: float,
) -> np.ndarray:
    """Places (`count`, 2) [m] drawn evenly within ± `half_extent`, none closer than `spacing`.

    ValueError where so many do not fit, as far as a hundred draws each can tell.
    """
    places = np.empty((0, 2))
    for _ in range(100 * count):
        place = rng.uniform(-half_extent, half_extent, 2)
        if np.all(np.hypot(*(places - place).T) >= spacing):
            places = np.vstack((places, place))
        if len(places) == count:
            return places
    raise ValueError(f'{count} particles {spacing} m apart do not fit within ±{half_extent} m')


def draw_swarm(
    rng: np.random.Generator, count: int, fluid: Fluid, reference_field: float,
    *, radius: float = 4.6e-6, speed: tuple[float, float] = (3.5e-6, 6e-6),
    half_extent: float = 100e-6, spacing: float = 15e-6, aligns_in: float = 0.5e-3,
) -> np.ndarray:
    """Swimmers (`count`,) of type BODY with random speeds, offsets, places and headings.

    Spheres of `radius` [m]; `speed` from lowest to highest [m/s]; `half_extent` and `spacing` [m]
    as in `scatter`. Their moments align them in `aligns_in` [s] at `reference_field` [T].
    """
    radii = np.full(count, radius)
    return bodies(
        fluid, radii, rotational_drag(fluid, radii) / (aligns_in * reference_field),
        rng.uniform(-math.pi, math.pi, count), scatter(rng, count, half_extent, spacing),
        speed=rng.uniform(*speed, count), heading=rng.uniform(-math.pi, math.pi, count))
