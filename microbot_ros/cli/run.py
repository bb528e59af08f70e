"""`microbot run`: the nodes beside a real rig."""

from __future__ import annotations

import signal
import sys
from pathlib import Path

import click


@click.command()
@click.option('--config', type=click.Path(path_type=Path), required=True,
              help='ROS parameter file with a section per node; see config/rig.yaml.')
@click.option('--arm', is_flag=True, help='Arm the gate once everything runs.')
@click.option('--one-process', is_flag=True, help='All nodes in one process: less latency for '
              'large frames, but one crash ends all.')
def command(config: Path, arm: bool, one_process: bool) -> None:
    """Run the nodes beside a rig until Ctrl-C, which leaves the coils at zero.

    Nothing drives the coils before the gate is armed: with --arm, or from another terminal
    with `microbot arm`. A node that ends is reported, and the others go on.

    \b
    Example:
      microbot run --config config/rig.yaml
      microbot arm
    """
    from microbot_ros.nodes.configuration import read_rig
    from microbot_ros.nodes.graph import Graph
    from microbot_ros.nodes.process import NODES

    nodes = [name for name in NODES if name in read_rig(config)]
    stopping: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda received, _frame: stopping.append(received))
    with Graph(_say) as graph:
        if one_process:
            graph.start_nodes(nodes, config)
        else:
            for name in nodes:
                graph.start_nodes([name], config)
        graph.wait_ready(30.0)
        _say('microbot', f'running: {", ".join(nodes)}; Ctrl-C stops')
        _watch(graph, stopping, arm)


def _watch(graph, stopping: list[int], arm: bool) -> None:  # type: ignore[no-untyped-def]
    from microbot_ros.nodes.remote import Remote

    last: dict[str, tuple[bytes, str]] = {}

    def heard(node: str, level: bytes, sentence: str, _values: dict[str, str]) -> None:
        if last.get(node) != (level, sentence):
            last[node] = (level, sentence)
            _say(node, sentence)

    reported: set[str] = set()
    with Remote() as remote:
        remote.watch_health(heard)
        if arm:
            remote.arm()
            _say('microbot', 'armed')
        while not stopping and len(reported) < graph.count:
            graph.pump(0.0)
            remote.spin(0.1)
            for name, status in graph.ended().items():
                if name not in reported:
                    reported.add(name)
                    _say(name, f'ended with status {status}; the other nodes go on')
    _say('microbot', 'stopping')


def _say(who: str, line: str) -> None:
    print(f'{who}: {line.removeprefix("microbot: ").removeprefix(f"{who}: ")}', file=sys.stderr,
          flush=True)
