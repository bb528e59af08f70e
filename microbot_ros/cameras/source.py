"""Frames of a video, a folder of images or a glob."""

from __future__ import annotations

import glob
import os
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from microbot_ros.common.errors import InputError

# FFmpeg logs to standard error by itself; what matters is reported once, by this module.
os.environ.setdefault('OPENCV_FFMPEG_LOGLEVEL', '-8')
os.environ.setdefault('OPENCV_LOG_LEVEL', 'ERROR')

_IMAGES = ('.png', '.tif', '.tiff', '.bmp', '.jpg', '.jpeg', '.pgm', '.webp')
_MISCOUNT = 2
"""Choice: containers state length as duration × rate, which is off by a frame or two."""


@dataclass(frozen=True)
class Frame:
    """One picture.

    Attributes
    ----------
    index : int
        Position in the source.
    t : float [s]
    image : (H, W) array
        Grey, uint8 or uint16; of another shape if a `see` function was given to the source.
    """

    index: int
    t: float
    image: np.ndarray


See = Callable[[Any], np.ndarray | None]
"""Function from a decoded picture to the array that a frame holds; None to skip the picture."""


def open_source(
    source: str | Path,
    report: Callable[[str], None],
    frame_rate: float | None = None,
    see: See | None = None,
) -> Source:
    """Open a video file, a folder of images or a glob of images.

    Parameters
    ----------
    source : str or Path
        Video file, folder of images, or glob of images.
    report : callable
        Takes one line for everything that is skipped.
    frame_rate : float, optional
        Rate [Hz] that overrides that of a video. Images without one are one per second apart, so
        that t counts frames.
    see : callable, optional
        Function from a decoded picture to the array of a frame; by default `grey`.

    Returns
    -------
    Source
        The source.

    Raises
    ------
    InputError
        If the source is missing, empty or cannot be decoded.
    """
    see = see or grey
    if frame_rate is not None and not 0 < frame_rate < float('inf'):
        raise InputError('frame rate', 'expected a positive number of hertz; received '
                                       f'{frame_rate}')
    path = Path(source)
    if path.is_file():
        return VideoSource(path, report, frame_rate, see)
    if path.is_dir():
        found = [p for p in path.iterdir() if p.suffix.lower() in _IMAGES]
        expected = f'expected images ({", ".join(_IMAGES)}) in this folder'
    elif glob.has_magic(str(source)):
        found = [Path(p) for p in glob.glob(str(source)) if Path(p).is_file()]
        expected = 'expected a pattern that matches images; it matches no file'
    else:
        raise InputError(source, 'expected a video, a folder of images or a glob; not found')
    if not found:
        raise InputError(source, expected)
    return ImageSource(str(source), sorted(found, key=natural_order), report, frame_rate, see)


def grey(image: Any) -> np.ndarray | None:
    """Convert a decoded `image`, an array, to grey (H, W); None if not 8 or 16 bit.

    Parameters
    ----------
    image : object
        The image.

    Returns
    -------
    ndarray, shape (H, W), or None
        Uint8 or uint16, or None.
    """
    import cv2

    picture = decoded(image)
    if picture is None or picture.ndim == 2:
        return picture
    return cv2.cvtColor(
        picture, cv2.COLOR_BGR2GRAY if picture.shape[2] == 3 else cv2.COLOR_BGRA2GRAY)


def decoded(image: Any) -> np.ndarray | None:
    """Return a decoded `image`, an array, if it has 8 or 16 bit, else None.

    Its shape is (H, W), or (H, W, 3 or 4) with blue first.

    Parameters
    ----------
    image : object
        The image.

    Returns
    -------
    ndarray or None
        The image, or None.
    """
    usual = image.ndim == 2 or image.shape[2] in (3, 4)
    return image if usual and image.dtype in (np.uint8, np.uint16) else None


