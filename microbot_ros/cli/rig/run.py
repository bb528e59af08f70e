"""Command `microbot run`: the nodes beside a real rig."""

from __future__ import annotations

import re
import sys
from contextlib import suppress
from pathlib import Path

import click

from microbot_ros.cli.options import PATH, cockpit_option, namespace_option
from microbot_ros.cockpit import address
from microbot_ros.common.ending import Ending, Stopped
from microbot_ros.common.errors import InputError
from microbot_ros.common.real_time import LOOP, realtime_priority
from microbot_ros.nodes.client.graph import Graph


@click.command()
@click.option('--config', type=PATH, required=True,
              help='ROS parameter file with a section per node; see config/rig.yaml.')
@click.option('--arm', is_flag=True, help='Arm the gate once everything runs.')
@cockpit_option
@namespace_option
def command(config: Path, arm: bool, cockpit: bool, namespace: str) -> None:
    """Run the nodes beside a rig until Ctrl-C, SIGTERM or SIGHUP, which zero the coils at once.

    Nothing drives the coils before the gate is armed: with --arm, or from another terminal with
    `microbot arm`. A node that ends is reported, and the others continue. At the end a recorder
    has 15 s to write its data. Ends with 0, or with 1 if a node had to be killed.

    Two rigs run side by side, each in its own --namespace, from two files or from one:
    `/**/camera` is the camera of every rig, `/rig_2/camera` that of rig_2, `camera` one without a
    namespace.

    \b
    Example:
      microbot run --config config/rig.yaml
      microbot arm
      microbot run --config rig_2.yaml --namespace rig_2
    """
    from microbot_ros.nodes.base.names import NODES
    from microbot_ros.nodes.client.graph_client import checked_namespace
    from microbot_ros.nodes.configuration import read_rig, refused

    namespace = checked_namespace(namespace)
    rig = read_rig(config, namespace)
    if not rig:
        raise InputError(config, f'expected a section for each node to run: {", ".join(NODES)}')
    nodes = [name for name in NODES if name in rig or (cockpit and name == 'cockpit')]
    graph = Graph(_say)
    with Ending(graph.tell_to_end) as ending, graph:
        for node in nodes:
            graph.start_node(node, config, namespace)
        try:
            with ending.interrupts():
                graph.wait_ready()
                _say('microbot', f'running: {", ".join(nodes)}; Ctrl-C stops')
                with realtime_priority(LOOP):  # ending must not wait for the loop
                    _watch(graph, arm, namespace)
        except InputError as error:
            raise refused(config, rig, namespace, error.source, error.expected) from None
        except Stopped as stopped:
            _say('microbot', f'stopping on {stopped}')
    if graph.killed:
        sys.exit(1)


def _watch(graph: Graph, arm: bool, namespace: str) -> None:
    """Print changes in the rig of a namespace, until every node has ended."""
    from microbot_ros.nodes.client.graph_client import GraphClient

    last: dict[str, tuple[bytes, str]] = {}

    def heard(node: str, level: bytes, sentence: str, _values: dict[str, str]) -> None:
        # A growing count is the same state; another particle is a new one.
        state = level, re.sub(r'(?<!particle )\b\d+(\.\d+)?', '#', sentence)
        if last.get(node) != state:
            last[node] = state
            _say(node, sentence)

    reported: set[str] = set()
    with GraphClient(namespace=namespace) as client:
        client.watch_health(heard)
        if arm:
            _say('microbot', client.arm())
        while len(reported) < graph.count:
            graph.pump(0.0)
            client.spin(0.1)
            for name, status in graph.ended().items():
                if name not in reported:
                    reported.add(name)
                    _say(name, f'ended with status {status}; the other nodes go on')


def _say(who: str, line: str) -> None:
    line = address.shown(line, sys.stderr)
    with suppress(OSError):  # a closed terminal must not end the clean-up
        print(f'{who}: {line.removeprefix("microbot: ").removeprefix(f"{who}: ")}',
              file=sys.stderr, flush=True)
