"""Command `microbot paper`: the paper's experiment, tables and figures beside its own numbers."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from microbot_ros.cli.options import NEW_FOLDER, force_option, json_option

if TYPE_CHECKING:
    from rich.console import Console


@click.command()
@click.option('--out', type=NEW_FOLDER, required=True, metavar='DIR',
              help='Folder for report.html, summary.json and the figures.')
@click.option('--repetitions', type=click.IntRange(min=1), default=20, show_default=True,
              help='Number of repetitions of the experiment, each with its own legs and random '
                   'numbers.')
@click.option('--seed', type=click.IntRange(min=0), default=1, show_default=True,
              help='Seed of the first repetition; the others use the following seeds.')
@force_option
@json_option('Write the summary as JSON to this file.')
def command(out: Path, repetitions: int, seed: int, force: bool,
            json_path: Path | None) -> None:
    """Repeat the paper's three-particle experiment in simulation and compare.

    The paper's recording is not available, so the rig is this project's Langevin simulation. Both
    approaches (each particle's own force, the mean of the three) and both solvers (first-order,
    Newton-Stokes) are compared with it, beside the numbers that the paper prints.

    \b
    Example:
      microbot paper --out out/paper --repetitions 50
    """
    from rich.console import Console
    from rich.progress import track

    from microbot_ros.common.files import (
        output_folder,
        refuse_to_overwrite,
        write_json,
        write_text,
    )
    from microbot_ros.paper.repetition import attempt, run_times
    from microbot_ros.paper.report import draw_errors, draw_trajectories, page, png
    from microbot_ros.paper.summary import summarise

    outputs = ('report.html', 'summary.json', 'trajectories.png', 'errors.png')
    refuse_to_overwrite(out, outputs, force)
    progress = Console(stderr=True, markup=False)
    seeds = range(seed, seed + repetitions)
    with output_folder(out) as folder:
        trials = [attempt(s) for s in track(seeds, 'repeating the experiment', console=progress)]
        summary = summarise(trials, run_times(trials[0]))
        trajectories, errors = png(draw_trajectories(trials[0])), png(draw_errors(trials))
        write_json(folder / 'summary.json', summary)
        write_text(folder / 'report.html', page(summary, trajectories, errors))
        (folder / 'trajectories.png').write_bytes(trajectories)
        (folder / 'errors.png').write_bytes(errors)
    write_json(json_path, summary)
    _show(Console(highlight=False, markup=False), summary)
    progress.print(f'report: {out / "report.html"}')


def _show(console: Console, summary: dict[str, Any]) -> None:
    """Print the two tables."""
    from rich.table import Table

    console.print('A simulation of the experiment; the paper measured real particles.')
    table = Table('RMSE (µm)', 'particle 1', 'particle 2', 'particle 3', box=None)
    for approach, printed in summary['rmse_printed_um'].items():
        here = summary['rmse_um']['first_order'][approach]['particles']
        table.add_row(f'{approach} F, here', *(f'{value:.2f}' for value in here))
        table.add_row(f'{approach} F, paper', *(f'{value:.2f}' for value in printed))
    console.print(table)
    table = Table('run time', 'here (ms)', 'paper (ms)', box=None)
    for solver, seconds in summary['run_time_s'].items():
        printed = summary['run_time_printed_s'].get(solver)
        table.add_row(solver, f'{seconds * 1e3:.2f}', f'{printed * 1e3:.0f}' if printed else '–')
    console.print(table)
