"""`microbot replay`: a recording through topics."""

from __future__ import annotations

import sys

import click


@click.command()
@click.argument('session')
@click.option('--rate', default=1.0, show_default=True,
              help='Times real time; 0 is as fast as it goes.')
@click.option('--start', default=0.0, show_default=True, help='Where to begin [s].')
@click.option('--loop', is_flag=True, help='Begin again at the end.')
@click.option('--topic', 'topics', multiple=True,
              help='Play only this topic; may be given several times.')
def command(session: str, rate: float, start: float, loop: bool, topics: tuple[str, ...]) -> None:
    """Play SESSION, a folder or an MCAP recording, through its topics, with /clock.

    Nodes that are to follow its time run with use_sim_time. Ctrl-C ends it.

    \b
    Example, recorded tracks through today's model at ten times the speed:
      microbot replay out/demo/recording --rate 10 --topic particles --topic field/applied
    """
    from microbot_ros.nodes.process import run

    parameters = {'session': session, 'rate': float(rate), 'start_s': float(start), 'loop': loop}
    arguments = ['--ros-args']
    for name, value in parameters.items():
        text = str(value).lower() if isinstance(value, bool) else str(value)
        arguments += ['-p', f'{name}:={text}']
    if topics:
        arguments += ['-p', f'topics:=[{",".join(topics)}]']
    sys.exit(run(['player'], arguments))
