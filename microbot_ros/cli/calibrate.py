"""`microbot calibrate`: rig constants from measurements."""

from __future__ import annotations

import json
from pathlib import Path

import click
import pydantic
import yaml

from microbot_ros.files import output_folder, read_yaml, write_text
from microbot_ros.magnetics.settings import CoilSettings


class _Rig(pydantic.BaseModel):
    """The one section of a rig's file that matters here; others are not looked at."""

    coils: CoilSettings = CoilSettings()


@click.group()
def command() -> None:
    """Find constants of the rig from measurements."""


@command.command()
@click.argument('readings_csv', metavar='READINGS.csv', type=click.Path(path_type=Path))
@click.option('--out', type=click.Path(path_type=Path), required=True, metavar='DIR',
              help='Folder for coils.yaml, calibration.json and calibration.png.')
@click.option('--config', type=click.Path(path_type=Path),
              help="Rig's YAML with the geometry in its section coils (else the default rig).")
@click.option('--json', 'json_path', type=click.Path(path_type=Path),
              help='Also write the result here.')
def coils(readings_csv: Path, out: Path, config: Path | None, json_path: Path | None) -> None:
    """Fit gain and sign of each coil, and the background field, to gaussmeter readings.

    The file has a row per reading with the columns bx_mT and by_mT, the current of each coil
    (coil_plus_x_A and so on, after the names in the rig's file), and optionally bz_mT and the
    place of the probe x_mm, y_mm, z_mm (else the workspace centre). Drive each coil by itself,
    both ways. coils.yaml is the section for the rig's file, with what was found.

    \b
    Example:
      microbot calibrate coils readings.csv --config config/rig.yaml --out out/coils
    """
    from microbot_ros.magnetics.calibration import calibrate, read_readings
    from microbot_ros.magnetics.plots import draw_calibration
    settings = (read_yaml(config, _Rig) if config else _Rig()).coils
    readings = read_readings(readings_csv, settings)
    calibration = calibrate(readings, settings, readings_csv)
    section = calibration.applied_to(settings).model_dump(mode='json', exclude_none=True)
    summary = calibration.summary()
    result = json.dumps(summary, indent=1) + '\n'
    with output_folder(out) as folder:
        write_text(folder / 'coils.yaml', yaml.safe_dump({'coils': section}, sort_keys=False))
        write_text(folder / 'calibration.json', result)
        draw_calibration(calibration, readings, folder / 'calibration.png')
    if json_path:
        write_text(json_path, result)
    for name, found in summary['coils'].items():
        gain = f'gain {found["gain"]:.4f} ± {found["gain_std"]:.4f}'
        click.echo(f'{name}: {gain}, sign {found["sign"]:+d}')
    click.echo(f'residual {summary["residual_rms_mT"]:.3g} mT rms; written to {out}')
