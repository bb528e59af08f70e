"""How messages cross between processes of one machine."""

from __future__ import annotations

import fcntl
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib import resources
from pathlib import Path

NODE = 'node_transport.xml'
"""The profile of nodes, with shared memory for frames. The default segment of Fast DDS holds one
of 640×480 and not one of 1280×1024, which then crosses by UDP in 24 ms instead of 4."""

CLIENT = 'client_transport.xml'
"""The profile of who comes and goes: UDP alone."""

BY_PROFILE, NOWHERE = 'SYSTEM_DEFAULT', 'OFF'
"""Ranges of discovery: what the profile says, and none."""

RANGE = 'ROS_AUTOMATIC_DISCOVERY_RANGE'
_PROFILES = 'FASTRTPS_DEFAULT_PROFILES_FILE'
_HERE = 'LOCALHOST'
_LOOPBACK = '0100007F:'
"""127.0.0.1 as the kernel's tables have it."""

_SHARED = Path('/dev/shm')
_LOCKS = f'fastrtps_{"[0-9a-f]" * 16}_el'
_FRESH_SECONDS = 5.0
"""A segment this young may not have been locked yet by the process that makes it."""


def asked_reach(middleware: str) -> str | None:
    """The range of discovery that the caller's environment asks for; None where ours is to do.

    Whoever names peers, has a profile of their own or another `middleware` than Fast DDS, for
    which ours are, is left with what that makes of the range.
    """
    reach = os.environ.get(RANGE, _HERE)
    theirs = (reach != _HERE or _PROFILES in os.environ or os.environ.get('ROS_STATIC_PEERS')
              or not middleware.startswith('rmw_fastrtps'))
    return reach if theirs else None


@contextmanager
def transport(reach: str, profile: str = '') -> Iterator[None]:
    """A participant that is made meanwhile has this range of discovery, `reach`, and a `profile`,
    where the caller has none.

    Fast DDS reads the profile when the first participant of a process is made, and never again.
    """
    before = {name: os.environ.get(name) for name in (RANGE, _PROFILES)}
    os.environ[RANGE] = reach
    if profile:
        file = resources.files('microbot_ros.nodes.base') / profile
        os.environ.setdefault(_PROFILES, str(file))
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name, None)
            if value is not None:
                os.environ[name] = value


def reached_sockets() -> set[str]:
    """The UDP sockets of this process that are bound elsewhere than to loopback, by inode."""
    own = set()
    for file in Path('/proc/self/fd').iterdir():
        with suppress(OSError):  # closed meanwhile
            own.add(os.readlink(file).removeprefix('socket:[').removesuffix(']'))
    rows = [line.split() for table in Path('/proc/self/net').glob('udp*')
            for line in table.read_text().splitlines()[1:]]
    return own & {row[9] for row in rows if not row[1].startswith(_LOOPBACK)}


def clear_shared_memory() -> None:
    """Remove the shared memory of processes that were killed, 35 MB each.

    Whoever made a segment of Fast DDS holds a lock on the file beside it for as long as it lives.
    """
    for lock in _SHARED.glob(_LOCKS):
        with suppress(OSError), lock.open('rb') as held:  # of another user, or gone meanwhile
            if time.time() - os.fstat(held.fileno()).st_mtime > _FRESH_SECONDS:
                fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
                _remove(lock)


def remove_own_shared_memory() -> None:
    """Remove what this process made: it ends now, without telling the middleware."""
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
