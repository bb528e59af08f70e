"""Process that zeroes the coils when the process that drives them dies or hangs.

It is for devices without a watchdog. It holds the same lines and is fed through its standard
input: a dot at intervals while all is well, `q` at an orderly end. When the dots stop, it sends
the bytes that zero the coils, repeatedly until the dots return; when the feed is closed, it does
so for a while and ends. It is run as a script, by its path, and imports nothing of the project, so
that it is ready within 20 ms and depends on nothing that could fail.

    python sentinel.py SILENCE_S DESCRIPTOR=HEX...
"""

import contextlib
import os
import select
import signal
import sys
import time

ASIDE = 'microbot_sentinels'
"""Control group that all sentinels of a slice share; it remains, empty, when they have ended."""
AGAIN_S = 0.02
"""Interval [s] at which the zero is repeated, as bytes in transit may damage the first. Choice:
longer than a zero takes on the slowest line (17 ms for four Sabertooth channels at 9600 baud)."""
REPEATS = 10
"""Number of zeros after the feed is closed. Choice: 0.2 s of them."""


def watch(silence_s: float, words: list[tuple[int, bytes]], feed: int) -> None:
    """Zero the coils after a silence, until the feed ends.

    Parameters
    ----------
    silence_s : float
        Longest time [s] without a byte.
    words : list of tuple[int, bytes]
        Descriptor of each line and the bytes that zero its coils.
    feed : int
        Descriptor of the feed.
    """
    patience_s = silence_s
    while True:
        if not select.select([feed], [], [], patience_s)[0]:
            say(words)
            patience_s = AGAIN_S
            continue
        patience_s = silence_s
        said = os.read(feed, 4096)
        if b'q' in said:
            return
        if not said:
            break
    for _ in range(REPEATS):
        time.sleep(AGAIN_S)  # also the gap that ends a packet the host left unfinished
        say(words)


def say(words: list[tuple[int, bytes]]) -> None:
    """Write the bytes to the lines; skip a line that is lost or accepts nothing.

    Parameters
    ----------
    words : list of tuple[int, bytes]
        Descriptor of each line and its bytes.
    """
    for descriptor, word in words:
        with contextlib.suppress(OSError):
            os.write(descriptor, word)


def step_aside(groups: str = '/sys/fs/cgroup', own: str = '/proc/self/cgroup') -> bool:
    """Move this process into a control group beside the host's.

    An event that kills the host's whole group, such as a stopped service or the kernel out of
    memory, then spares this process. A user may move processes below a systemd user session, and
    root anywhere; elsewhere the process stays where it is.

    Parameters
    ----------
    groups : str
        Mount point of cgroup v2.
    own : str
        File that names the group of this process.

    Returns
    -------
    bool
        Whether the move was allowed.
    """
    with contextlib.suppress(OSError, StopIteration):
        with open(own, encoding='utf-8') as file:
            group = next(line[3:].strip() for line in file if line.startswith('0::'))
        if group == '/':
            return False
        aside = os.path.join(groups + os.path.dirname(group), ASIDE)
        os.makedirs(aside, exist_ok=True)
        with open(os.path.join(aside, 'cgroup.procs'), 'w', encoding='utf-8') as file:
            file.write(str(os.getpid()))
        return True
    return False


def main() -> None:
    """Run the sentinel; ignore a closed terminal, Ctrl-C and the stop of a service."""
    for number in (signal.SIGINT, signal.SIGHUP, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    step_aside()
    words = [(int(descriptor), bytes.fromhex(word)) for descriptor, word
             in (argument.split('=') for argument in sys.argv[2:])]
    watch(float(sys.argv[1]), words, sys.stdin.fileno())


if __name__ == '__main__':
    main()