class VideoSource:
    """Video file, decoded from start to end.

    `report` takes sentences about anything unusual; `frame_rate` [Hz] overrides that of the file;
    `see` as in `open_source`.

    Parameters
    ----------
    path : Path
        The video file.
    report : callable
        Function that is called with a sentence on everything unusual.
    frame_rate : float or None
        Frame rate [Hz]; None for that of the file.
    see : See
        Function from a decoded picture to the array of a frame.
    """

    def __init__(
        self, path: Path, report: Callable[[str], None], frame_rate: float | None = None,
        see: See = grey,
    ) -> None:
        import cv2

        self.name = str(path)
        self._report = report
        self._see = see
        self._forced_rate = frame_rate
        self._capture = cv2.VideoCapture(self.name, cv2.CAP_FFMPEG)
        got, picture = self._capture.read() if self._capture.isOpened() else (False, None)
        first = see(picture) if got else None
        if first is None:
            raise InputError(path, 'expected a video; no frame of it can be decoded')
        stated_rate = self._capture.get(cv2.CAP_PROP_FPS)
        stated_length = self._capture.get(cv2.CAP_PROP_FRAME_COUNT)
        self._stated_rate = stated_rate if 0 < stated_rate < 1e6 else None
        self.frame_rate = frame_rate or self._stated_rate
        self.length = int(stated_length) if 0 < stated_length < 1e9 else None
        self.size = first.shape[:2]
        self._first: np.ndarray | None = first

    def frames(self) -> Iterator[Frame]:
        """Yield every frame that can be decoded; others are reported and skipped.

        So are frames of another size than the first, which is `size` (height, width). A second
        call starts again.

        Yields
        ------
        Frame
            The frame.
        """
        import cv2

        if self._first is None:
            self._capture.open(self.name, cv2.CAP_FFMPEG)
        image, self._first = self._first, None
        index, t = 0, 0.0
        while True:
            if image is None:
                got, picture = self._capture.read()
                if not got:
                    break
                image = self._see(picture)
            stamp = self._capture.get(cv2.CAP_PROP_POS_MSEC) / 1e3
            t = self._time(index, t, stamp)
            if image is None or image.shape[:2] != self.size:
                size = _size(self.size)
                self._report(f'{self.name}: frame {index} is not {size}; left out')
            else:
                yield Frame(index, t, image)
            image = None
            index += 1
        self._capture.release()
        if self.length is not None and index < self.length - _MISCOUNT:
            self._report(f'{self.name}: ends after {index} of {self.length} frames')

    def _time(self, index: int, previous: float, stamp: float) -> float:
        """Return the container's time stamp if it increases, else count frames."""
        if self._forced_rate:
            return index / self._forced_rate
        if index == 0:
            self._origin = stamp
            return 0.0
        if previous < stamp - self._origin < float('inf'):
            return stamp - self._origin
        return previous + 1 / (self._stated_rate or 1.0)


class ImageSource:
    """Images as frames, in natural order of their names (2 before 10).

    `report` takes sentences about anything unusual; `frame_rate` [Hz] spaces the images; `see` as
    in `open_source`.

    Parameters
    ----------
    name : str
        Name of the source.
    paths : list of Path
        The images.
    report : callable
        Function that is called with a sentence on everything unusual.
    frame_rate : float or None
        Frame rate [Hz]; None for one image per second.
    see : See
        Function from a decoded picture to the array of a frame.
    """

    def __init__(
        self,
        name: str,
        paths: list[Path],
        report: Callable[[str], None],
        frame_rate: float | None = None,
        see: See = grey,
    ) -> None:
        self.name = name
        self.frame_rate = frame_rate
        self.length: int | None = len(paths)
        self._paths = paths
        self._report = report
        self._see = see
        first = next((image for path in paths if (image := _read_image(path, see)) is not None),
                     None)
        if first is None:
            raise InputError(name, f'expected images; none of the {len(paths)} can be decoded')
        self.size = first.shape[:2]

    def frames(self) -> Iterator[Frame]:
        """Yield every frame that can be decoded; others are reported and skipped.

        So are frames of another size than the first, which is `size` (height, width). A second
        call starts again.

        Yields
        ------
        Frame
            The frame.
        """
        for index, path in enumerate(self._paths):
            image = _read_image(path, self._see)
            if image is None:
                self._report(f'{path}: frame {index} cannot be decoded; left out')
            elif image.shape[:2] != self.size:
                found = _size(image.shape)
                self._report(
                    f'{path}: frame {index} is {found}, expected {_size(self.size)}; left out'
                )
            else:
                yield Frame(index, index / (self.frame_rate or 1.0), image)


Source = VideoSource | ImageSource
"""Frames in order; `frame_rate` [Hz] and `length` are None if unknown."""


def read_picture(path: Path) -> np.ndarray:
    """Read the image file `path` as grey (H, W), 8 or 16 bit, or raise InputError.

    Parameters
    ----------
    path : Path
        Image file to read.

    Returns
    -------
    ndarray, shape (H, W)
        Uint8 or uint16.
    """
    image = _read_image(path, grey)
    if image is None:
        raise InputError(path, 'expected a picture of 8 or 16 bit; it cannot be decoded')
    return image


def _read_image(path: Path, see: See) -> np.ndarray | None:
    import cv2

    try:
        content = np.fromfile(path, np.uint8)
        image = cv2.imdecode(content, cv2.IMREAD_UNCHANGED) if len(content) else None
    except (OSError, cv2.error):
        return None
    return None if image is None else see(image)


def natural_order(path: Path) -> list[str | tuple[int, str]]:
    """Return a sort key for the file `path` in natural order: 2 before 10.

    Parameters
    ----------
    path : Path
        Path that is sorted; the file is not opened.

    Returns
    -------
    list of str or tuple[int, str]
        Text and numbers of the path, the numbers padded to 20 digits.
    """
    parts = re.split(r'(\d+)', str(path))
    return [f'{int(part):020d}' if part.isdigit() else part for part in parts]


def _size(shape: tuple[int, ...]) -> str:
    return f'{shape[1]}×{shape[0]}'
