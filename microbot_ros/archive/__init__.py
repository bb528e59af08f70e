"""Many recordings on Dask: found by content, each processed once, and compared.

    from microbot_ros.archive import run_batch, conclude, read_table

Nothing is loaded before it is needed: Dask by `run_batch`, PyArrow by `read_table`.

Examples
--------
Recordings of one rig differ in a quantity by more than their errors:

>>> import numpy as np
>>> from microbot_ros.archive import spread
>>> found = spread(np.array([1.0, 1.2, 0.9, 1.1]), np.full(4, 0.02))
>>> print(f'{found.mean:.2f}, between recordings {found.between:.2f}')
1.05, between recordings 0.13
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from microbot_ros.archive.batch import Progress, Summary, run_batch
    from microbot_ros.archive.conclusions.conclude import Conclusions, conclude
    from microbot_ros.archive.conclusions.random_effects import Spread, spread
    from microbot_ros.archive.conclusions.recurring import Recurring
    from microbot_ros.archive.store import Archive
    from microbot_ros.archive.table import read_table

_FROM = {
    'Archive': 'store', 'Conclusions': 'conclusions.conclude', 'Progress': 'batch',
    'Recurring': 'conclusions.recurring', 'Spread': 'conclusions.random_effects',
    'Summary': 'batch', 'conclude': 'conclusions.conclude', 'read_table': 'table',
    'run_batch': 'batch', 'spread': 'conclusions.random_effects'}

__all__ = [
    'Archive', 'Conclusions', 'Progress', 'Recurring', 'Spread', 'Summary', 'conclude',
    'read_table', 'run_batch', 'spread',
]


def __getattr__(name: str) -> Any:
    if name not in _FROM:
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    return getattr(import_module(f'{__name__}.{_FROM[name]}'), name)
