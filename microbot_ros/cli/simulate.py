"""Command `microbot simulate`: the physics, with any effects, as a session."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from microbot_ros.cli.options import NEW_FOLDER, PATH, force_option, json_option


@click.command()
@click.argument('scenario_yaml', metavar='SCENARIO.yaml', type=PATH)
@click.option('--out', type=NEW_FOLDER, required=True, metavar='SESSION',
              help='Folder for the session; its truth.yaml lists the simulated parameters.')
@json_option('Write the truth and the number of rows as JSON to this file.')
@force_option
def command(scenario_yaml: Path, out: Path, json_path: Path | None, force: bool) -> None:
    """Simulate SCENARIO.yaml: particles, fluid, camera, commands and any hidden effects.

    The physics is langevin (Brownian particles with torques and flows at millisecond steps),
    first_order (the fitted model itself, without random motion) or newton_stokes (with inertia).

    \b
    Examples:
      microbot simulate config/scenario_plain.yaml --out out/plain
      microbot simulate config/scenario_lag.yaml --out out/lag
      microbot discover out/lag --out out/found
    """
    import yaml
    from rich.console import Console

    from microbot_ros import __version__
    from microbot_ros.common.files import (
        output_folder,
        refuse_to_overwrite,
        write_json,
        write_text,
    )
    from microbot_ros.common.units import exact_display
    from microbot_ros.session import write_session
    from microbot_ros.session.tables.folder import FILES
    from microbot_ros.virtual_rig.scenario import read_scenario
    from microbot_ros.virtual_rig.simulation import run, strays

    scenario, particles = read_scenario(scenario_yaml)
    outputs = *FILES, 'truth.yaml'
    refuse_to_overwrite(out, outputs, force)
    console = Console(stderr=True, highlight=False, markup=False)
    with console.status(f'{scenario.physics}: {scenario.duration_s:g} s of '
                        f'{len(particles.ids)} particles'):
        session = run(scenario, particles, str(scenario_yaml))
    name = scenario.speed_key
    truth: dict[str, Any] = {
        'physics': scenario.physics, 'seed': scenario.seed, 'version': __version__,
        'particles': {
            int(i): {name: float(exact_display(name, float(speed))), 'phi_rad': float(phi)}
            for i, speed, phi in zip(particles.ids, particles.speed, particles.phi, strict=True)},
        'effects': scenario.content()['effects'],
    }
    with output_folder(out, outputs) as folder:
        write_session(folder, session)
        write_text(folder / 'truth.yaml', yaml.safe_dump(truth, sort_keys=False))
    write_json(json_path, truth | {'rows': len(session.tracks.t), 'session': str(out)})
    for remark in strays(scenario, particles, session):
        console.print(f'! {remark}')
    console.print(f'{out}: {len(session.tracks.t)} positions, {len(session.commands.t)} commands')
