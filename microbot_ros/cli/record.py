"""`microbot record`: begin and end a recording of a running rig."""

from __future__ import annotations

from pathlib import Path

import click


@click.command()
@click.option('--stop', is_flag=True, help='End the recording.')
@click.option('--title', default='', help='One line on what it is of.')
@click.option('--notes', default='', help='Whatever else is worth knowing.')
@click.option('--folder', type=click.Path(path_type=Path),
              help='Where to; otherwise ./recordings, named after the time.')
def command(stop: bool, title: str, notes: str, folder: Path | None) -> None:
    """Tell the recorder of a running rig to begin a recording, or with --stop to end it.

    For a recorder with the parameter recording: false; others record from the start, and can be
    told to stop and to begin another.

    \b
    Example:
      microbot record --title 'batch 7' --notes '5 % peroxide'
      microbot record --stop
    """
    from microbot_ros.nodes.remote import Remote

    with Remote() as remote:
        if not stop:
            remote.set('recorder', title=title, notes=notes,
                       folder=str(folder.resolve()) if folder else '')
        click.echo(remote.record(not stop))
