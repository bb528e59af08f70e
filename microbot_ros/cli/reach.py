"""Command `microbot reach`: targets that particles under one field can and cannot reach."""

from __future__ import annotations

import cmath
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from microbot_ros.cli.options import NEW_FILE, PATH, FiniteFloatRange, json_option
from microbot_ros.common import units
from microbot_ros.common.errors import InputError

if TYPE_CHECKING:
    from microbot_ros.control.planning.plan import Swarm
    from microbot_ros.control.reach import Reach

_PAIR = 'X_UM,Y_UM'
_FARTHEST = 1e6
"""Largest coordinate [µm] and time [s]. Choice: a metre, beyond which numbers could overflow."""


@click.command()
@click.option('--model', 'model_file', type=PATH,
              help='Model and particles: a model.yaml of `microbot discover`.')
@click.option('--particle', 'particles', multiple=True, metavar='V_UM_S,PHI_RAD',
              help="Speed and angle of a particle, in place of the model's; repeat for each "
                   'particle.')
@click.option('--at', 'places', multiple=True, required=True, metavar=_PAIR,
              help='Position of a particle; repeat for each particle.')
@click.option('--goal', 'goals', multiple=True, required=True, metavar=_PAIR,
              help='Goal of a particle; repeat for each particle.')
@click.option('--alignment-times-s', metavar='S,S,...',
              help='Alignment time of each particle, if they differ.')
@click.option('--seconds', default=10.0, show_default=True, type=FiniteFloatRange(0.1, 3600),
              help='Duration of the commands that are tried.')
@click.option('--field-mt', default=5.0, show_default=True, type=FiniteFloatRange(0.001, 1000),
              help='Largest field.')
@click.option('--figure', type=NEW_FILE, help='Draw the result to this PNG '
                                                                'or PDF.')
@json_option('Write all numbers as JSON to this file.')
def command(model_file: Path | None, particles: tuple[str, ...], places: tuple[str, ...],
            goals: tuple[str, ...], alignment_times_s: str | None, seconds: float,
            field_mt: float, figure: Path | None, json_path: Path | None) -> None:
    """Compute what N particles under one field can reach, and the floor of their error.

    It also computes what lag, field strength and switching the field off open beyond that floor.

    \b
    Example, two particles whose alignment times differ:
      microbot reach --particle 4,0 --particle 4,2 --at 0,0 --at 30,0 \\
        --goal 20,0 --goal 30,-15 --alignment-times-s 0.1,0.3 --figure reach.png
    """
    import numpy as np

    from microbot_ros.common.extras import require
    from microbot_ros.common.files import write_json
    from microbot_ros.control.contract import Workspace
    from microbot_ros.control.planning.shared import as_complex
    from microbot_ros.control.reach import opened, planned_floor, reach

    require('predictive', *(['analysis'] if figure else []))
    swarm = _swarm(model_file, particles, places, alignment_times_s)
    goal = as_complex(np.array([_numbers('--goal', g, _PAIR) for g in goals]) * 1e-6)
    if len(goal) != len(swarm.position):
        raise InputError('--goal', f'expected one for each of {len(swarm.position)} particles; '
                                   f'received {len(goal)}')
    limit = units.to_si('field_mT', field_mt)
    found = reach(swarm.velocity, swarm.position, goal)
    beyond = opened(swarm, limit, seconds, np.random.default_rng(0))
    everywhere = Workspace(np.full(2, -1.0), np.full(2, 1.0))
    planned = planned_floor(swarm, goal, limit, everywhere)
    result = _result(found, beyond, planned, seconds)
    if figure is not None:
        from microbot_ros.control.reach_figure import draw

        try:
            draw(figure, swarm, goal, found, beyond, planned, seconds)
        except (OSError, ValueError) as error:
            problem = f'expected a PNG, PDF or SVG file that can be written ({error})'
            raise InputError(figure, problem) from None
    write_json(json_path, result)
    _tell(result)


