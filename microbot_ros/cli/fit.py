"""Command `microbot fit`: v, φ and F of every particle of a recording, with uncertainties."""

from __future__ import annotations

from pathlib import Path

import click

from microbot_ros.cli.options import NEW_FOLDER, PATH, FiniteFloatRange, force_option, json_option


@click.command()
@click.argument('session', metavar='SESSION', type=PATH)
@click.option('--out', type=NEW_FOLDER, required=True, metavar='DIR',
              help='Folder for fit.json and fit.png.')
@click.option('--exposure-ms', type=FiniteFloatRange(0, 10_000), default=0.0, show_default=True,
              help='Exposure time of a frame, for the blur of diffusion during it.')
@json_option('Write the content of fit.json to this file too.')
@force_option
def command(session: Path, out: Path, exposure_ms: float, json_path: Path | None,
            force: bool) -> None:
    """Fit speed v, direction φ and force F of every particle of SESSION by maximum likelihood.

    Diffusion, localisation error and the delay between command and motion are fitted together with
    them. For comparison the result also contains the paper's recipe: terminal speed by linear
    regression over one straight leg. Writes fit.json and fit.png; parameters that the commands
    cannot distinguish are reported.

    \b
    Example:
      microbot simulate config/scenario_plain.yaml --out out/plain
      microbot fit out/plain --out out/fit
    """
    from rich.console import Console
    from rich.markup import escape

    from microbot_ros.common.files import output_folder, refuse_to_overwrite, write_json
    from microbot_ros.estimation import report
    from microbot_ros.estimation.batch import fit
    from microbot_ros.session import read_session

    refuse_to_overwrite(out, ('fit.json', 'fit.png'), force)
    progress = Console(stderr=True, highlight=False, markup=False)
    with progress.status(escape(f'reading {session}')):
        recording = read_session(session)
    with progress.status(f'fitting {len(recording.tracks.particles)} particles'):
        result = fit(recording, exposure_ms * 1e-3)
    content = report.as_json(result)
    with output_folder(out) as folder:
        write_json(folder / 'fit.json', content)
        report.figure(result, folder / 'fit.png')
    write_json(json_path, content)
    console = Console(highlight=False, markup=False)
    console.print(report.table(result))
    noise = result.noise
    console.print(
        f'D {noise.diffusion * 1e12:.3g} ± {1.96 * noise.diffusion_std * 1e12:.2g} µm²/s, '
        f'localisation {noise.localisation * 1e9:.3g} nm'
        + (f', delay {result.delay.value * 1e3:.0f} ± {1.96 * result.delay.std * 1e3:.0f} ms'
           if result.delay.determined else ', delay undetermined')
    )
    for warning in result.warnings:
        console.print(f'! {warning}')
