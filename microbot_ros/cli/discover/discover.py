"""Command `microbot discover`: find, name, add and verify the effect that the model lacks."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click
from click.core import ParameterSource

from microbot_ros.cli.discover.drive import FILES, drive_rig
from microbot_ros.cli.options import (
    NEW_FOLDER,
    PATH,
    FiniteFloatRange,
    force_option,
    json_option,
    namespace_option,
)
from microbot_ros.common.compiled import tell_of_compiling

if TYPE_CHECKING:
    from rich.console import Console

    from microbot_ros.common.records import Session
    from microbot_ros.discovery.result import Discovery
    from microbot_ros.nodes.client.graph_client import GraphClient
    from microbot_ros.nodes.client.live_session_buffer import LiveSessionBuffer


@click.command()
@click.argument('sessions', metavar='SESSION...', nargs=-1,
                type=PATH)
@click.option('--out', type=NEW_FOLDER, required=True, metavar='DIR',
              help='Folder for result.json, model.yaml and report.html; with --live, of the '
              'folders look-1, look-2, ... that hold them.')
@click.option('--jobs', type=click.IntRange(1), default=1, show_default=True, metavar='N',
              help='Number of processes.')
@click.option('--live', is_flag=True,
              help='In place of sessions: analyse the running graph, or a replay, and propose '
                   'experiments.')
@click.option('--seconds', type=FiniteFloatRange(10, 3600), default=60.0, show_default=True,
              help='With --live: duration of the recent past that each analysis covers.')
@click.option('--rounds', type=click.IntRange(0), default=0, metavar='N',
              help='With --live: end after N analyses; 0 continues until Ctrl-C.')
@click.option('--drive', is_flag=True,
              help='In place of sessions: drive the running, armed rig through the most '
                   'informative experiments, until the question is settled.')
@click.option('--minutes', type=FiniteFloatRange(0.5, 600), default=10.0, show_default=True,
              help='With --drive: time limit.')
@click.option('--apply', 'apply_', is_flag=True,
              help='With --drive: load the model found into the model node and the controllers.')
@force_option
@json_option('Write the content of result.json to this file too.')
@namespace_option
def command(sessions: tuple[Path, ...], out: Path, jobs: int, live: bool, seconds: float,
            rounds: int, drive: bool, minutes: float, apply_: bool, force: bool,
            json_path: Path | None, namespace: str) -> None:
    """Find where SESSION and the first-order model differ, and name the missing effect.

    Several sessions of one rig are explained together. Writes result.json (verdict, effects with
    intervals and evidence, remaining discrepancy), model.yaml (the model with the effects, for
    simulate, the model node and the controllers) and report.html.

    \b
    Example:
      microbot simulate config/scenario_lag.yaml --out out/lagging
      microbot discover out/lagging --out out/discovered
      microbot discover --live --seconds 60 --out out/live
      microbot discover --drive --minutes 6 --out out/driven
    """
    from rich.console import Console

    from microbot_ros.common.files import refuse_to_overwrite
    from microbot_ros.session import read_session

    if bool(sessions) + live + drive != 1:
        raise click.UsageError('expected one of: SESSION..., --live, --drive')
    if apply_ and not drive:
        raise click.UsageError('expected --apply only with --drive')
    given = click.get_current_context().get_parameter_source
    for name, mode, on in (('seconds', '--live', live), ('rounds', '--live', live),
                           ('minutes', '--drive', drive),
                           ('jobs', 'SESSION or --live', not drive),
                           ('namespace', '--live or --drive', live or drive)):
        if not on and given(name) is ParameterSource.COMMANDLINE:
            raise click.UsageError(f'expected --{name} only with {mode}')
    refuse_to_overwrite(out, (*FILES, 'look-*', 'experiment-*'), force)
    progress = Console(stderr=True, highlight=False, markup=False)
    if live:
        _watch(out, seconds, rounds, jobs, json_path, progress, namespace)
        return
    if drive:
        tell_of_compiling(partial(progress.print, soft_wrap=True))
        drive_rig(out, minutes, apply_, json_path, progress, namespace)
        return
    with progress.status('reading'):
        recordings = [read_session(path) for path in sessions]
    found = _discover(recordings, out, jobs, json_path, progress)
    _report(out, found, recordings, sessions, progress)


def _discover(recordings: Sequence[Session], out: Path, jobs: int, json_path: Path | None,
              progress: Console) -> Discovery:
    """Search recordings; write result and model into `out`, print and return them."""
    from rich.console import Console

    from microbot_ros.common.files import output_folder, write_json
    from microbot_ros.discovery.discover import discover
    from microbot_ros.model.io.model_file import write_model

    progress.print('looking')
    tell_of_compiling(partial(progress.print, soft_wrap=True))
    with progress.status('looking') as status:
        found = discover(recordings, status.update, jobs=jobs)
    content = found.as_json()
    with output_folder(out, FILES) as folder:
        write_json(folder / 'result.json', content)
        write_model(folder / 'model.yaml', found.model, found.particles)
    write_json(json_path, content)
    console = Console(highlight=False, markup=False)
    for line in found.sentences():
        console.print(line)
    return found


def _report(out: Path, found: Discovery, recordings: Sequence[Session], sources: Sequence[Path],
            progress: Console) -> None:
    """Write the report into `out`, beside the results; ReportError if that fails."""
    from microbot_ros.common.files import writing_report

    with progress.status('writing the report'), writing_report(out / 'report.html'):
        from microbot_ros.discovery.report.page import write_report

        write_report(out, found, recordings, sources)


def _watch(out: Path, seconds: float, rounds: int, jobs: int, json_path: Path | None,
           progress: Console, namespace: str) -> None:
    """Analyse the recent past of the graph repeatedly, each time into a new folder.

    A node that uses the model of one analysis keeps it while the next is written. Each analysis
    uses the data received after the one before, however long that took.
    """
    import time
    from itertools import count

    from microbot_ros.common.errors import InputError, ReportError
    from microbot_ros.common.files import output_folder
    from microbot_ros.nodes.client.graph_client import GraphClient
    from microbot_ros.nodes.client.live_session_buffer import LiveSessionBuffer
    from microbot_ros.nodes.client.verdict_publisher import VerdictPublisher
    from microbot_ros.session import write_session

    with GraphClient('discover', namespace) as client:
        recent, verdict = LiveSessionBuffer(client, seconds), VerdictPublisher(client)
        for look in count(1):
            session = _listen(client, recent, seconds, progress)
            began = time.monotonic()
            place = out.resolve() / f'look-{look}'
            with output_folder(place) as folder:
                write_session(folder / 'session', session)
            try:
                found = _discover([session], place, jobs, json_path, progress)
                verdict.publish(found.as_json())
                if found.model.effects:
                    _propose(
                        place / 'model.yaml', found.model.time_invariant, namespace, progress)
                _report(place, found, [session], [place / 'session'], progress)
            except (InputError, ReportError) as error:
                if look == rounds:
                    raise
                progress.print(f'no result yet: {error}'
                               if isinstance(error, InputError) else f'! {error}')
            if look == rounds:
                return
            if (took := time.monotonic() - began) > seconds:
                progress.print(f'! analysis {look} took {took:.0f} s, longer than its '
                               f'{seconds:g} s of data: data received meanwhile are left out')
            recent.forget()


def _propose(file: Path, time_invariant: bool, namespace: str, progress: Console) -> None:
    """Print how a running graph can use the model."""
    where = '' if namespace == '/' else f' --namespace {namespace}'
    for node in ('model', 'controller'):
        progress.print(f'to use it: microbot set {node} model_file {file}{where}',
                       soft_wrap=True)
    if not time_invariant:
        progress.print('! The model has an effect that depends on time since the start: here '
                       "since the first frame received, in a node since the node's start.")


def _listen(client: GraphClient, recent: LiveSessionBuffer, seconds: float,
            progress: Console) -> Session:
    """Return the data of the graph of a client, or of a replay, over a time."""
    with progress.status('no particles yet: is a rig running, or a replay?') as status:
        while recent.span < seconds - 0.5:
            client.spin(0.5)
            if recent.span:
                status.update(f'listening: {recent.span:.0f} of {seconds:g} s')
        return recent.session()
