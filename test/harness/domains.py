"""ROS domains for the tests of this process alone."""

from __future__ import annotations

import fcntl
import os
import tempfile
from pathlib import Path


def own_domain() -> int:
    """A ROS domain that no other test process of this machine uses, for as long as we live."""
    for domain in range(1, 101):
        lock = os.open(Path(tempfile.gettempdir()) / f'microbot_ros_domain_{domain}',
                       os.O_CREAT | os.O_RDWR, 0o666)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(lock)
            continue
        return domain
    raise RuntimeError('no free ROS domain')
