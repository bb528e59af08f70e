"""How long the loop takes for a frame, and how fast a simulated world goes."""

from __future__ import annotations

import gc
import os
import struct
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import gymnasium
import numba
import numpy as np

from bench import _rig
from bench.figure import Figure, sized
from microbot_ros.common.records import Commands
from microbot_ros.control.contract import Goals
from microbot_ros.loop.controller import ControllerParameters
from microbot_ros.loop.loop import Loop, LoopParameters
from microbot_ros.loop.tracker import TrackerParameters
from microbot_ros.magnetics import Allocator, CoilSet
from microbot_ros.model.physics.particle import Fluid
from microbot_ros.virtual_rig import simulation
from microbot_ros.virtual_rig.microscope import Microscope, MicroscopeSettings
from microbot_ros.virtual_rig.record_session import draw_swarm
from microbot_ros.virtual_rig.scenario import read_scenario
from microbot_ros.virtual_rig.world import FieldHistory, World

_ISSUE = 15
_RATE_HZ, _PARTICLES = 100.0, 4
_FILMED, _FRAMES, _WARM = 400, 10_000, 1_000
_PLAYED, _COMPARED = sized(100_000, 10_000), sized(10_000, 3_000)
"""Frames in real time: of the figure itself, and of what it is compared with."""
_PERCENTILES = (50.0, 99.0, 99.9)
_WORLDS, _STEPS = 64, 200
_STEERING = 'microbot_ros.gym:microbot_ros/Steering-v0'  # imported, then made
_SCENARIO = Path('config/scenario_closed_loop.yaml')
_BARE = 'a bare loop: Numba centroids, one matrix, os.write'


def figures() -> Iterator[Figure]:
    """All figures; some thirty minutes, most of them for frames in real time."""
    yield from _frame_figures()
    yield from _simulated_figures()
    yield _training_figure()
    yield from _rig_figures()


def _rig_figures() -> list[Figure]:
    film = _film()
    bare = _rig.answers(film, _RATE_HZ, _COMPARED)
    viewed = _rig.answers(film, _RATE_HZ, _COMPARED, recorder=True, viewer=True)
    found = _rig.answers(film, _RATE_HZ, _PLAYED, recorder=True)
    count = len(found.written_s)
    return [
        *_answer_figures(_ISSUE, 'written', found.written_s, (1.0, 2.0, 5.0)),
        *_answer_figures(_ISSUE, 'acknowledged', found.acknowledged_s, (4.0, 8.0)),
        *_answer_figures(36, 'written', found.written_s, (6.0, 9.0)),
        _ratio_figure(viewed.written_s, bare.written_s),
        Figure(_ISSUE, f'the rig, {count} frames: cuts', found.cuts, '', '0', '', found.cuts == 0)]


def _answer_figures(issue: int, what: str, spent_s: list[float],
                    limits_ms: tuple[float, ...]) -> list[Figure]:
    percentiles = _PERCENTILES[:len(limits_ms)]
    found = 1e3 * np.percentile(spent_s, percentiles)
    return [Figure(issue, f'the rig, recorder on, {len(spent_s)} frames: exposure to currents '
                   f'{what}, p{p:g}', float(ms), 'ms', f'<= {limit:g}', '', bool(ms <= limit))
            for p, ms, limit in zip(percentiles, found, limits_ms, strict=True)]


def _ratio_figure(viewed_s: list[float], bare_s: list[float]) -> Figure:
    ratio = float(np.percentile(viewed_s, 99) / np.percentile(bare_s, 99))
    return Figure(_ISSUE, 'the rig: p99 to currents written with recorder and viewer, over '
                  'without', ratio, 'ratio', '<= 1.2', 'none', ratio <= 1.2)


def _frame_figures() -> list[Figure]:
    film = _film()
    ours, bare = _spent_s(_our_step(), film), _spent_s(_bare_step(film[0]), film)
    limits_ms = (1.0, 2.0, 5.0)
    found = 1e3 * np.percentile(ours, _PERCENTILES)
    named = f'640×480, {_PARTICLES} particles, {_FRAMES} frames: frame in memory to currents'
    return [
        *(Figure(_ISSUE, f'{named}, p{p:g}', float(ms), 'ms', f'<= {limit:g}', _BARE,
                 bool(ms <= limit))
          for p, ms, limit in zip(_PERCENTILES, found, limits_ms, strict=True)),
        Figure(_ISSUE, f'{named}, p50 over that of a bare loop '
               f'({1e3 * np.median(bare):.2f} ms)', float(np.median(ours) / np.median(bare)),
               'ratio', '<= 3', _BARE, bool(np.median(ours) <= 3 * np.median(bare)))]


