"""Overlays of what the tracker sees: a frame with its particles, and a film."""

from __future__ import annotations

from collections import deque
from fractions import Fraction
from pathlib import Path
from typing import BinaryIO

import numpy as np

from microbot_ros.tracking.tracker import Poses

_COLOURS = np.array([
    [230, 159, 0], [86, 180, 233], [0, 158, 115], [240, 228, 66], [0, 114, 178], [213, 94, 0],
    [204, 121, 167],
])[:, ::-1].tolist()
"""Colours for colour-blind viewers (M. Okabe, K. Ito, 2008), as BGR."""

_WIDEST, _TRAIL = 960, 40  # choices: width of a film [px], frames of a trail


def draw_overlay(
    image: np.ndarray, poses: Poses, radius_px: float = 8.0,
    trails: dict[int, deque[np.ndarray]] | None = None,
) -> np.ndarray:
    """Return an `image` (H, W) uint8 or uint16 with its particles drawn, (H, W, 3) BGR.

    A ring of `radius_px` and the identity of `poses` mark each particle, a thin ring a predicted
    one; a line points along θ if known; `trails` holds earlier positions.

    Parameters
    ----------
    image : ndarray, shape (H, W)
        The picture.
    poses : Poses
        Poses of the particles.
    radius_px : float
        Radius of the rings [px].
    trails : dict of int to deque of ndarray or None
        Earlier positions [px] by identity; None for none.

    Returns
    -------
    ndarray, shape (H, W, 3)
        Picture, BGR, uint8.
    """
    import cv2

    if image.dtype != np.uint8:
        image = cv2.convertScaleAbs(image, alpha=255.0 / max(int(image.max()), 1))
    picture: np.ndarray = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    thickness = max(1, round(image.shape[1] / 700))
    ring = round(1.5 * radius_px)
    for k in np.argsort(poses.seen, kind='stable'):
        colour = _COLOURS[int(poses.id[k]) % len(_COLOURS)]
        x, y = round(float(poses.x_px[k])), round(float(poses.y_px[k]))
        if trails and poses.id[k] in trails:
            points = np.rint(np.array(trails[int(poses.id[k])])).astype(np.int32)
            cv2.polylines(picture, [points], False, colour, 1, cv2.LINE_AA)
        cv2.circle(picture, (x, y), ring, colour, thickness if poses.seen[k] else 1, cv2.LINE_AA)
        if np.isfinite(poses.theta_rad[k]):
            tip = (round(x + ring * float(np.cos(poses.theta_rad[k]))),
                   round(y + ring * float(np.sin(poses.theta_rad[k]))))
            cv2.line(picture, (x, y), tip, colour, thickness, cv2.LINE_AA)
        cv2.putText(picture, str(poses.id[k]), (x + ring, y - ring // 2),
                    cv2.FONT_HERSHEY_SIMPLEX, 0.45 * thickness, colour, thickness, cv2.LINE_AA)
    return picture


class OverlayVideo:
    """Film of overlays: H.264 in MP4, for browsers and players.

    Parameters
    ----------
    path : Path or binary file
        A pipe gets a fragment of the film every half second.
    size : (int, int) [px]
        Height and width of the frames.
    frame_rate : float [Hz]
        Frame rate of the film.
    radius_px : float
        As in `draw_overlay`.
    """

    def __init__(
        self, path: Path | BinaryIO, size: tuple[int, int], frame_rate: float, radius_px: float
    ) -> None:
        import av

        self._radius = radius_px
        self._trails: dict[int, deque[np.ndarray]] = {}
        scale = min(1.0, _WIDEST / size[1])
        # Colour subsampling of H.264 needs even sides.
        self._size = tuple(int(side * scale) // 2 * 2 for side in reversed(size))
        self._file = av.open(str(path), 'w', format='mp4') if isinstance(path, Path) else av.open(
            path, 'w', format='mp4', options={
                'movflags': 'empty_moov+default_base_moof', 'frag_duration': '500000'})
        self._stream = self._file.add_stream(
            'libx264', Fraction(frame_rate).limit_denominator(1000),
            options={'preset': 'veryfast', 'crf': '24'})
        self._stream.width, self._stream.height = self._size
        self._stream.pix_fmt = 'yuv420p'

    def __enter__(self) -> OverlayVideo:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.mux(self._stream.encode())
        self._file.close()

    def write(self, image: np.ndarray, poses: Poses) -> None:
        """Add one frame, `image` (H, W), with the particles of `poses` and their trails.

        Parameters
        ----------
        image : ndarray, shape (H, W)
            The picture.
        poses : Poses
            Poses of the particles.
        """
        self._trails = {
            int(i): self._trails.get(int(i), deque(maxlen=_TRAIL)) for i in poses.id}
        for i, place in zip(poses.id, poses.xy, strict=True):
            self._trails[int(i)].append(place)
        self.write_picture(draw_overlay(image, poses, self._radius, self._trails))

    def write_picture(self, picture: np.ndarray) -> None:
        """Add a `picture` (H, W, 3) BGR that is drawn already.

        Parameters
        ----------
        picture : ndarray, shape (H, W, 3)
            The picture, BGR.
        """
        import av
        import cv2

        if picture.shape[1::-1] != self._size:
            picture = cv2.resize(picture, self._size, interpolation=cv2.INTER_AREA)
        self._file.mux(self._stream.encode(av.VideoFrame.from_ndarray(picture, format='bgr24')))
