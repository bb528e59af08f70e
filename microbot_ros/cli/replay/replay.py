"""Command `microbot replay`: a recording on its topics, or through the present nodes."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path

import click

from microbot_ros.cli.options import NEW_FILE, PATH, FiniteFloatRange, json_option
from microbot_ros.common.errors import InputError


@click.command()
@click.argument('session', type=PATH)
@click.option('--rate', default=1.0, show_default=True,
              help='Speed relative to real time; 0: as fast as possible.')
@click.option('--start', default=0.0, show_default=True, help='Start of the playback [s].')
@click.option('--end', default=0.0, help='End of the playback [s]; 0 plays to the end.')
@click.option('--loop', is_flag=True, help='Begin again at the end.')
@click.option('--topic', 'topics', multiple=True,
              help='Play only this topic; may be given several times.')
@click.option('--into-live-rig', is_flag=True,
              help='Play even if nodes of a rig are live: recorded goals and commands then drive '
                   'it.')
@click.option('--film', type=NEW_FILE, metavar='FILE',
              help='Draw the recording as an MP4 film, in place of playing it; - is standard '
                   'output.')
@click.option('--check', is_flag=True,
              help="Run the recording through today's nodes, and compare with the recorded "
                   'outputs.')
@click.option('--node', 'nodes', multiple=True,
              type=click.Choice(['tracker', 'model', 'controller', 'coil_driver']),
              help='With --check: only this node; may be given several times.')
@click.option('--tolerance', type=FiniteFloatRange(0, 1), default=0.0, show_default=True,
              help='With --check: largest allowed difference, relative to the largest value of '
                   'the field. Another processor may round differently.')
@click.option('--config', type=PATH,
              help='With --check: parameters in place of those in the recording.')
@click.option('--policy', type=PATH,
              help='With --check: the ONNX network of the controller policy; a network named in a '
                   'recording is not executed.')
@click.option('--out', type=PATH,
              help="With --check: write the nodes' outputs as a recording.")
@json_option('With --check: write the differences as JSON to this file.')
def command(
    session: Path, rate: float, start: float, end: float, loop: bool, topics: tuple[str, ...],
    into_live_rig: bool, film: Path | None, check: bool, nodes: tuple[str, ...], tolerance: float,
    config: Path | None, policy: Path | None, out: Path | None, json_path: Path | None,
) -> None:
    """Play SESSION, a folder or an MCAP recording, on its topics, with /clock.

    It begins when all listeners are found, and after 3.5 s in any case. Run nodes that must follow
    its time with use_sim_time. Beside a node that does not, a live rig, it is refused, and stopped
    if such a node appears later, unless --into-live-rig allows it. Ctrl-C ends it. While it plays,
    `microbot set player rate 5` and `seek_s 12.5` change speed and position; the service
    player/pause holds it and player/step advances it by one message.

    With --check nothing is published. Each node whose input was recorded is run with its recorded
    parameters on its recorded inputs, in the order of the topic loop/log, and its answers are
    compared field by field; exit status 1 if they differ. Frames that a node did not answer when
    it was recorded are left out; frames that cannot be judged are counted, with the reason.

    \b
    Examples: tracks through the present model at ten times the speed; the effect of a change:
      microbot replay out/demo/recording --rate 10 --topic particles --topic field/applied
      microbot replay out/demo/recording --check --node model
      microbot replay out/demo/recording --film demo.mp4
    """
    if check:
        from microbot_ros.cli.replay.check import run_check

        if config and policy:
            raise InputError('--policy', 'expected only without --config, which sets it')
        if rate != 1.0 or start or loop or topics or into_live_rig:
            raise InputError('--rate, --start, --loop, --topic, --into-live-rig',
                             'expected only without --check')
        sys.exit(run_check(session, nodes, end, tolerance, config, policy, out, json_path))
    if nodes or tolerance or config or policy or out or json_path:
        raise InputError('--node, --tolerance, --config, --policy, --out, --json',
                         'expected only with --check')
    if film:
        if rate != 1.0 or start or end or loop or topics or into_live_rig:
            raise InputError('--rate, --start, --end, --loop, --topic, --into-live-rig',
                             'expected only without --film')
        from microbot_ros.cli.replay.film import write_film

        write_film(session, film)
        return
    rate = 0.0 if rate == math.inf else rate
    from microbot_ros.nodes.process import run
    from microbot_ros.session.replay.playback import Playback, open_source

    # Refuse an unplayable recording before a node starts, which would also log it.
    with open_source(session) as source:
        Playback(source, 0.0, rate=rate or math.inf, start=start, end=end or None, loop=loop,
                 topics=topics or None)
    # Texts are quoted: a parameter is read as YAML, in which a day is a number.
    parameters = {'session': json.dumps(str(session)), 'rate': rate, 'start_s': start,
                  'end_s': end, 'loop': str(loop).lower(),
                  'into_live_rig': str(into_live_rig).lower()}
    arguments = ['--ros-args']
    for name, value in parameters.items():
        arguments += ['-p', f'{name}:={value}']
    if topics:
        arguments += ['-p', f'topics:=[{",".join(map(json.dumps, topics))}]']
    sys.exit(run('player', arguments))
