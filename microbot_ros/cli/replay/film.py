"""A recording as a film: its frames with the particles that the tracker found in them."""

from __future__ import annotations

import itertools
import sys
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from microbot_ros.common.errors import InputError
from microbot_ros.common.extras import require
from microbot_ros.common.files import output_folder
from microbot_ros.loop.points import PARTICLE
from microbot_ros.nodes.base import messages
from microbot_ros.session.mcap.recording import Recording, kept_parameters
from microbot_ros.tracking import ImageToWorkspace, Poses
from microbot_ros.tracking.overlay import OverlayVideo

_RADIUS_PX = 8.0
"""Radius of circles [px]. Choice: larger than a particle, smaller than distances between them."""
_WAITING = 32
"""Frames that wait for their particles. Choice: a second at 30 Hz; the tracker takes less than 0.1
s."""
_GROUND_PX, _GREY, _ROOM = (480, 640), 128, 1.05
"""Height and width [px] and grey value of the ground where no frames were recorded, and how much
larger it is than what the particles need. Choices."""


def write_film(session: Path, out: Path) -> None:
    """Draw a recording as an MP4.

    Without recorded frames the particles are drawn on grey ground, all of them in view.

    Parameters
    ----------
    session : Path
        The recording.
    out : Path
        File; `-` is standard output.

    Raises
    ------
    InputError
        If there are neither frames nor particles.
    """
    require('mcap', 'video')
    with Recording(session) as recording:
        frames = recording.topic('camera/image_raw', 'sensor_msgs/msg/Image')
        particles = recording.topic('particles', 'sensor_msgs/msg/PointCloud2')
        shown = frames or particles
        if shown is None or len(times := recording.times(shown)) < 2:
            raise InputError(session, 'expected frames or particles to draw, found none')
        rate = 1e9 * (len(times) - 1) / (times[-1] - times[0])
        if frames:
            pictures = _pictures(recording, frames, particles)
        else:
            pictures = _grounds(recording, str(particles))
        first = next(pictures)
        camera = _camera(recording, first[0]) if frames else _around(recording, str(particles))
        with (_target(out) as target,
              OverlayVideo(target, first[0].shape[:2], rate, _RADIUS_PX) as film):
            for image, points in itertools.chain([first], pictures):
                film.write(image, poses_of(points, camera))


@contextmanager
def _target(out: Path) -> Iterator[Path | BinaryIO]:
    """Context with what to write to; a file has its name once it is whole."""
    if str(out) == '-':
        yield sys.stdout.buffer
        return
    with output_folder(out.parent) as folder:
        yield folder / out.name


def poses_of(points: np.ndarray, camera: ImageToWorkspace, t: float = 0.0) -> Poses:
    """Return particles in the coordinates of a picture.

    Parameters
    ----------
    points : ndarray, shape (N,)
        PARTICLE of each particle.
    camera : ImageToWorkspace
        Geometry of the picture.
    t : float
        Time of the picture [s].

    Returns
    -------
    Poses
        Their poses.
    """
    x, y = camera.pixels(np.column_stack([points['x'], points['y']])).T
    nothing = np.zeros(len(points))
    return Poses(
        t=t, id=points['id'].astype(int), x_px=x, y_px=y,
        theta_rad=camera.image_angle(points['theta']), vx_px_s=nothing, vy_px_s=nothing,
        sigma_px=nothing, seen=np.ones(len(points), bool), kind=np.zeros(len(points), int))


_Pictures = Iterator[tuple[np.ndarray, np.ndarray]]


def _pictures(recording: Recording, frames: str, particles: str | None) -> _Pictures:
    """Yield each frame (H, W) and the particles in it."""
    waiting: deque[tuple[int, np.ndarray]] = deque()
    nothing = np.empty(0, PARTICLE)
    for raw in recording.messages([frames, *([particles] if particles else [])]):
        message: Any = recording.decode(raw)
        stamp = messages.to_nanoseconds(message.header.stamp)
        if raw.topic == frames:
            waiting.append((stamp, messages.gray(message)))
            if len(waiting) <= _WAITING:
                continue
            found, until = nothing, waiting[0][0]
        else:
            found, until = messages.points(message, PARTICLE), stamp
        while waiting and waiting[0][0] <= until:
            taken, image = waiting.popleft()
            yield image, found if taken == stamp else nothing
    for _, image in waiting:
        yield image, nothing


def _grounds(recording: Recording, particles: str) -> _Pictures:
    """Yield a grey picture and the particles of each message of that topic."""
    for raw in recording.messages([particles]):
        message: Any = recording.decode(raw)
        yield np.full(_GROUND_PX, _GREY, np.uint8), messages.points(message, PARTICLE)


def _around(recording: Recording, particles: str) -> ImageToWorkspace:
    """Return the geometry of the grey ground, on which all `particles` fit."""
    height, width = _GROUND_PX
    farthest = 1e-6
    for _, points in _grounds(recording, particles):
        for name, side in (('x', width), ('y', height)):
            farthest = max(farthest, 2 * float(np.abs(points[name]).max(initial=0)) / side)
    return ImageToWorkspace(_ROOM * farthest, width, height)


def _camera(recording: Recording, image: np.ndarray) -> ImageToWorkspace:
    """Return the geometry of an image (H, W), by the tracker's parameters in the recording."""
    height, width = image.shape
    known = kept_parameters(recording.path, recording.attachments(), 'tracker')
    try:
        return ImageToWorkspace.of_tracker(known, width, height)
    except (KeyError, TypeError, ValueError):
        raise InputError(recording.path,
                         'expected the parameters of the tracker inside') from None
