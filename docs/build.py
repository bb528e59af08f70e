"""Writes the pages that are made from the code: `python docs/build.py`."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

DOCS = Path(__file__).parent
sys.path.insert(0, str(DOCS))

from made import commands, effects, faults, graph, parameters, results  # noqa: E402

PAGES: dict[str, Callable[[], str]] = {
    'how-to/when_something_trips.md': faults.page,
    'reference/commands.md': commands.page,
    'reference/effects.md': effects.page,
    'reference/graph.md': graph.page,
    'reference/parameters.md': parameters.page,
    'reference/results.md': results.page,
}
"""Page → what makes its text."""

if __name__ == '__main__':
    for name, make in PAGES.items():
        (DOCS / name).write_text(make(), encoding='utf-8')
