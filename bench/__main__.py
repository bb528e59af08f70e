"""`make bench`: run every group, print a table, write `out/bench.json`."""

from __future__ import annotations

import argparse
import dataclasses
import importlib
import json
import math
import pkgutil
import sys
from pathlib import Path

from rich.console import Console
from rich.table import Table

import bench
from bench.figure import Figure
from microbot_ros.files import write_text

GROUPS = sorted(
    module.name for module in pkgutil.iter_modules(bench.__path__)
    if module.name not in ('figure', '__main__') and not module.name.startswith('_')
)


def main() -> int:
    """Run the chosen groups; exit 1 if any figure missed its target."""
    parser = argparse.ArgumentParser(prog='make bench', description=__doc__)
    parser.add_argument('--only', choices=GROUPS, help='run one group')
    chosen = parser.parse_args().only
    figures: list[Figure] = []
    for group in [chosen] if chosen else GROUPS:
        print(f'bench: {group} …', file=sys.stderr, flush=True)
        figures += importlib.import_module(f'bench.{group}').figures()
    table = Table('issue', 'figure', 'value', 'unit', 'target', 'peer', '')
    for figure in figures:
        table.add_row(
            str(figure.issue), figure.name, f'{figure.value:.4g}', figure.unit, figure.target,
            figure.peer, '[green]ok[/]' if figure.ok else '[red]MISSED[/]',
        )
    Console(width=150 if not sys.stdout.isatty() else None).print(table)
    entries = [{**dataclasses.asdict(figure),
                'value': figure.value if math.isfinite(figure.value) else None}
               for figure in figures]
    # Figures may hold NumPy's own numbers and truth values.
    text = json.dumps(entries, indent=1, ensure_ascii=False, default=lambda value: value.item())
    write_text(Path('out/bench.json'), text + '\n')
    return 0 if all(figure.ok for figure in figures) else 1


if __name__ == '__main__':
    sys.exit(main())
