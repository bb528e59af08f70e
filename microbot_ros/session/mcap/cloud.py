"""Particles as sensor_msgs/PointCloud2: one point per particle, fields by name."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from microbot_ros.common.errors import InputError

POINT_TYPES = {1: 'i1', 2: 'u1', 3: 'i2', 4: 'u2', 5: 'i4', 6: 'u4', 7: 'f4', 8: 'f8'}
"""Kind of number by code, of sensor_msgs/msg/PointField: INT8 = 1 … FLOAT64 = 8."""

_REQUIRED = ('id', 'x', 'y')
_OPTIONAL = ('theta', 'sigma')


def is_cloud(content: Any) -> bool:
    """Return whether a decoded message `content` is a PointCloud2 whose data match its fields.

    Parameters
    ----------
    content : object
        The decoded message.

    Returns
    -------
    bool
        Whether it is.
    """
    return (
        getattr(content, '__msgtype__', '') == 'sensor_msgs/msg/PointCloud2'
        and len(content.data) == content.width * content.height * content.point_step
        and all(field.datatype in POINT_TYPES and field.count == 1 for field in content.fields)
    )


def cloud_table(content: Any) -> np.ndarray:
    """Return the points of a cloud `content`, (n,) with a named column per field.

    Parameters
    ----------
    content : object
        The message, of whatever library.

    Returns
    -------
    ndarray, shape (n,)
        Structured array.
    """
    fields = tuple((field.name, field.datatype, field.offset) for field in content.fields)
    dtype = _dtype(fields, content.point_step, bool(content.is_bigendian))
    return np.frombuffer(content.data, dtype, content.width * content.height)


def cloud_points(content: Any, path: Path, topic: str) -> dict[str, np.ndarray]:
    """Return the columns `id`, `x`, `y` [m], `theta` [rad] and `sigma` [m] of a cloud, (n,) each.

    `content` is the decoded message on `topic` of the recording `path`. `theta` and `sigma` are
    NaN without such a field. Raises InputError if another field is missing or the size does not
    match.

    Parameters
    ----------
    content : object
        The decoded message.
    path : Path
        The recording, for messages.
    topic : str
        Name of the topic.

    Returns
    -------
    dict of str to ndarray
        Columns (n,) by name.
    """
    there = {field.name for field in content.fields}
    if not there.issuperset(_REQUIRED):
        raise InputError(path, f'{topic}: expected fields {", ".join(_REQUIRED)}')
    if not is_cloud(content):
        raise InputError(path, f'{topic}: expected one data entry per point')
    points = cloud_table(content)
    unknown = np.full(len(points), np.nan)
    return {name: points[name].astype(float) for name in _REQUIRED} | {
        name: points[name].astype(float) if name in there else unknown for name in _OPTIONAL
    }


@cache
def _dtype(fields: tuple[tuple[str, int, int], ...], step: int, big: bool) -> np.dtype:
    order = '>' if big else '<'
    return np.dtype({
        'names': [name for name, _, _ in fields],
        'formats': [order + POINT_TYPES[kind] for _, kind, _ in fields],
        'offsets': [offset for _, _, offset in fields], 'itemsize': step,
    })
