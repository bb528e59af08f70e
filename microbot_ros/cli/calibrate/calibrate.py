"""Command `microbot calibrate`: constants of the rig from measurements."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from microbot_ros.cli.calibrate.camera import camera
from microbot_ros.cli.options import NEW_FOLDER, PATH, force_option, json_option
from microbot_ros.common.checked import Settings
from microbot_ros.magnetics.settings import CoilSettings

_OUTPUTS = ('coils.yaml', 'calibration.json', 'calibration.png')


class _Section(Settings, others=True):
    """Section `coils` of a file whose other content is ignored."""

    coils: CoilSettings


@dataclass(frozen=True)
class _Found:
    """Corrected coils, the result as JSON and as lines for people, and its picture."""

    settings: CoilSettings
    summary: dict[str, Any]
    lines: list[str]
    draw: Callable[[Path], None]


@click.group()
def command() -> None:
    """Determine constants of the rig from measurements.

    \b
    Example:
      microbot calibrate coils readings.csv --config config/rig.yaml --out out/coils
    """


command.add_command(camera)


@command.command()
@click.argument('source', metavar='READINGS.csv|SESSION', type=PATH)
@click.option('--out', type=NEW_FOLDER, required=True, metavar='DIR',
              help='Folder for coils.yaml, calibration.json and calibration.png.')
@click.option('--config', type=PATH,
              help="Coils to start from: a coils.yaml, or the rig's file that names one in "
                   'coil_driver.coils_file. Default: the coils of the default rig.')
@force_option
@json_option('Write the result as JSON to this file.')
def coils(source: Path, out: Path, config: Path | None, force: bool,
          json_path: Path | None) -> None:
    """Fit the coils to gaussmeter readings, or to the tracks of a session.

    READINGS.csv has one row per reading with the columns bx_mT and by_mT, the current of each coil
    (coil_plus_x_A and so on, named as in the rig's file), and optionally bz_mT and the position of
    the probe x_mm, y_mm, z_mm (default: the workspace centre). Drive each coil alone, in both
    directions. The result is gain and sign of each coil and the background field.

    SESSION, a folder or a recording, has catalytic particles under known commands in all
    directions, made by the coils in --config. The directions of motion give the gain of the y pair
    over the x pair, its tilt and the background field; they cannot give the strength of all coils
    together, a rotation common to all, or a single coil of a pair.

    coils.yaml holds the coils with the result; the rig's file names it as coils_file of the node
    coil_driver. The coils at the start are reported.

    \b
    Examples:
      microbot calibrate coils readings.csv --config config/rig.yaml --out out/coils
      microbot calibrate coils recordings/monday --out out/coils
    """
    import yaml

    from microbot_ros.common.files import (
        output_folder,
        refuse_to_overwrite,
        write_json,
        write_text,
    )
    refuse_to_overwrite(out, _OUTPUTS, force)
    settings, origin = _known_coils(config)
    tracks = source.is_dir() or source.suffix == '.mcap'
    found = (_from_tracks if tracks else _from_readings)(source, settings)
    section = found.settings.content('not none')
    with output_folder(out, _OUTPUTS) as folder:
        write_text(folder / 'coils.yaml', yaml.safe_dump({'coils': section}, sort_keys=False))
        write_json(folder / 'calibration.json', found.summary)
        found.draw(folder / 'calibration.png')
    write_json(json_path, found.summary)
    file = (out / 'coils.yaml').resolve()
    for line in [f'started from {origin}', *found.lines, f'written to {out}; to drive by it, in '
                 f"the rig's file: coil_driver: coils_file: {file}"]:
        click.echo(line)


def _known_coils(config: Path | None) -> tuple[CoilSettings, str]:
    """Return the coils to correct, and their origin as text."""
    from microbot_ros.common.errors import InputError, clipped
    from microbot_ros.common.files import read_yaml
    from microbot_ros.nodes.configuration import read_rig

    if config is None:
        return CoilSettings(), 'the coils of the default rig'
    keys = set(read_yaml(config, dict[str, Any]))
    if 'coils' in keys:
        return read_yaml(config, _Section).coils, f'the coils of {config}'
    if keys & set(CoilSettings.names()):
        return read_yaml(config, CoilSettings), f'the coils of {config}'
    if 'coil_driver' not in keys:
        raise InputError(config, 'expected coils, with a key coils or windings, or the file of a '
                         f'rig, with a section coil_driver; found '
                         f'{clipped(", ".join(keys)) or "nothing"}')
    named = read_rig(config)['coil_driver'].get('coils_file', '')
    if not named:
        return CoilSettings(), f'the coils of the default rig: {config} names no coils_file'
    return read_yaml(named, CoilSettings), f'the coils of {named}, named in {config}'


def _from_readings(source: Path, settings: CoilSettings) -> _Found:
    from microbot_ros.magnetics.calibration import calibrate, read_readings
    from microbot_ros.magnetics.plots import draw_calibration
    readings = read_readings(source, settings)
    calibration = calibrate(readings, settings, source)
    summary = calibration.summary()
    lines = [f'{name}: gain {found["gain"]:.4f} ± {found["gain_std"]:.4f}, '
             f'sign {found["sign"]:+d}' for name, found in summary['coils'].items()]
    lines.append(f'residual {summary["residual_rms_mT"]:.3g} mT rms')
    return _Found(calibration.applied_to(settings), summary, lines,
                  lambda path: draw_calibration(calibration, readings, path))


def _from_tracks(source: Path, settings: CoilSettings) -> _Found:
    from microbot_ros.cli.calibrate.figures import draw_coils
    from microbot_ros.discovery.check.coil_map import coil_map
    from microbot_ros.magnetics.calibration import with_coil_map
    from microbot_ros.session import read_session
    found = coil_map(read_session(source))
    corrected = with_coil_map(settings, found.gain_ratio.value, found.skew.value, found.matrix,
                           found.offset)
    coils = {winding.name: {'gain': winding.gain, 'sign': winding.sign}
             for winding in corrected.windings}
    summary = {'coils': coils, **found.summary()}
    (bx, by), (bx_std, by_std) = 1e3 * found.offset, 1e3 * found.offset_std
    lines = [
        f'y coils over x coils: gain {found.gain_ratio.value:.4f} ± {found.gain_ratio.std:.4f}',
        f'y coils tilted by {found.skew.value:.4f} ± {found.skew.std:.4f} rad towards +x',
        f'background field {bx:.3g} ± {bx_std:.2g}, {by:.3g} ± {by_std:.2g} mT in addition to the '
        "file's",
        'not determined by tracks: strength of all coils, a common rotation, each coil of a pair']
    if found.unexplained:
        lines.append(f'! residuals remain against {", ".join(found.unexplained)}: see microbot '
                     'discover')
    return _Found(corrected, summary, lines, lambda path: draw_coils(found, path))
