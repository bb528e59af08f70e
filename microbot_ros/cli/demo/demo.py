"""Command `microbot demo`: the closed loop on the virtual rig."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np
import yaml

from microbot_ros.cli.demo.robots import KINDS, Robots
from microbot_ros.cli.options import NEW_FOLDER, FiniteFloatRange, cockpit_option, json_option
from microbot_ros.cockpit import address
from microbot_ros.common.ending import Ending, Stopped
from microbot_ros.common.errors import InputError
from microbot_ros.common.extras import require
from microbot_ros.common.files import output_folder, write_json, write_text
from microbot_ros.common.real_time import LOOP, realtime_priority
from microbot_ros.nodes.client.graph import Graph

GOALS_UM = np.array([(16.0, 10.0), (-14.0, 14.0), (-4.0, -10.0)])
"""Goals [µm] relative to the steered particle at the time when its v and φ are known. Choice: legs
of 20 to 30 µm in different directions, which a particle swims within the default duration."""

LEARN_DIRECTIONS_DEG = [0.0, 120.0, 240.0, 60.0, 180.0, 300.0]
"""Directions [°] of one second each. Choice: they determine v and φ of every particle, and no
particle moves far."""

LEARN_SECONDS = float(len(LEARN_DIRECTIONS_DEG))
"""Duration of the directions [s]."""

PIXEL_SIZE_UM = 0.45
"""Size of a pixel of the virtual microscope [µm], as in its settings."""

NODES = ('recorder', 'tracker', 'model', 'controller', 'coil_driver', 'virtual_rig')
_FEWEST_SECONDS = 15.0
"""Shortest duration [s]. Choice: the directions and one goal."""
_SPARE_SECONDS = 2.5
"""Spare time for a goal [s]. Choice: paths are not straight, and turns take time."""


@dataclass
class _Run:
    """Goals and interruptions of a run."""

    goals: np.ndarray
    """Goals in order (n, 2) [m]."""
    armed_at: float
    """Time of arming, ROS time [s]."""
    controllers: list[str]
    faults: list[str]


@click.command()
@click.option('--seconds', type=FiniteFloatRange(_FEWEST_SECONDS, 86400), default=30.0,
              show_default=True, help='Duration of the closed loop.')
@click.option('--seed', type=click.IntRange(0, 2**31 - 1), default=1, show_default=True,
              metavar='N', help='Seed of particles, noise and debris.')
@click.option('--robots', type=click.Choice(list(KINDS)), default='catalytic', show_default=True,
              help='Kind of particles: swimmers that a field turns, or rollers in a rotating '
                   'field.')
@cockpit_option
@click.option('--out', type=NEW_FOLDER, default=Path('out/demo'),
              show_default=True, help='Folder for the results.')
@json_option('Write the summary as JSON to this file.')
def command(seconds: float, seed: int, robots: str, cockpit: bool, out: Path,
            json_path: Path | None) -> None:
    """Steer a microrobot on the virtual rig, over a real ROS graph and a real serial line.

    Every node is a process. The model estimates speed and offset angle of each particle without
    prior knowledge; then the controller is switched and one particle visits three places, or as
    many as the time allows. Writes summary.json, an MCAP recording, an overlay video and a figure.

    Ends with 0 if every place was reached; with 1, and all files, if not or if the loop was
    interrupted. If stopped before the end (Ctrl-C, SIGTERM, SIGHUP) it writes nothing and ends
    with 128 plus the signal.

    \b
    Example:
      microbot demo --seconds 30 --seed 1 --out out/demo
      microbot demo --robots rolling --out out/rollers
    """
    require('analysis', 'mcap', 'video')
    began = time.monotonic()
    try:
        run, summary = _demo(seconds, seed, KINDS[robots], cockpit, out, began)
    except Stopped as stopped:
        _say(began, f'stopped by {stopped}: no results written')
        sys.exit(stopped.status)
    _print(summary, out)
    write_json(json_path, summary)
    sys.exit(tell_shortcomings(run.faults, summary, began))


def tell_shortcomings(faults: list[str], summary: dict[str, Any], began: float) -> int:
    """Report interruptions of the loop and missed goals.

    Parameters
    ----------
    faults : list of str
        Faults that interrupted the loop.
    summary : dict of str to object
        Summary of the run.
    began : float
        Start of the demo on the monotonic clock [s].

    Returns
    -------
    int
        Exit status.
    """
    if faults:
        _say(began, f'the loop was interrupted: {"; ".join(faults)}')
    missed = summary['goals'] - summary['goals_reached']
    if missed:
        _say(began, f'{missed} of {summary["goals"]} goals not reached; the particle ended '
                    f'{summary["goal_error_um"]:.1f} µm from the last')
    return 1 if faults or missed else 0


def _demo(seconds: float, seed: int, kind: Callable[[Path], Robots], cockpit: bool, out: Path,
          began: float) -> tuple[_Run, dict[str, Any]]:
    graph = Graph(lambda who, line: _say(began, f'{who}: {line}'))
    with Ending(graph.tell_to_end) as ending, output_folder(out) as folder:
        with graph:
            robots = kind(folder)
            run = _run(graph, ending, folder, seconds, seed, robots, cockpit, began)
            _say(began, 'stopping')
        with ending.interrupts():
            return run, _look_back(folder, out, run, robots, began)


def _run(graph: Graph, ending: Ending, folder: Path, seconds: float, seed: int,
         robots: Robots, cockpit: bool, began: float) -> _Run:
    """Run the whole graph for that time."""
    port, log = folder / 'amplifier', folder / 'amplifier.jsonl'
    rig = folder / 'rig.yaml'
    write_text(rig, _rig_file(folder, port, log, seed, robots))
    _say(began, f'starting the emulated amplifier and {len(NODES)} nodes')
    graph.start('amplifier', [
        sys.executable, '-m', 'microbot_ros.cli', 'emulate', 'serial_transfer',
        '--link', str(port), '--log', str(log), '--full-scale-A', '2', *robots.emulator],
        says_when_ready='serving')
    # The log must exist before the virtual rig reads it. Particles swim as soon as the rig
    # runs, so all others must be ready before.
    others = (*NODES[:-1], *(['cockpit'] if cockpit else []))
    for nodes in (), others, NODES[-1:]:
        for node in nodes:
            graph.start_node(node, rig)
        with ending.interrupts():
            graph.wait_ready()
    with ending.interrupts(), realtime_priority(LOOP):  # no signal waits for the loop
        return _steer(graph, seconds, robots, began)


def _steer(graph: Graph, seconds: float, robots: Robots, began: float) -> _Run:
    """Estimate the particles, then visit goals, for that time."""
    from microbot_ros.nodes.client.graph_client import GraphClient

    with GraphClient() as client:
        watch = _Watch(client, graph, robots.unit, began)
        watch.until_tracked(60.0)
        client.arm()
        armed_at = time.time()
        client.set('controller', controller='open_loop')
        start = time.monotonic()
        _say(began, f'armed; {LEARN_SECONDS:g} s of fixed directions to estimate v and φ')
        watch.until(start + LEARN_SECONDS)
        goals = places_within(start + seconds - time.monotonic(), watch.estimates,
                              robots.turns_per_s)
        client.set('controller', controller=robots.controller)
        client.send_goals([tuple(goal) for goal in goals.tolist()])
        _say(began, f'switched to {robots.controller}: ' + ' → '.join(
            f'({x:.0f}, {y:.0f}) µm' for x, y in goals * 1e6))
        watch.until(start + seconds)
        client.set('controller', controller='hold')
        _say(began, f'disarmed: {client.stop()}')
    return _Run(goals, armed_at, ['hold', 'open_loop', robots.controller, 'hold'],
                sorted(watch.faults))


class _Watch:
    """Listener during the demo: estimates, faults, output of the nodes."""

    def __init__(self, client: Any, graph: Graph, unit: str, began: float) -> None:
        self._client, self._graph, self._unit, self._began = client, graph, unit, began
        self.estimates: Any = np.empty(0)
        self.faults: set[str] = set()
        client.watch_estimates(lambda points: setattr(self, 'estimates', points))
        client.watch_health(self._on_health)

    def until_tracked(self, seconds: float) -> None:
        """Return when the tracker has learned the appearance of particles and found some."""
        deadline = time.monotonic() + seconds
        while not len(self.estimates):
            if time.monotonic() > deadline:
                raise InputError('tracker', f'found no particle within {seconds:g} s')
            self._client.spin(0.1)
            self._graph.pump(0.0)

    def until(self, deadline: float) -> None:
        """Run the loop and print one line a second."""
        while (left := deadline - time.monotonic()) > 0:
            self._client.spin(min(1.0, left))
            self._graph.pump(0.0)
            known = [f'{e["speed"] * 1e6:.2f}±{1.96 * e["speed_std"] * 1e6:.2f}'
                     for e in self.estimates if np.isfinite(e['speed_std'])]
            line = f'v = {", ".join(known)} {self._unit}' if known else 'no estimate yet'
            _say(self._began, line)

    def _on_health(self, node: str, level: bytes, sentence: str, _: dict[str, str]) -> None:
        if level == b'\x02' and sentence not in self.faults:
            self.faults.add(sentence)
            _say(self._began, f'{node}: FAULT {sentence}')


def places_within(seconds: float, estimates: np.ndarray, turns_per_s: float = 1.0) -> np.ndarray:
    """Return the goals that can be reached in a time, in order; at least one.

    They are relative to the steered particle, that with the lowest identity.

    Parameters
    ----------
    seconds : float
        The time [s].
    estimates : ndarray, shape (N,)
        ESTIMATE of each particle.
    turns_per_s : float
        Rotations of the field per second, for a speed per rotation.

    Returns
    -------
    ndarray, shape (n, 2)
        Goals [m].
    """
    first = estimates[estimates['id'].argmin()]
    legs = np.diff(GOALS_UM, axis=0, prepend=0.0) * 1e-6
    needed = np.hypot(*legs.T).cumsum() / (first['speed'] * turns_per_s) + _SPARE_SECONDS
    count = max(1, np.count_nonzero(needed <= seconds))
    return np.array([first['x'], first['y']], float) + GOALS_UM[:count] * 1e-6


def _look_back(folder: Path, out: Path, asked: _Run, robots: Robots,
               began: float) -> dict[str, Any]:
    """Write summary, figure and video of the recording; return the summary."""
    from microbot_ros.cli.demo.figure import draw
    from microbot_ros.cli.demo.results import DemoRun, summarise
    from microbot_ros.cli.demo.video import write_video

    recording = folder / 'recording'
    run = DemoRun.read(recording)
    summary = {**summarise(run, asked.goals, asked.armed_at), 'nodes': list(NODES),
               'controllers': asked.controllers, 'speed_unit': robots.unit,
               'recording': str(out / 'recording')}
    write_json(folder / 'summary.json', summary)
    draw(run, asked.goals[-1], robots.unit, folder / 'demo.png')
    _say(began, 'drawing the video')
    write_video(run, recording, PIXEL_SIZE_UM * 1e-6, folder / 'demo.mp4')
    return summary


def _rig_file(folder: Path, port: Path, log: Path, seed: int, robots: Robots) -> str:
    """Return the parameters of every node, as a file for `microbot run`."""
    own: dict[str, dict[str, Any]] = {
        'virtual_rig': {'amplifier_log': str(log), 'seed': seed},
        'tracker': {'pixel_size_um': PIXEL_SIZE_UM},
        'model': {'radius_um': 2.3, 'viscosity_mPa_s': 1.245},
        'controller': {'controller': 'hold', 'open_loop.directions_deg': LEARN_DIRECTIONS_DEG,
                       'open_loop.durations_s': [1.0] * len(LEARN_DIRECTIONS_DEG)},
        # A shared machine may pause for 0.1 s; beside a rig the default is right.
        'coil_driver': {'port': str(port), 'command_timeout_ms': 250.0,
                        'max_command_age_ms': 250.0},
        'cockpit': {'recordings': str(folder)},
        'recorder': {'folder': str(folder / 'recording'), 'frame_every': 6,
                     'title': 'microbot demo'},
    }
    return yaml.safe_dump(
        {node: {'ros__parameters': values | robots.nodes.get(node, {})}
         for node, values in own.items()}, sort_keys=False)


def _print(summary: dict[str, Any], out: Path) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table('particle', 'v found', 'true', 'φ found', 'true')
    for name, found in summary['estimate'].items():
        table.add_row(
            name, f'{found["speed_um_s"]:.2f} ± {1.96 * found["speed_std_um_s"]:.2f} '
            f'{summary["speed_unit"]}',
            f'{found["true_speed_um_s"]:.2f}',
            f'{found["phi_rad"]:.3f} ± {1.96 * found["phi_std_rad"]:.3f} rad',
            f'{found["true_phi_rad"]:.3f}')
    console = Console(markup=False)
    console.print(table)
    latency = summary['latency_ms']
    passed = ('no command acknowledged' if latency['p50'] is None else
              f'exposure to amplifier p50 {latency["p50"]:.1f} ms, p99 {latency["p99"]:.1f} ms')
    console.print(
        f'reached {summary["goals_reached"]} of {summary["goals"]} places; distance to the last, '
        f'mean of the last 5 s: {summary["goal_error_um"]:.1f} µm\n'
        f'frames {summary["frames"]}, dropped {summary["frames_dropped"]}; {passed}; CRC errors '
        f'{summary["amplifier"]["crc_errors"]}\n'
        f'look at {out}/demo.mp4 and {out}/demo.png', highlight=False)


def _say(began: float, line: str) -> None:
    line = address.shown(line, sys.stderr)
    with suppress(OSError):  # a closed terminal must not end the clean-up
        print(f'[{time.monotonic() - began:5.1f} s] {line.removeprefix("microbot: ")}',
              file=sys.stderr, flush=True)
