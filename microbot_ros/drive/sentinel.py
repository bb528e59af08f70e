"""A process that zeroes the coils when the one that drives them dies or hangs.

For devices without a watchdog of their own. It holds the same lines, and is fed through its
standard input: a dot now and then while all is well, `q` at an orderly end. Where the dots stay
away it says the last words, which zero the coils, and again until they come back; where the feed
breaks off, for a while and then it ends. It is run as a script, by its path, and imports nothing
of the project, so that it is there within 20 ms and has nothing to fail on.

    python sentinel.py SILENCE_S DESCRIPTOR=HEX...
"""

import contextlib
import os
import select
import signal
import sys
import time

ASIDE = 'microbot_sentinels'
"""The control group that all sentinels of a slice share; it stays, empty, when they have ended."""
AGAIN_S = 0.02
"""Said again this often: what was under way on the line may damage the first."""
REPEATS = 10


def watch(silence_s: float, words: list[tuple[int, bytes]], feed: int) -> None:
    """Zero the coils after `silence_s` without a byte, until the feed ends; `words` are the lines'
    descriptors and what zeroes their coils.
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
        time.sleep(AGAIN_S)  # also the gap that ends what the host has left half said
        say(words)


def say(words: list[tuple[int, bytes]]) -> None:
    """Put the words on the lines; a line that is gone or takes nothing is left out."""
    for descriptor, word in words:
        with contextlib.suppress(OSError):
            os.write(descriptor, word)


def step_aside(groups: str = '/sys/fs/cgroup', own: str = '/proc/self/cgroup') -> bool:
    """Move this process into a control group beside the host's; return whether that was allowed.

    What kills the host's whole group, as a service manager or the kernel out of memory does, then
    leaves this process alone. A user may move processes below a systemd user session, and root
    anywhere; elsewhere the process stays where it is. `groups` is where cgroup v2 is mounted,
    `own` the file that names the group of this process.
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
    """Outlive what ends the host: a closed terminal, Ctrl-C, a service that is stopped."""
    for number in (signal.SIGINT, signal.SIGHUP, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    step_aside()
    words = [(int(descriptor), bytes.fromhex(word)) for descriptor, word
             in (argument.split('=') for argument in sys.argv[2:])]
    watch(float(sys.argv[1]), words, sys.stdin.fileno())


if __name__ == '__main__':
    main()
