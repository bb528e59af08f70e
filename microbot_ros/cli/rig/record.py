"""Command `microbot record`: begin and end a recording of a running rig."""

from __future__ import annotations

from pathlib import Path

import click

from microbot_ros.cli.options import PATH, namespace_option


@click.command()
@click.option('--stop', is_flag=True, help='End the recording.')
@click.option('--title', default='', help='Title of the recording, one line.')
@click.option('--notes', default='', help='Further notes.')
@click.option('--folder', type=PATH,
              help='Folder of the recording; default: ./recordings, named by the time.')
@namespace_option
def command(stop: bool, title: str, notes: str, folder: Path | None, namespace: str) -> None:
    """Begin a recording with the recorder of a running rig, or end it with --stop.

    It is for a recorder with the parameter recording: false; others record from the start, and can
    be stopped and started again. Ends with 1 and the reason if the recorder is missing, does not
    answer or refuses.

    \b
    Example:
      microbot record --title 'batch 7' --notes '5 % peroxide'
      microbot record --stop
    """
    from microbot_ros.nodes.client.graph_client import GraphClient

    if stop and (title or notes or folder):
        raise click.UsageError('expected --title, --notes and --folder without --stop: set them '
                               'before, by microbot set recorder title')
    with GraphClient(namespace=namespace) as client:
        if not stop:
            client.set('recorder', title=title, notes=notes,
                       folder=str(folder.resolve()) if folder else '')
        click.echo(client.record(not stop))
