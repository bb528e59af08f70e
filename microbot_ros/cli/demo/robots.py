"""Robots of the demo, and the parameters of the rig for each kind."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from microbot_ros.common.files import write_text
from microbot_ros.magnetics.settings import CoilSettings, Winding
from microbot_ros.model.io.model_file import write_model
from microbot_ros.model.model import Model, ParticleParameters

_FIELD_T = 5e-3
"""Reference field [T], that of the paper."""
_LEARN_HZ = 2.0
"""Rotation frequency [Hz] while the particles are estimated. Choice: far below their step-out."""


@dataclass(frozen=True)
class Robots:
    """A kind of robots.

    Attributes
    ----------
    controller : str
        Controller that steers them.
    turns_per_s : float
        Rotations of the field per second on the way, a factor on speeds per rotation.
    unit : str
        Unit of their speed.
    nodes : dict[str, dict of str to object]
        Parameters of nodes beyond the common ones.
    emulator : list of str
        Options of the emulator beyond the common ones.
    """

    controller: str
    turns_per_s: float
    unit: str
    nodes: dict[str, dict[str, Any]]
    emulator: list[str] = field(default_factory=list)


def catalytic(_: Path) -> Robots:
    """Return swimmers in the plane field of four coils: the paper's three particles and one more.

    Returns
    -------
    Robots
        The robots.
    """
    return Robots('waypoint', 1.0, 'µm/s', {'virtual_rig': {
        'speeds_um_s': [3.71, 4.38, 4.98, 4.1], 'phis_rad': [-1.09, 3.82, 2.64, 0.6]}})


def rolling(folder: Path) -> Robots:
    """Return rollers on a floor, in a field that three pairs of coils rotate.

    It writes the coils, and a model of rolling particles.

    Parameters
    ----------
    folder : Path
        Folder of the files.

    Returns
    -------
    Robots
        The robots.
    """
    coils, model = folder / 'coils.yaml', folder / 'model.yaml'
    write_text(coils, yaml.safe_dump({'coils': three_pairs().content()}))
    write_model(model, Model(_FIELD_T, 'rolling'),
                ParticleParameters(np.empty(0, int), np.empty(0), np.empty(0)))
    return Robots('roller', 3.0, 'µm/s/Hz', {
        'virtual_rig': {'gains_um_s_hz': [3.2, 2.6, 3.9, 2.2], 'phis_rad': [0.3, -0.4, 0.1, 0.6],
                        'alignment_ms': 1.0, 'coils_file': str(coils)},
        'tracker': {'field_source': 'rotation'},
        'model': {'propulsion': 'rolling'},
        'controller': {'model_file': str(model), 'open_loop.frequency_hz': _LEARN_HZ},
        'coil_driver': {'coils_file': str(coils)}}, ['--channels', '6'])


KINDS = {'catalytic': catalytic, 'rolling': rolling}


def three_pairs() -> CoilSettings:
    """Return the four coils of the default rig and two like them above and below.

    Returns
    -------
    CoilSettings
        The coils.
    """
    plane = CoilSettings()
    above = [Winding.from_content({
        **plane.windings[0].content(), 'name': name, 'position_mm': (0.0, 0.0, z),
        'axis': (0.0, 0.0, z)}) for name, z in (('coil_plus_z', 30.0), ('coil_minus_z', -30.0))]
    return CoilSettings(windings=(*plane.windings, *above))
