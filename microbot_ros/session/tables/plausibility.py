"""Check that the numbers of a session are plausible for a rig."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from microbot_ros.common.errors import InputError
from microbot_ros.common.plausible import LONGEST_S, expected_range, implausible
from microbot_ros.common.records import Session
from microbot_ros.common.units import from_si

LARGEST_ID = 2**32 - 1
"""Largest identity that a message can carry."""


def check_session(path: Path, session: Session) -> None:
    """Raise InputError naming `path` and the first implausible number of a `session`.

    NaN, for unknown values, is allowed.

    Parameters
    ----------
    path : Path
        File or folder.
    session : Session
        The session.
    """
    tracks, commands = session.tracks, session.commands
    numbers = {
        't_s': tracks.t, 'x_um': tracks.position[:, 0], 'y_um': tracks.position[:, 1],
        'theta_rad': tracks.theta, 'sigma_um': tracks.sigma, 'field_mT': commands.field,
        'frequency_hz': np.empty(0) if commands.frequency is None else commands.frequency,
    }
    for name, values in numbers.items():
        shown = from_si(name, values[~np.isnan(values)])
        wrong = implausible(name, shown)
        if wrong.any():
            raise InputError(path, f"{expected_range(name)} in '{name}', "
                                   f'found {shown[wrong][0]:g}')
    ids = tracks.particle
    wrong = (ids < 0) | (ids > LARGEST_ID)
    if wrong.any():
        raise InputError(path, f'expected identities from 0 to {LARGEST_ID}, '
                               f'found {ids[wrong][0]}')
    if (length := np.ptp(tracks.t)) > LONGEST_S:
        raise InputError(path, f'expected tracks over at most {LONGEST_S:g} s, found {length:g} s')
