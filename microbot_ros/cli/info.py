"""Command `microbot info`: content of a session."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from microbot_ros.cli.options import NEW_FILE, PATH, json_option
from microbot_ros.common.errors import InputError
from microbot_ros.common.files import write_json

if TYPE_CHECKING:
    from rich.console import Console

    from microbot_ros.session.survey import Survey


@click.command()
@click.argument('session', type=PATH)
@json_option('Write the summary as JSON to this file.')
@click.option('--figure', type=NEW_FILE,
              help='Draw paths, commands and topics over time to this file.')
@click.option('--repair', is_flag=True,
              help='Write the missing index and metadata of a recording that was cut off.')
def command(session: Path, json_path: Path | None, figure: Path | None, repair: bool) -> None:
    """Show the content of SESSION, a folder of CSV files or a recording.

    It lists topics with their rates and gaps, missing frames, the latency from exposure to the
    amplifier's acknowledgement, and the properties of the particles that the commands can
    determine. A recording that was cut off is read as far as possible.

    \b
    Examples:
      microbot info out/demo/recording
      microbot info out/crashed --repair
      microbot info data/rolling_robot --figure rolling.png --json rolling.json
    """
    from rich.console import Console
    from rich.markup import escape

    from microbot_ros.estimation.likelihood.excitation import command_excitation
    from microbot_ros.session.mcap.recording import Recording, is_recording
    from microbot_ros.session.survey import survey_folder, survey_recording

    if not session.exists():
        raise InputError(session, 'expected a session folder or a recording, found nothing')
    console = Console(highlight=False, markup=False, width=None if sys.stdout.isatty() else 150)
    with console.status(escape(f'reading {session}')):
        if is_recording(session):
            with Recording(session) as recording:
                if repair and not recording.complete:
                    recording.repair()
                    console.print(f'{session}: wrote the index and the metadata')
                found, content = survey_recording(recording)
        elif repair:
            raise InputError(session, 'expected a recording to repair, found a folder')
        else:
            found, content = survey_folder(session)
    if excited := command_excitation(content) if content else None:
        found = dataclasses.replace(found, remarks=(*found.remarks, *excited.sentences))
    _show(console, found)
    if figure:
        from microbot_ros.session.survey_figure import draw_survey

        draw_survey(found, content, figure)
    write_json(json_path, dataclasses.asdict(found))


def _show(console: Console, found: Survey) -> None:
    from rich.table import Table

    state = '' if found.complete else ', cut off'
    console.print(f'{found.path}: {found.kind}{state}, {found.duration_s:.1f} s')
    table = Table('topic', 'type', 'messages', 'Hz', 'gaps', 'longest (s)', box=None)
    for topic in found.topics:
        table.add_row(
            topic.name, topic.type.replace('/msg/', '/'), str(topic.count),
            f'{topic.rate_hz:.1f}', str(topic.gaps), f'{topic.longest_gap_s:.3f}')
    console.print(table)
    if found.frames is not None:
        console.print(
            f'{found.particles} particles in {found.frames} frames, '
            f'{found.frames_missing} frames missing')
    if found.dropped:
        lost = ', '.join(f'{count} of {name}' for name, count in found.dropped.items())
        console.print(f'dropped by the recorder: {lost}')
    if found.latency_ms:
        console.print(
            f'exposure to acknowledgement: p50 {found.latency_ms["p50"]:.1f} ms, '
            f'p99 {found.latency_ms["p99"]:.1f} ms')
    if found.excitation:
        spread = found.excitation
        levels = spread.frequencies_hz or spread.magnitudes_mT or (0.0,)
        unit = 'Hz' if spread.frequencies_hz else 'mT'
        extent = f'at {levels[0]:g}' if len(levels) == 1 else (
            f'at {len(levels)} levels from {levels[0]:g} to {levels[-1]:g}')
        console.print(
            f'{spread.rows} commands {extent} {unit}, {spread.turns_left} turns left and '
            f'{spread.turns_right} right, off {spread.off_share:.0%} of the time')
    for name, entries in found.metadata.items():
        pairs = ', '.join(f'{key} {value}' for key, value in entries.items() if value)
        if name != 'dropped' and pairs:
            console.print(f'{name}: {pairs}')
    if found.attachments:
        console.print(f'attached: {", ".join(found.attachments)}')
    for remark in found.remarks:
        console.print(remark)
