"""Command `microbot discover --drive`: drive a running, armed rig to settle the question."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console

    from microbot_ros.common.records import Session
    from microbot_ros.discovery.driven.drive import Driven
    from microbot_ros.discovery.result import Discovery
    from microbot_ros.nodes.client.graph_client import GraphClient

FILES = ('result.json', 'model.yaml', 'report.html')
"""Files of every result."""

CONTROLLER, APPROACH, JUDGED = 'waypoint', 6.0, 10.0
"""Controller that holds a particle to evaluate a model; times [s] to reach the place, and of the
evaluation. Choice: half is noisier, twice keeps the rig for longer."""


def drive_rig(out: Path, minutes: float, use: bool, json_path: Path | None,
              progress: Console, namespace: str) -> None:
    """Drive a rig and write the results.

    The folder also contains the experiments as sessions, each as soon as it is over.

    Parameters
    ----------
    out : Path
        Folder of the results.
    minutes : float
        Longest duration [min].
    use : bool
        Whether the rig receives the model that is found.
    json_path : Path or None
        Another file for the content of result.json; None for none.
    progress : Console
        Console for progress.
    namespace : str
        Namespace of the rig.

    Raises
    ------
    RigError
        If the rig cannot be driven, or if nothing was learned.
    """
    from microbot_ros.common.ending import Ending, find_launcher
    from microbot_ros.common.errors import ReportError
    from microbot_ros.discovery.driven.drive import drive
    from microbot_ros.nodes.client.driven_rig import DrivenRig
    from microbot_ros.nodes.client.graph_client import GraphClient
    from microbot_ros.session import write_session

    out, folders = out.resolve(), list[Path]()

    def keep(experiment: Session) -> None:
        folders.append(out / f'experiment-{len(folders) + 1}')
        write_session(folders[-1], experiment)

    with GraphClient('discover', namespace) as client:
        with DrivenRig(client, keep) as rig, Ending(rig.tell_to_end, find_launcher()):
            driven = drive(rig, minutes, lambda line: progress.print(line, soft_wrap=True),
                           looked=lambda look: _show_odds(look.odds, out, progress))
        found = _write(driven, out, json_path, progress)
        use = use and bool(found.model.effects) and driven.decided == 'settled'
        try:
            _report(out, driven, found, folders)
        except ReportError:
            if not use:
                raise
        if use:
            told = _give(client, out / 'model.yaml', progress)
            _report(out, driven, found, folders, told)


def _show_odds(odds: Mapping[str, float], out: Path, progress: Console) -> None:
    """Write probabilities by effect ('' for none) into `out`; print four on a terminal."""
    from microbot_ros.common.files import write_json

    write_json(out / 'progress.json', {'odds': odds})
    if progress.is_terminal and odds:
        ranked = sorted(odds.items(), key=lambda one: -one[1])[:4]
        progress.print('likeliest: ' + ', '.join(
            f'{name.replace("_", " ") or "nothing"} {share:.1%}' for name, share in ranked))


def _write(driven: Driven, out: Path, json_path: Path | None, progress: Console) -> Discovery:
    """Write result and model into `out`, print the result and return it."""
    from rich.console import Console

    from microbot_ros.common.errors import RigError
    from microbot_ros.common.files import output_folder, write_json
    from microbot_ros.discovery.driven.conclusion import as_json, discovered
    from microbot_ros.model.io.model_file import write_model

    with progress.status('analysing all experiments') as status:
        result = discovered(driven, status.update)
    found = {} if result is None else result[0].as_json()
    content = found | as_json(driven)
    with output_folder(out, FILES) as folder:
        write_json(folder / 'result.json', content)
        if result is not None:
            write_model(folder / 'model.yaml', result[0].model, result[0].particles)
    write_json(json_path, content)
    if result is None:
        raise RigError(driven.reason or 'too little data to learn anything')
    console = Console(highlight=False, markup=False)
    for line in result[0].sentences():
        console.print(line, soft_wrap=True)
    console.print(f'{driven.decided.replace("_", " ")} after {driven.seconds / 60:.1f} min'
                  + (f': {driven.reason}' if driven.reason else ''), soft_wrap=True)
    return result[0]


def _report(out: Path, driven: Driven, found: Discovery, folders: list[Path],
            used: str = '') -> None:
    """Write the report into `out`, beside the results; ReportError if that fails."""
    from microbot_ros.common.files import writing_report

    with writing_report(out / 'report.html'):
        from microbot_ros.discovery.driven.joined import join
        from microbot_ros.discovery.driven.page import section
        from microbot_ros.discovery.report.page import write_report

        write_report(out, found, [join(driven.experiments)], folders, section(driven), used)


def _give(client: GraphClient, file: Path, progress: Console) -> str:
    """Load a model into the nodes that use one; return the improvement as HTML."""
    errors = []
    for model in ('', str(file)):
        for node in ('model', 'controller'):
            client.set(node, model_file=model)
        with progress.status('testing the model: holding a particle at a place'):
            errors.append(_tracking_error(client))
    said = (f'{CONTROLLER} held a particle at {errors[0] * 1e6:.1f} µm from its place with the '
            f'first-order model, at {errors[1] * 1e6:.1f} µm with the model found')
    progress.print(f'model and controllers use {file}; {said}', soft_wrap=True)
    return f'<h2>What the model improves in control</h2><p>{said[0].upper() + said[1:]}.</p>'


def _tracking_error(client: GraphClient) -> float:
    """Return the mean distance [m] of a particle from its place; NaN if it was not seen."""
    import numpy as np

    heard: list[np.ndarray] = []
    client.watch_estimates(heard.append)
    if not client.until(lambda: heard and np.isfinite(heard[-1]['speed_std']).any(), APPROACH):
        return float('nan')
    # The particle nearest to the centre has most room.
    first = heard[-1][np.argmin(np.hypot(heard[-1]['x'], heard[-1]['y']))].copy()
    goal = np.array([first['x'], first['y']], float)
    client.set('controller', controller=CONTROLLER)
    try:
        client.send_goals([(float(goal[0]), float(goal[1]))], [int(first['id'])])
        client.spin(APPROACH)
        heard.clear()
        client.spin(JUDGED)
    finally:
        client.set('controller', controller='hold')
    places = np.array([(p['x'], p['y']) for frame in heard for p in frame
                       if p['id'] == first['id']], float)
    return float(np.hypot(*(places - goal).T).mean()) if len(places) else float('nan')
