"""Run a command again and again on a machine that is overloaded, and count how often it fails.

`python -m bench._burn 5 -- python -m pytest test/smoke`: beside three processes that burn all
processors, with a SIGSTOP of 0.3 s to a random process of the command's tree every 10 s.
"""

from __future__ import annotations

import multiprocessing
import random
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import suppress

import psutil

BURNERS, PAUSE_S, EVERY_S = 3, 0.3, 10.0


def _burn() -> None:
    while True:
        pass


def _pause_one(root: int, rng: random.Random) -> None:
    """Stop a random process of the tree, and let it go on."""
    with suppress(psutil.NoSuchProcess):
        process = psutil.Process(root)
        victim = rng.choice([process, *process.children(recursive=True)])
        victim.send_signal(signal.SIGSTOP)
        try:
            time.sleep(PAUSE_S)
        finally:
            victim.send_signal(signal.SIGCONT)


def run(command: Sequence[str], rng: random.Random) -> tuple[int, str]:
    """Run the command once; return its exit status and the end of what it said."""
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                          text=True) as process:
        over = threading.Event()
        pauses = threading.Thread(target=_pause_until, args=[over, process.pid, rng], daemon=True)
        pauses.start()
        said, _ = process.communicate()
        over.set()
        pauses.join()
    return process.returncode, said[-4000:]


def _pause_until(over: threading.Event, root: int, rng: random.Random) -> None:
    while not over.wait(EVERY_S):
        _pause_one(root, rng)


def main(words: Sequence[str]) -> int:
    """Run the command of `words` N times; return the number of runs that failed."""
    times, command = int(words[0]), words[2:]
    burners = [multiprocessing.Process(target=_burn, daemon=True) for _ in range(BURNERS)]
    for burner in burners:
        burner.start()
    red = 0
    for number in range(times):
        begun = time.monotonic()
        status, said = run(command, random.Random(number))
        red += status != 0
        print(f'run {number + 1} of {times}: {"red" if status else "green"}, '
              f'{time.monotonic() - begun:.0f} s', flush=True)
        if status:
            print(said, flush=True)
    print(f'{red} of {times} runs red')
    return red


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]) > 0)
