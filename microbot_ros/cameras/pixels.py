"""Buffers of a device as pictures without a copy, and names of pixel formats."""

from __future__ import annotations

from typing import Any

import numpy as np

from microbot_ros.cameras.camera import ENCODINGS
from microbot_ros.common.errors import InputError

GENICAM = {
    'Mono8': 'mono8', 'Mono10': 'mono16', 'Mono12': 'mono16', 'Mono14': 'mono16',
    'Mono16': 'mono16',
    'BayerRG8': 'bayer_rggb8', 'BayerBG8': 'bayer_bggr8', 'BayerGB8': 'bayer_gbrg8',
    'BayerGR8': 'bayer_grbg8',
    'BGR8': 'bgr8', 'BGR8Packed': 'bgr8', 'RGB8': 'rgb8', 'RGB8Packed': 'rgb8',
    'BGRa8': 'bgra8', 'BGRA8Packed': 'bgra8', 'RGBa8': 'rgba8', 'RGBA8Packed': 'rgba8',
}
"""GenICam pixel formats (PFNC 2.4 and earlier names) → encodings."""


def encoding_of(pixel_format: str, known: dict[str, str], source: str) -> str:
    """Return the encoding of a `pixel_format` among the `known`, or blame `source`.

    Parameters
    ----------
    pixel_format : str
        Name of the format.
    known : dict of str to str
        Encoding by format.
    source : str
        Name of the camera, for messages.

    Returns
    -------
    str
        The encoding.
    """
    if pixel_format not in known:
        raise InputError(source, f'delivers pixels as {pixel_format}; expected a pixel_format of '
                                 f'{", ".join(known)}')
    return known[pixel_format]


def picture(data: Any, encoding: str, height: int, width: int, stride: int = 0) -> np.ndarray:
    """View a buffer as a picture (height, width) or (height, width, values), without a copy.

    Parameters
    ----------
    data : buffer
        Bytes of the picture, row after row.
    encoding : str
        One of `ENCODINGS`.
    height, width : int [px]
        Size of the picture.
    stride : int
        Length of a row [bytes]; 0 if there is no padding.

    Returns
    -------
    ndarray
        View of the buffer.

    Raises
    ------
    ValueError
        If the buffer is too short.
    """
    kind, values = ENCODINGS[encoding]
    row = width * values * np.dtype(kind).itemsize
    rows = np.frombuffer(data, np.uint8, height * (stride or row)).reshape(height, stride or row)
    pixels = rows[:, :row].view(kind)
    return pixels.reshape(height, width, values) if values > 1 else pixels
