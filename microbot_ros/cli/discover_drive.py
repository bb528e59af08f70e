"""`microbot discover --drive`: beside a running, armed rig, until the question is settled."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console

    from microbot_ros.discovery.driven.drive import Driven
    from microbot_ros.nodes.graph_client import GraphClient
    from microbot_ros.records import Session


def drive_rig(out: Path, minutes: float, use: bool, json_path: Path | None,
              progress: Console) -> None:
    """Drive the rig of the graph for so many `minutes` at most, and write into `out` what came.

    The experiments lie in it as sessions, each as soon as it is over. With `use` the model found
    is given to the rig. RigError where the rig can't be driven, and where nothing was learned.
    """
    from microbot_ros.discovery.driven.drive import drive
    from microbot_ros.ending import Ending
    from microbot_ros.nodes.driven_rig import DrivenRig
    from microbot_ros.nodes.graph_client import GraphClient

    out = out.resolve()
    kept = _Kept(out)
    with GraphClient('discover') as client:
        with DrivenRig(client, kept) as rig, Ending(rig.tell_to_end):
            driven = drive(rig, minutes, lambda line: progress.print(line, soft_wrap=True))
        file = _write(driven, kept.folders, out, json_path, progress)
        if use and file is not None:
            _give(client, file, progress)


class _Kept:
    """Writes every experiment into the folder `out`, numbered."""

    def __init__(self, out: Path) -> None:
        self._out = out
        self.folders: list[Path] = []

    def __call__(self, session: Session) -> None:
        from microbot_ros.session import write_session

        folder = self._out / f'experiment-{len(self.folders) + 1}'
        write_session(folder, session)
        self.folders.append(folder)


def _write(driven: Driven, folders: list[Path], out: Path, json_path: Path | None,
           progress: Console) -> Path | None:
    """Write what was found, say it, and return the file of a model that is more than the first.
    """
    from rich.console import Console

    from microbot_ros.discovery.driven.conclusion import as_json, discovered
    from microbot_ros.discovery.driven.page import section
    from microbot_ros.discovery.report import write_report
    from microbot_ros.errors import RigError
    from microbot_ros.files import output_folder, write_text
    from microbot_ros.model.model_file import write_model

    with progress.status('looking at all of it') as status:
        result = discovered(driven, status.update)
    found = {} if result is None else result[0].as_json()
    text = json.dumps(found | as_json(driven), indent=1, ensure_ascii=False,
                      allow_nan=False) + '\n'
    with output_folder(out) as folder:
        write_text(folder / 'result.json', text)
        if result is not None:
            write_model(folder / 'model.yaml', result[0].model, result[0].particles)
            write_report(folder, result[0], [result[1]], folders, section(driven))
    if json_path:
        write_text(json_path, text)
    if result is None:
        raise RigError(driven.reason or 'too little was seen to learn anything')
    console = Console(highlight=False)
    for line in result[0].sentences():
        console.print(line)
    console.print(f'{driven.decided.replace("_", " ")} after {driven.seconds / 60:.1f} min'
                  + (f': {driven.reason}' if driven.reason else ''))
    return out / 'model.yaml' if result[0].model.effects else None


def _give(client: GraphClient, file: Path, progress: Console) -> None:
    """Give the model in a `file` to the nodes that use one."""
    for node in ('model', 'controller'):
        client.set(node, model_file=str(file))
        progress.print(f'{node} uses {file}', soft_wrap=True)
