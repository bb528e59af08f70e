"""Command `microbot calibrate camera`: the transform from pixels to the workspace."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from microbot_ros.cli.options import NEW_FOLDER, PATH, force_option, json_option
from microbot_ros.common.errors import InputError
from microbot_ros.common.plausible import plausible_range
from microbot_ros.common.units import from_si, to_si

if TYPE_CHECKING:
    from microbot_ros.estimation.camera_turn import CameraTurn
    from microbot_ros.tracking.graticule import Graticule


_OUTPUTS = ('camera.yaml', 'calibration.json', 'calibration.png')


@dataclass(frozen=True)
class CameraPart:
    """Parameters of the tracker for a rig's file; None for those that are unknown.

    Attributes
    ----------
    pixel_size : float or None
        Size of a pixel [m].
    rotation : float or None
        Rotation of the picture [rad].
    mirrored : bool or None
        Whether the picture is mirrored.
    lines : tuple of str
        Text on the origin of each number.
    """

    pixel_size: float | None = None
    rotation: float | None = None
    mirrored: bool | None = None
    lines: tuple[str, ...] = ()

    def say(self, line: str) -> CameraPart:
        """Return the same parameters with one more line of text.

        Parameters
        ----------
        line : str
            The line.

        Returns
        -------
        CameraPart
            The parameters.
        """
        return replace(self, lines=(*self.lines, line))

    def as_yaml(self) -> str:
        """Return a file for `microbot run --config`, or a section of one.

        Returns
        -------
        str
            YAML with comments.
        """
        said = ''.join(f'# {line}\n' for line in self.lines)
        values = ''.join(f'    {name}: {json.dumps(value)}\n'
                         for name, value in self.as_parameters().items() if value is not None)
        return f'{said}tracker:\n  ros__parameters:\n{values}'

    def as_parameters(self) -> dict[str, float | bool | None]:
        """Return the parameters by the names that the node uses.

        Returns
        -------
        dict of str to float or bool or None
            Values by name.
        """
        return {
            'pixel_size_um': _rounded(
                None if self.pixel_size is None else from_si('_um', self.pixel_size)),
            'rotation_deg': _rounded(
                None if self.rotation is None else math.degrees(self.rotation)),
            'mirrored': self.mirrored}


def _rounded(value: float | None) -> float | None:
    return None if value is None else float(f'{value:.6g}')


@click.command('camera')
@click.argument('session', required=False, type=PATH)
@click.option('--out', type=NEW_FOLDER, required=True, metavar='DIR',
              help='Folder for camera.yaml, calibration.json and calibration.png.')
@click.option('--graticule', type=PATH, metavar='PICTURE',
              help='Picture of a stage micrometer or grating: evenly spaced lines.')
@click.option('--spacing-um', type=float,
              help='Distance between neighbouring lines of the graticule.')
@click.option('--along-coils', is_flag=True,
              help='The graticule lies along the coils: its angle is the rotation.')
@click.option('--particles', metavar='SOURCE',
              help='Video or images of particles of a known size, in place of a graticule; '
                   'accurate to one pixel of the diameter.')
@click.option('--diameter-um', type=float, help='Their diameter.')
@click.option('--phi-deg', type=float,
              help='Angle from the field to the motion of every particle, if known (0 for '
                   'rollers); otherwise it is taken as zero on average.')
@click.option('--config', type=PATH,
              help="Rig's YAML with which SESSION was recorded (else the default tracker).")
@force_option
@json_option('Write the result as JSON to this file.')
def camera(
    session: Path | None, out: Path, graticule: Path | None, spacing_um: float | None,
    along_coils: bool, particles: str | None, diameter_um: float | None, phi_deg: float | None,
    config: Path | None, force: bool, json_path: Path | None,
) -> None:
    """Find pixel size, rotation and mirroring of the camera relative to the coils.

    SESSION, a folder or a recording, has particles under known commands in all directions. The
    sense in which they turn shows whether the picture is mirrored. The rotation is not determined
    by motion alone, since each particle moves at its own angle φ to the field: it is chosen so
    that φ is zero on average, and only if the particles have a direction in common. State φ
    (--phi-deg) if it is known, or align the graticule with the coils.

    A picture of a graticule gives the pixel size. camera.yaml is the tracker's section of the
    rig's file; values that were not measured are those of --config, or left out. `microbot track`
    makes a session from a video, with commands.csv beside its tracks.csv.

    \b
    Examples:
      microbot calibrate camera --graticule lines.png --spacing-um 10 --out out/camera
      microbot calibrate camera recordings/monday --config rig.yaml --out out/camera
      microbot calibrate camera rollers/ --phi-deg 0 --out out/camera
    """
    from microbot_ros.cli.calibrate.figures import draw_camera
    from microbot_ros.common.files import (
        output_folder,
        refuse_to_overwrite,
        write_json,
        write_text,
    )

    refuse_to_overwrite(out, _OUTPUTS, force)
    if not (session or graticule or particles):
        raise InputError('calibrate camera', 'expected a SESSION, --graticule or --particles')
    spacing = _length('--spacing-um', spacing_um, '--graticule', graticule)
    diameter = _length('--diameter-um', diameter_um, '--particles', particles)
    _refuse(session, graticule, along_coils, particles, phi_deg)
    part = _read(config) if config else CameraPart()
    result: dict[str, Any] = {}
    turn = image = lines = None
    if session:
        part, turn = _by_motion(part, session, phi_deg, result)
    if graticule:
        part, image, lines = _by_graticule(part, graticule, spacing, along_coils, result)
    if particles:
        part = _by_size(part, particles, diameter, result)
    result |= part.as_parameters() | {'notes': list(part.lines)}
    with output_folder(out, _OUTPUTS) as folder:
        write_text(folder / 'camera.yaml', part.as_yaml())
        write_json(folder / 'calibration.json', result)
        if turn or lines:
            draw_camera(folder / 'calibration.png', turn, image, lines)
    write_json(json_path, result)
    for line in [*part.lines, f'written to {out}']:
        click.echo(line)


def _refuse(session: Path | None, graticule: Path | None, along_coils: bool,
            particles: str | None, phi_deg: float | None) -> None:
    """Raise InputError for options that contradict each other."""
    if graticule and particles:
        raise InputError('--particles', 'expected one of --graticule and --particles')
    if along_coils and not graticule:
        raise InputError('--along-coils', 'expected with --graticule')
    if phi_deg is not None and not (session and -180 <= phi_deg <= 180):
        raise InputError('--phi-deg', f'expected −180 to 180 with a SESSION; received {phi_deg}')


def _length(name: str, value_um: float | None, of: str, given: object) -> float:
    """Return a length [m] that must be given exactly if another option is; else 0."""
    if (value_um is None) != (given is None):
        raise InputError(name, f'expected together with {of}')
    if value_um is not None and not 0 < value_um <= plausible_range('_um')[1]:
        raise InputError(name, f'expected a positive length; received {value_um}')
    return to_si('_um', value_um or 0.0)


def _read(config: Path) -> CameraPart:
    from microbot_ros.nodes.configuration import read_rig

    known = read_rig(config).get('tracker', {})
    size, rotation = known.get('pixel_size_um'), known.get('rotation_deg')
    return CameraPart(
        None if size is None else to_si('_um', size),
        None if rotation is None else to_si('_deg', rotation), known.get('mirrored'))


def _by_motion(
    part: CameraPart, path: Path, phi_deg: float | None, result: dict[str, Any],
) -> tuple[CameraPart, CameraTurn]:
    from microbot_ros.estimation.camera_turn import camera_turn
    from microbot_ros.session import read_session

    turn = camera_turn(read_session(path), None if phi_deg is None else math.radians(phi_deg))
    rotation, mirrored = turn.corrected(part.rotation or 0.0, part.mirrored or False)
    if turn.known or part.rotation is not None:
        part = replace(part, rotation=rotation)
    part = replace(part, mirrored=mirrored)
    interval = math.degrees(turn.interval) if turn.known else None
    result['motion'] = {
        'particles': len(turn.ids), 'log_odds': turn.log_odds,
        'picture_turned_the_other_way': turn.mirrored, 'phi_known': turn.phi_known,
        'rotation_interval_95_deg': interval}
    if turn.mirrored:
        part = part.say(
            'particles turn against the command: the image is mirrored, or one pair of coils is '
            f'reversed, or x and y are swapped; mirrored is now {str(mirrored).lower()} (log odds '
            f'{turn.log_odds:.0f})')
    else:
        part = part.say(f'particles turn with the command (log odds {turn.log_odds:.0f})')
    if interval is None:
        return part.say(
            f'rotation not found: {len(turn.ids)} particle(s) have no common direction, as '
            'each has its own φ; give --phi-deg, or align a graticule with the coils '
            '(--along-coils)'), turn
    convention = 'φ as stated' if turn.phi_known else 'φ taken as zero on average'
    return part.say(f'rotation {math.degrees(rotation):.2f} ± {interval:.2g}° (95 %) from '
                    f'{len(turn.ids)} particles, {convention}'), turn


def _by_graticule(
    part: CameraPart, path: Path, spacing: float, along_coils: bool, result: dict[str, Any],
) -> tuple[CameraPart, np.ndarray, Graticule]:
    from microbot_ros.cameras.source import read_picture
    from microbot_ros.tracking.graticule import measure_graticule

    image = read_picture(path)
    found = measure_graticule(image, str(path))
    size = spacing / found.period_px
    std = size * found.period_std_px / found.period_px
    angle, angle_std = math.degrees(found.angle), math.degrees(found.angle_std)
    result['graticule'] = {
        'period_px': found.period_px, 'period_std_px': found.period_std_px,
        'pixel_size_std_um': from_si('_um', std), 'angle_deg': angle, 'angle_std_deg': angle_std}
    part = replace(part, pixel_size=size).say(
        f'pixel size {from_si("_um", size):.5g} ± {from_si("_um", 1.96 * std):.1g} µm (95 %) from '
        f'{found.period_px:.2f} px per line')
    if not along_coils:
        return part, image, found
    # The quarter turn nearest to the known rotation.
    before = part.rotation or 0.0
    square = (found.angle if part.mirrored else -found.angle) + before
    rotation = before - math.remainder(square, math.pi / 2)
    return replace(part, rotation=math.remainder(rotation, math.tau)).say(
        f'rotation {math.degrees(rotation):.3f} ± {1.96 * angle_std:.1g}° (95 %) from the '
        'graticule aligned with the coils'), image, found


def _by_size(
    part: CameraPart, source: str, diameter: float, result: dict[str, Any],
) -> CameraPart:
    from microbot_ros.cameras.source import open_source
    from microbot_ros.tracking import TrackerSettings
    from microbot_ros.tracking.teach.learn import learn_first

    appearance = learn_first(
        (frame.image for frame in open_source(source, lambda _: None).frames()), TrackerSettings())
    if appearance is None:
        raise InputError(source, 'expected particles; nothing stands out of the noise')
    size = diameter / appearance.diameter_px
    result['particles'] = {'diameter_px': appearance.diameter_px}
    return replace(part, pixel_size=size).say(
        f'pixel size {from_si("_um", size):.3g} ± {100 / appearance.diameter_px:.0f} % from a '
        f'diameter of {appearance.diameter_px:.1f} px, accurate to one pixel')
