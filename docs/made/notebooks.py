"""Pages of the notebooks: scripts in cells, executed, with what they print and draw."""

from __future__ import annotations

import io
import re
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

from made.text import MADE

FOLDER = Path(__file__).parents[1] / 'tutorial' / 'notebooks'
NAMES = ('steer', 'fit', 'discover', 'effect', 'archive')
_CELL = re.compile(r'^# %%(.*)\n', re.MULTILINE)
_DPI = 110  # choice: a figure of 5 inches is 550 px wide


def cells(name: str) -> list[tuple[bool, str]]:
    """Return (is text, content) of each cell of a notebook, text without the signs of comments."""
    _, *parts = _CELL.split((FOLDER / f'{name}.py').read_text(encoding='utf-8'))
    return [(True, re.sub(r'^# ?', '', content, flags=re.MULTILINE).strip()) if 'markdown' in kind
            else (False, content.strip())
            for kind, content in zip(parts[::2], parts[1::2], strict=True)]


def page(name: str) -> str:
    """Execute a notebook; return its page, and write its figures beside it."""
    import matplotlib as mpl
    import matplotlib.pyplot as plt

    mpl.use('agg')
    names: dict[str, Any] = {'__name__': name}
    parts: list[str] = []
    figures = 0
    for is_text, content in cells(name):
        if is_text:
            parts.append(content)
            continue
        printed = io.StringIO()
        with redirect_stdout(printed):
            exec(compile(content, f'{name}.py', 'exec', dont_inherit=True), names)  # our own file
        parts.append(f'```python\n{content}\n```')
        if printed.getvalue():
            parts.append(f'```text\n{printed.getvalue().rstrip()}\n```')
        for number in plt.get_fignums():
            figures += 1
            file = FOLDER / f'{name}_{figures}.png'
            plt.figure(number).savefig(file, dpi=_DPI, metadata={'Software': None})
            parts.append(f'![Figure {figures} of this page]({file.name})')
            plt.close(number)
    parts.insert(1, f'{MADE} Its script is [`{name}.py`]({name}.py): open it in an editor that '
                    'runs cells (VS Code, Spyder, PyCharm), or in Jupyter with Jupytext.')
    return '\n\n'.join(parts) + '\n'
