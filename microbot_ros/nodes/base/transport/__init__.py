"""Transport of messages between the processes of one machine."""

from __future__ import annotations

import fcntl
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib import resources
from pathlib import Path

NODE = 'node_transport.xml'
"""Profile of nodes, with shared memory for frames. The default segment of Fast DDS holds one frame
of 640×480 and none of 1280×1024, which then crosses by UDP in 24 ms instead of 4."""

CLIENT = 'client_transport.xml'
"""Profile of short-lived clients: UDP alone."""

BY_PROFILE, NOWHERE = 'SYSTEM_DEFAULT', 'OFF'
"""Ranges of discovery: that of the profile, and none."""

RANGE = 'ROS_AUTOMATIC_DISCOVERY_RANGE'
_PROFILES = 'FASTRTPS_DEFAULT_PROFILES_FILE'
_HERE = 'LOCALHOST'
_LOOPBACK = '0100007F:'
"""Address 127.0.0.1 as in the kernel's tables."""

_SHARED = Path('/dev/shm')
_LOCKS = f'fastrtps_{"[0-9a-f]" * 16}_el'
"""Pattern of the lock files of Fast DDS, as seen in its source."""
_FRESH_SECONDS = 5.0
"""Age [s] below which a segment may not have been locked yet by its process. Choice: far longer
than creating it takes."""


def asked_reach(middleware: str) -> str | None:
    """Return the range of discovery that the user's environment requests.

    If the user names peers, has an own profile or uses another middleware than Fast DDS, for which
    the profiles here are made, the range has the meaning of that setup.

    Parameters
    ----------
    middleware : str
        Identifier of the middleware.

    Returns
    -------
    str or None
        None if nothing is requested and the profiles here apply.
    """
    reach = os.environ.get(RANGE, _HERE)
    theirs = (reach != _HERE or _PROFILES in os.environ or os.environ.get('ROS_STATIC_PEERS')
              or not middleware.startswith('rmw_fastrtps'))
    return reach if theirs else None


@contextmanager
def transport(reach: str, profile: str = '') -> Iterator[None]:
    """Give a participant made in this context a range of discovery and a profile.

    A profile of the user is kept. Fast DDS reads the profile when the first participant of a
    process is made, and never again.

    Parameters
    ----------
    reach : str
        Range of discovery.
    profile : str
        Name of the profile; '' for none.

    Yields
    ------
    None
    """
    before = {name: os.environ.get(name) for name in (RANGE, _PROFILES)}
    os.environ[RANGE] = reach
    if profile:
        file = resources.files(__name__) / profile
        os.environ.setdefault(_PROFILES, str(file))
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name, None)
            if value is not None:
                os.environ[name] = value


def reached_sockets() -> set[str]:
    """Return the UDP sockets of this process that are bound to other addresses than loopback.

    Returns
    -------
    set of str
        Their inodes.
    """
    own = set()
    for file in Path('/proc/self/fd').iterdir():
        with suppress(OSError):  # closed meanwhile
            own.add(os.readlink(file).removeprefix('socket:[').removesuffix(']'))
    rows = [line.split() for table in Path('/proc/self/net').glob('udp*')
            for line in table.read_text().splitlines()[1:]]
    return own & {row[9] for row in rows if not row[1].startswith(_LOOPBACK)}


def clear_shared_memory() -> None:
    """Remove the shared memory of killed processes, 35 MB each.

    A process that makes a segment of Fast DDS holds a lock on the file beside it as long as it
    lives.
    """
    for lock in _SHARED.glob(_LOCKS):
        with suppress(OSError), lock.open('rb') as held:  # of another user, or gone meanwhile
            if time.time() - os.fstat(held.fileno()).st_mtime > _FRESH_SECONDS:
                fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
                _remove(lock)


def remove_own_shared_memory() -> None:
    """Remove the shared memory of this process, which ends without notifying the middleware."""
    locks = [line.split() for line in Path('/proc/locks').read_text().splitlines()]
    own = {int(words[5].rpartition(':')[2]) for words in locks
           if words[1] == 'FLOCK' and words[4] == str(os.getpid())}
    for lock in _SHARED.glob(_LOCKS):
        with suppress(OSError):
            if lock.stat().st_ino in own:
                _remove(lock)


def _remove(lock: Path) -> None:
    lock.with_name(lock.name.removesuffix('_el')).unlink(missing_ok=True)
    lock.unlink(missing_ok=True)
