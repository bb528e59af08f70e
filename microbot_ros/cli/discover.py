"""`microbot discover`: find, name, add and prove the effect that the model is missing."""

from __future__ import annotations

from pathlib import Path

import click


@click.command()
@click.argument('sessions', metavar='SESSION...', nargs=-1, required=True,
                type=click.Path(path_type=Path))
@click.option('--out', type=click.Path(path_type=Path), required=True, metavar='DIR',
              help='Folder for result.json, model.yaml and report.html.')
@click.option('--jobs', type=click.IntRange(1), default=1, show_default=True, metavar='N',
              help='Processes that share the work.')
@click.option('--json', 'json_path', type=click.Path(path_type=Path),
              help='Also write the content of result.json here.')
def command(sessions: tuple[Path, ...], out: Path, jobs: int, json_path: Path | None) -> None:
    """Find where SESSION and the first-order model part, and name the effect that is missing.

    Several sessions of one rig are explained together. Writes result.json (verdict, effects with
    intervals and evidence, what is left), model.yaml (the model with the effects, for simulate,
    the model node and the controllers) and report.html.

    \b
    Example:
      microbot simulate config/scenario_lag.yaml --out out/lagging
      microbot discover out/lagging --out out/discovered
    """
    import json

    from rich.console import Console

    from microbot_ros.discovery.discover import discover
    from microbot_ros.discovery.report import write_report
    from microbot_ros.files import output_folder, write_text
    from microbot_ros.model.model_file import write_model
    from microbot_ros.session import read_session

    progress = Console(stderr=True, highlight=False)
    with progress.status('reading') as status:
        recordings = [read_session(path) for path in sessions]
        found = discover(recordings, status.update, jobs=jobs)
    text = json.dumps(found.as_json(), indent=1, ensure_ascii=False, allow_nan=False) + '\n'
    with output_folder(out) as folder:
        write_text(folder / 'result.json', text)
        write_model(folder / 'model.yaml', found.model, found.particles)
        with progress.status('writing the report'):
            write_report(folder, found, recordings, sessions)
    if json_path:
        write_text(json_path, text)
    console = Console(highlight=False)
    for line in found.sentences():
        console.print(line)
