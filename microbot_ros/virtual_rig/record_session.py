"""Film a simulated world: a session as a real rig records it, and the truth."""

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
"""Function from time [s] and observed positions (N, 2) [m] to the field (2,) [T]."""


@dataclass(frozen=True)
class Camera:
    """Camera that observes positions.

    Raises ValueError if runs are too short for so many misses: `run` must be at least
    missed/(1 − missed), and 1.

    Attributes
    ----------
    frame_rate : float [1/s]
    exposure : float
        Fraction of the frame interval with an open shutter: 0 a strobe, 1 always.
    noise : float
        Standard deviation of each coordinate [m].
    missed, run : float
        Fraction of detections that fail, and mean length of their runs [frames].
    dropped : float
        Fraction of whole frames that are lost.
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
    """Film a world under commands, or under feedback from every frame.

    A frame is stamped with the middle of its exposure; its positions are means over the exposure.
    Feedback is called at the end of each exposure with what was seen, gaps (NaN) and noise
    included, and acts at once.

    Parameters
    ----------
    world : World
        Particles to film.
    control : Commands or Feedback
        Commands, or a function of what was seen.
    camera : Camera
        Camera that films.
    duration : float [s]
        Duration of the film.
    rng : Generator
        Source of random numbers.
    conditions : Conditions, optional
        Conditions of the experiment.

    Returns
    -------
    Session, Path
        The session, and the true path at the stamps.
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


def in_picture(world: World) -> np.ndarray:
    """Return where particles are in a picture that is taken now.

    Parameters
    ----------
    world : World
        The world.

    Returns
    -------
    ndarray, shape (N, 2)
        Positions [m], as effects of camera and stage distort them.
    """
    return world.observe(picture(world.bodies, world.position, world.t))


def picture(bodies: np.ndarray, position: np.ndarray, t: float | np.ndarray) -> np.ndarray:
    """Distort a true `position` (..., N, 2) [m] as pixels and stage do.

    `bodies` (..., N) are of type BODY; `t` [s].

    Parameters
    ----------
    bodies : ndarray, shape (..., N)
        BODY of each particle.
    position : ndarray, shape (..., N, 2)
        True positions [m].
    t : float or ndarray
        Time [s].

    Returns
    -------
    ndarray, shape (..., N, 2)
        Positions in the picture [m].
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
    """Return errors (`frames`, N, 2) [m] of `count` = N particles of a `camera`, drawn by `rng`.

    NaN if missed. Misses of a particle are a two-state Markov chain; a dropped frame misses all.

    Parameters
    ----------
    camera : Camera
        The camera.
    frames : int
        Number of frames.
    count : int
        Number of particles N.
    rng : random.Generator
        Source of random numbers.

    Returns
    -------
    ndarray, shape (frames, N, 2)
        Errors [m].
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
    """Return tracks of positions `seen` (T, N, 2) [m] at times `t` (T,) [s]; NaN gives no row.

    Parameters
    ----------
    t : ndarray, shape (T,)
        Times [s].
    seen : ndarray, shape (T, N, 2)
        Positions [m].

    Returns
    -------
    Tracks
        The tracks.
    """
    frame, particle = np.nonzero(np.isfinite(seen[..., 0]))
    unknown = np.full(len(frame), np.nan)
    return Tracks(t[frame], particle, seen[frame, particle], unknown, unknown.copy())


def scatter(
    rng: np.random.Generator, count: int, half_extent: float, spacing: float,
) -> np.ndarray:
    """Draw places (`count`, 2) [m] evenly within ± `half_extent`, none closer than `spacing` [m].

    Raises ValueError if a hundred draws (by `rng`) per particle do not suffice.

    Parameters
    ----------
    rng : random.Generator
        Source of random numbers.
    count : int
        Number of particles N.
    half_extent : float
        Half of the side of the square [m].
    spacing : float
        Least distance [m].

    Returns
    -------
    ndarray, shape (N, 2)
        Places [m].
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
    """Draw swimmers of type BODY with random speeds, offsets, places and headings.

    Parameters
    ----------
    rng : Generator
        Source of random numbers.
    count : int
        Number of particles N.
    fluid : Fluid
        Fluid that drags the particles.
    reference_field : float [T]
        Field at which the alignment time holds.
    radius : float [m]
        Radius of every sphere.
    speed : (float, float) [m/s]
        Lowest and highest.
    half_extent, spacing : float [m]
        As in `scatter`.
    aligns_in : float
        Alignment time at the reference field [s].

    Returns
    -------
    ndarray, shape (N,)
        BODY of each particle.
    """
    radii = np.full(count, radius)
    return bodies(
        fluid, radii, rotational_drag(fluid, radii) / (aligns_in * reference_field),
        rng.uniform(-math.pi, math.pi, count), scatter(rng, count, half_extent, spacing),
        speed=rng.uniform(*speed, count), heading=rng.uniform(-math.pi, math.pi, count))