def _swarm(model_file: Path | None, particles: tuple[str, ...], places: tuple[str, ...],
           alignment_times_s: str | None) -> Swarm:
    import numpy as np

    from microbot_ros.control.planning.plan import Swarm, with_lags
    from microbot_ros.control.planning.shared import as_complex
    from microbot_ros.model.io.model_file import read_model
    from microbot_ros.model.model import Model, ParticleParameters

    if model_file is None and not particles:
        raise InputError('reach', 'expected --model FILE or --particle V_UM_S,PHI_RAD')
    model, known = (Model(5e-3), None) if model_file is None else read_model(model_file)
    if particles:
        speed, phi = np.array([_numbers('--particle', p, 'V_UM_S,PHI_RAD') for p in particles]).T
        known = ParticleParameters(np.arange(len(speed)), speed * 1e-6, phi)
    assert known is not None
    position = as_complex(np.array([_numbers('--at', p, _PAIR) for p in places]) * 1e-6)
    count = len(known.ids)
    if not (known.speed >= 1e-9).all():  # no solver resolves less
        raise InputError('--particle', 'expected speeds of 0.001 µm/s or more')
    if len(position) != count:
        raise InputError('--at', f'expected one for each of {count} particles; '
                                 f'received {len(position)}')
    lags: list[float | None] = [None] * count
    if alignment_times_s is not None:
        times = _numbers('--alignment-times-s', alignment_times_s, f'{count} positive times',
                         count)
        if min(times) <= 0:
            raise InputError('--alignment-times-s', f'expected {count} positive times')
        lags = list(times)
    return Swarm(np.arange(count), position, known.velocity_phasor, np.ones(count, complex),
                 with_lags(model, lags), 0.0)


def _numbers(option: str, text: str, expected: str, count: int = 2) -> list[float]:
    try:
        values = [float(part) for part in text.split(',')]
    except ValueError:
        values = []
    if len(values) != count or not all(abs(v) <= _FARTHEST for v in values):
        raise InputError(option, f'expected {expected}; received {text!r}')
    return values


def _result(found: Reach, beyond: dict[str, Any], planned: float,
            seconds: float) -> dict[str, Any]:
    count = len(found.ends)
    return {
        'particles': count, 'dimensions': 2 * count, 'reachable_dimensions': min(2, 2 * count),
        'subspace': found.subspace.tolist(), 'floor_um': found.floor * 1e6,
        'shared_displacement': {
            'direction_rad': cmath.phase(found.displacement), 'time_s': abs(found.displacement)},
        'ends_um': [[z.real * 1e6, z.imag * 1e6] for z in found.ends.tolist()],
        'left_um': [abs(z) * 1e6 for z in found.left.tolist()],
        'planned_floor_um': planned * 1e6,
        'opened_um': {handle: (values * 1e6).tolist() for handle, values in beyond.items()},
        'opened_in_s': seconds,
    }


def _tell(result: dict[str, Any]) -> None:
    from microbot_ros.control.reach import HANDLES

    shared = result['shared_displacement']
    click.echo(f"{result['particles']} particles: {result['reachable_dimensions']} of "
               f"{result['dimensions']} dimensions are reachable under the first-order model")
    click.echo(f"best together: {shared['time_s']:.2f} s along {shared['direction_rad']:.3f} rad; "
               f"floor {result['floor_um']:.2f} µm RMS, the least that any controller can reach "
               'there')
    if result['particles'] > 1:
        click.echo(f"beyond it, RMS in {result['opened_in_s']:g} s along the closed directions:")
        for handle, values in result['opened_um'].items():
            listed = ', '.join(f'{value:.2f}' for value in values)
            click.echo(f'  {HANDLES[handle]}: {listed} µm')
        click.echo(f"one manoeuvre planned with it leaves {result['planned_floor_um']:.2f} µm")
