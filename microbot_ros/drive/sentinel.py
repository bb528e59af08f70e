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


def main() -> None:
    """Outlive what ends the host: a closed terminal, Ctrl-C."""
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    words = [(int(descriptor), bytes.fromhex(word)) for descriptor, word
             in (argument.split('=') for argument in sys.argv[2:])]
    watch(float(sys.argv[1]), words, sys.stdin.fileno())


if __name__ == '__main__':
    main()
