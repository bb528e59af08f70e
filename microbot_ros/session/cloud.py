"""Particles as sensor_msgs/PointCloud2: one point a particle, fields by name."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from microbot_ros.errors import InputError

# sensor_msgs/msg/PointField: INT8 = 1 … FLOAT64 = 8.
_TYPES = {1: 'i1', 2: 'u1', 3: 'i2', 4: 'u2', 5: 'i4', 6: 'u4', 7: 'f4', 8: 'f8'}
_REQUIRED = ('id', 'x', 'y')
_OPTIONAL = ('theta', 'sigma')


def cloud_points(content: Any, path: Path, topic: str) -> dict[str, np.ndarray]:
    """The columns `id`, `x`, `y` [m], `theta` [rad] and `sigma` [m] of a decoded cloud, (n,) each.

    NaN for `theta` and `sigma` where the cloud has no such field; InputError where it lacks
    another or its size contradicts its fields.
    """
    fields = tuple((field.name, field.datatype, field.offset) for field in content.fields)
    missing = [name for name in _REQUIRED if name not in {field[0] for field in fields}]
    count = content.width * content.height
    if missing or len(content.data) != count * content.point_step:
        problem = f'fields {", ".join(_REQUIRED)}' if missing else 'as much data as points'
        raise InputError(path, f'{topic}: expected {problem}')
    dtype = _dtype(fields, content.point_step, bool(content.is_bigendian))
    points = np.frombuffer(content.data, dtype, count)
    columns = {name: points[name].astype(float) for name in _REQUIRED}
    for name in _OPTIONAL:
        known = name in (dtype.names or ())
        columns[name] = points[name].astype(float) if known else np.full(count, np.nan)
    return columns


@cache
def _dtype(fields: tuple[tuple[str, int, int], ...], step: int, big: bool) -> np.dtype:
    order = '>' if big else '<'
    return np.dtype({
        'names': [name for name, _, _ in fields],
        'formats': [order + _TYPES[kind] for _, kind, _ in fields],
        'offsets': [offset for _, _, offset in fields], 'itemsize': step,
    })
