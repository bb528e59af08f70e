"""What to say before work that is silent the first time: code is compiled then, and kept."""

from __future__ import annotations

import os
from itertools import islice
from pathlib import Path

import microbot_ros

_ENOUGH = 20
"""Compiled functions kept on disk, of some sixty: with fewer much is left to be compiled."""


def note_on_compiling() -> str:
    """A sentence while much is not compiled yet; '' afterwards."""
    kept = os.environ.get('NUMBA_CACHE_DIR') or Path(microbot_ros.__file__).parent
    compiled = list(islice(Path(kept).rglob('*.nbi'), _ENOUGH))
    return '' if len(compiled) == _ENOUGH else (
        'the first time code is compiled, which takes up to two minutes; it is kept')
