"""The topics of a recording by the role they play, whatever namespace they were recorded in."""

from __future__ import annotations


def is_topic(topic: str, name: str) -> bool:
    """Whether a recorded topic is `name`: '/particles' and '/rig/particles' are 'particles'."""
    return f'/{topic}'.endswith(f'/{name}')
