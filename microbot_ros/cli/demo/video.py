"""Film of the demo: the camera's frames with the results of the nodes."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from microbot_ros.cli.demo.results import DemoRun
from microbot_ros.cli.replay.film import poses_of
from microbot_ros.loop.points import PARTICLE
from microbot_ros.nodes.base import messages
from microbot_ros.session.mcap.recording import Recording
from microbot_ros.tracking import ImageToWorkspace
from microbot_ros.tracking.overlay import OverlayVideo, draw_overlay

_RADIUS_PX = 8.0
"""Radius of circles [px]. Choice: larger than a particle, smaller than distances between them."""
_TRAIL_FRAMES = 60
"""Length of trails [frames]. Choice: 6 s, as every sixth of 60 frames a second is recorded."""
_ORANGE, _WHITE = (0, 159, 230), (255, 255, 255)
"""Colours (blue, green, red): orange of Okabe and Ito (2008), and white."""


def write_video(run: DemoRun, recording: Path, pixel_size: float, path: Path) -> None:
    """Write every frame of a recording, with the results of a run, as an MP4.

    Parameters
    ----------
    run : DemoRun
        The run.
    recording : Path
        The recording.
    pixel_size : float
        Size of a pixel [m].
    path : Path
        File to write.
    """
    frames = list(_frames(recording))
    if len(frames) < 2:
        return
    height, width = frames[0][1].shape
    camera = ImageToWorkspace(pixel_size, width, height)
    rate = (len(frames) - 1) / (frames[-1][0] - frames[0][0])
    fields = _fields(recording)
    trails: dict[int, deque[np.ndarray]] = {}
    with OverlayVideo(path, (height, width), rate, _RADIUS_PX) as film:
        for stamp, image in frames:
            points = run.particles.get(stamp, np.empty(0, PARTICLE))
            poses = poses_of(points, camera, stamp)
            for i, place in zip(poses.id.tolist(), poses.xy, strict=True):
                trails.setdefault(i, deque(maxlen=_TRAIL_FRAMES)).append(place)
            picture = draw_overlay(image, poses, _RADIUS_PX, trails)
            _draw_estimates(picture, run, stamp, camera)
            _draw_goals(picture, run, stamp, camera)
            _draw_field(picture, fields, stamp)
            _write(picture, f't = {stamp - run.origin:5.1f} s', (10, height - 12))
            film.write_picture(picture)


def _frames(recording: Path) -> Iterator[tuple[float, np.ndarray]]:
    with Recording(recording) as opened:
        for raw in opened.messages(topics=['/camera/image_raw']):
            message: Any = opened.decode(raw)
            yield messages.to_seconds(message.header.stamp), messages.gray(message)


def _fields(recording: Path) -> np.ndarray:
    """Return rows (t, bx, by) of the field read back from the coils."""
    with Recording(recording) as opened:
        rows = []
        for raw in opened.messages(topics=['/field/applied']):
            message: Any = opened.decode(raw)
            field = message.magnetic_field
            rows.append((messages.to_seconds(message.header.stamp), field.x, field.y))
    return np.array(rows).reshape(-1, 3)


def _draw_estimates(picture: np.ndarray, run: DemoRun, stamp: float,
                    camera: ImageToWorkspace) -> None:
    for found in run.estimates.get(stamp, ()):
        if np.isfinite(found['speed_std']):
            x, y = camera.pixels(np.array([found['x'], found['y']]))
            text = f'{found["speed"] * 1e6:.1f}+-{1.96 * found["speed_std"] * 1e6:.1f} um/s'
            _write(picture, text, (round(float(x)) - 30, round(float(y)) + 28))


def _draw_goals(picture: np.ndarray, run: DemoRun, stamp: float, camera: ImageToWorkspace) -> None:
    given = [places for t, places in run.goals if t <= stamp]
    for number, (x, y) in enumerate(camera.pixels(given[-1]) if given else (), 1):
        centre = (round(float(x)), round(float(y)))
        cv2.drawMarker(picture, centre, _ORANGE, cv2.MARKER_CROSS, 16, 2)
        _write(picture, str(number), (centre[0] + 8, centre[1] - 8))


def _draw_field(picture: np.ndarray, fields: np.ndarray, stamp: float) -> None:
    """Draw the field as an arrow in the corner; its full length is 5 mT."""
    row = np.searchsorted(fields[:, 0], stamp) - 1
    bx, by = fields[row, 1:] if row >= 0 else (0.0, 0.0)
    centre = np.array([picture.shape[1] - 45, 45])
    tip = centre + np.array([bx, -by]) / 5e-3 * 30
    cv2.circle(picture, centre.tolist(), 32, _WHITE, 1, cv2.LINE_AA)
    cv2.arrowedLine(picture, centre.tolist(), np.rint(tip).astype(int).tolist(), _ORANGE, 2,
                    cv2.LINE_AA, tipLength=0.3)
    _write(picture, f'B {np.hypot(bx, by) * 1e3:.1f} mT', (picture.shape[1] - 85, 95))


def _write(picture: np.ndarray, text: str, place: tuple[int, int]) -> None:
    for colour, thickness in (((40, 40, 40), 3), (_WHITE, 1)):
        cv2.putText(picture, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.42, colour, thickness,
                    cv2.LINE_AA)
