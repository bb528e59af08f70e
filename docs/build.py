"""Writes the pages that are made from the code: `python docs/build.py`.

`python docs/build.py --notebooks` also executes the notebooks, which takes a minute or two.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

DOCS = Path(__file__).parent
sys.path.insert(0, str(DOCS))

from made import (  # noqa: E402
    commands,
    effects,
    faults,
    graph,
    notebooks,
    parameters,
    results,
)

PAGES: dict[str, Callable[[], str]] = {
    'how-to/when_something_trips.md': faults.page,
    'reference/commands.md': commands.page,
    'reference/effects.md': effects.page,
    'reference/graph.md': graph.page,
    'reference/parameters.md': parameters.page,
    'reference/results.md': results.page,
}
"""Page → what makes its text."""

NOTEBOOKS: dict[str, Callable[[], str]] = {
    f'tutorial/notebooks/{name}.md': partial(notebooks.page, name) for name in notebooks.NAMES}
"""Page of a notebook → what executes it."""

if __name__ == '__main__':
    for page, make in (PAGES | (NOTEBOOKS if '--notebooks' in sys.argv else {})).items():
        (DOCS / page).write_text(make(), encoding='utf-8')
