"""Time and size of an installation by pip: `python test/install.py`, or `make sizes`.

Installs the package with no extra, with `ros` and with `ros,all`, each into a new environment from
wheels as constraints.txt pins them, and prints seconds, megabytes and packages, and the largest
packages of each.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import tempfile
import time
import venv
from collections import Counter
from importlib.metadata import distributions
from pathlib import Path

ROOT = Path(__file__).parents[1]
EXTRAS = ('', '[ros]', '[ros,all]')
_LARGEST = 8
"""Choice: packages that are named; the others of the core are below 5 MB each."""


def sizes(folder: Path) -> Counter[str]:
    """Return the size [bytes] of the files of each package in the environment `folder`."""
    [site] = folder.glob('lib/python*/site-packages')
    return Counter({one.name: sum(Path(one.locate_file(file)).stat().st_size
                                  for file in one.files or ()
                                  if Path(one.locate_file(file)).is_file())
                    for one in distributions(path=[str(site)])})


def processor_time() -> float:
    """Return the processor time [s] of all ended children."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def install(folder: Path, extras: str) -> tuple[float, float, Counter[str]]:
    """Install the package with `extras`; time, processor time [s] and sizes [bytes]."""
    venv.create(folder, with_pip=True)
    before = sizes(folder)
    begin, used = time.perf_counter(), processor_time()
    subprocess.run([folder / 'bin' / 'pip', 'install', '--quiet', '--disable-pip-version-check',
                    '--constraint', ROOT / 'constraints.txt', f'{ROOT}{extras}'], check=True)
    return (time.perf_counter() - begin, processor_time() - used, sizes(folder) - before)


def main() -> None:
    """Print a line for each installation."""
    for extras in EXTRAS:
        with tempfile.TemporaryDirectory() as folder:
            seconds, processor, found = install(Path(folder), extras)
        largest = ', '.join(f'{name} {size / 1e6:.0f}'
                            for name, size in found.most_common(_LARGEST))
        print(f'microbot_ros{extras}: {seconds:.0f} s ({processor:.0f} of the processor), '
              f'{found.total() / 1e6:.0f} MB, '
              f'{len(found)} packages; {largest}', flush=True)


if __name__ == '__main__':
    sys.exit(main())
