"""What the pages have in common: Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

MADE = 'Made from the code by `python docs/build.py`.'
"""What a page that is made says of itself."""


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table with the columns of `head`; each of the `rows` has a text for each."""
    lines = ['| ' + ' | '.join(cell.replace('|', r'\|').replace('\n', ' ') for cell in row) + ' |'
             for row in (head, *rows)]
    return '\n'.join([lines[0], '|---' * len(head) + '|', *lines[1:]]) + '\n'


def code(text: str) -> str:
    """The `text` as code within a line."""
    return f'`{text}`'