def _film() -> list[np.ndarray]:
    """Swimmers under a field that turns a little in every frame, forwards and back again."""
    rng = np.random.default_rng(2)
    world = World(draw_swarm(rng, _PARTICLES, Fluid(1.245e-3), 5e-3, radius=2.3e-6,
                             half_extent=80e-6), rng)
    scope = Microscope(MicroscopeSettings(), seed=2)
    angle = 0.02 * np.arange(_FILMED)
    field = 5e-3 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    history = FieldHistory.uniform(Commands(np.arange(_FILMED) / _RATE_HZ, field))
    there = []
    for k in range(_FILMED):
        world.advance(k / _RATE_HZ, history)
        there.append(scope.render(world.position, world.heading, world.t))
    return there + there[-2:0:-1]


def _spent_s(step: Callable[[np.ndarray, float], None], film: list[np.ndarray]) -> np.ndarray:
    """Seconds (_FRAMES,) that each step took."""
    spent = np.empty(_WARM + _FRAMES)
    gc.collect()
    gc.freeze()
    for k in range(len(spent)):
        image = film[k % len(film)]
        begin = time.perf_counter()
        step(image, (k + 1) / _RATE_HZ)
        spent[k] = time.perf_counter() - begin
    gc.unfreeze()
    return spent[_WARM:]


def _our_step() -> Callable[[np.ndarray, float], None]:
    loop = Loop(LoopParameters(TrackerParameters(pixel_size_um=0.45),
                               controller=ControllerParameters(controller='waypoint')))
    loop.controller.go_to(Goals(np.array([[20e-6, 10e-6], [-20e-6, 10e-6]])))
    loop.measured(np.zeros(4), 0.0)
    loop.arm(0.0)

    def step(image: np.ndarray, t: float) -> None:
        loop.measured(loop.step(image, t).currents, t)
    return step


def _bare_step(image: np.ndarray) -> Callable[[np.ndarray, float], None]:
    """What a script does that knows where the particles are: follow, steer, write."""
    dark = image.mean() - image.astype(float)
    flat = np.argsort(dark, axis=None)[::-1][:_PARTICLES * 200:200]
    places = np.array(np.unravel_index(flat, image.shape), float).T
    inverse = np.linalg.pinv(Allocator(CoilSet(None)).matrix)
    sink = os.open(os.devnull, os.O_WRONLY)
    goal = np.array([240.0, 320.0])

    def step(image: np.ndarray, _: float) -> None:
        _follow(image, places)
        way = goal - places[0]
        field = 5e-3 * way / (np.hypot(*way) or 1.0)
        os.write(sink, struct.pack('<4f', *(inverse @ field)))
    return step


@numba.njit(cache=True)
def _follow(image: np.ndarray, places: np.ndarray) -> None:
    """Move each place (N, 2) [px] to the centroid of what is dark around it."""
    half = 16
    for k in range(len(places)):
        row, column = int(places[k, 0]), int(places[k, 1])
        total = down = right = 0.0
        for i in range(max(row - half, 0), min(row + half, image.shape[0])):
            for j in range(max(column - half, 0), min(column + half, image.shape[1])):
                weight = max(120.0 - image[i, j], 0.0)
                total += weight
                down += weight * i
                right += weight * j
        if total > 0:
            places[k, 0], places[k, 1] = down / total, right / total


def _simulated_figures() -> list[Figure]:
    found = []
    for pictures, name, least in ((True, 'rendered 640×480', 5.0), (False, 'poses alone', 200.0)):
        scenario, particles = read_scenario(_SCENARIO)
        assert scenario.controller is not None
        wanted = scenario.controller.replaced(pictures=pictures)
        scenario = scenario.replaced(controller=wanted)
        simulation.run(scenario.replaced(duration_s=1.0), particles, name)
        begin = time.perf_counter()
        simulation.run(scenario, particles, name)
        speed = scenario.duration_s / (time.perf_counter() - begin)
        found.append(Figure(_ISSUE, f'closed loop simulated, {name}, '
                            f'{scenario.camera.frame_rate_hz:g} frames/s', speed, '× real time',
                            f'>= {least:g}', 'none', speed >= least))
    return found


def _training_figure() -> Figure:
    """Steps of environments with two particles, in one process, beside Gymnasium's own first."""
    many = _WORLDS * _steps_per_s(gymnasium.make_vec(_STEERING, num_envs=_WORLDS))
    one, peer = (_steps_per_s(gymnasium.make(name)) for name in (_STEERING, 'CartPole-v1'))
    return Figure(_ISSUE, f'Gymnasium steps, {_WORLDS} environments in one (one alone: '
                  f'{one:.0f} /s)', many, '1/s', '>= 10000',
                  f"Gymnasium's CartPole-v1, one alone: {peer:.0f} /s", many >= 1e4)


def _steps_per_s(env: gymnasium.Env | gymnasium.vector.VectorEnv) -> float:
    """Steps in a second with random actions, the compilation aside."""
    env.action_space.seed(1)
    actions = [env.action_space.sample() for _ in range(_STEPS)]
    for _ in range(2):
        env.reset(seed=1)
        begin = time.perf_counter()
        for action in actions:
            _, _, *over, _ = env.step(action)
            if isinstance(env, gymnasium.Env) and any(over):
                env.reset()
        spent = time.perf_counter() - begin
    return len(actions) / spent
