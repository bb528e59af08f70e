"""Heat of the coils, kept in a file so that it survives a restart of the driver."""

from __future__ import annotations

import hashlib
import json
import math
import os
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

from microbot_ros.drive.gate import Currents, Limits

_FOLDER = 'microbot_ros/heat'
_UNSAVED_S = 1.5
"""Longest time [s] by which the file can be behind a driver that was killed. Choice: `save` is
called once a second, and a busy machine may be late by half."""
_FORGOTTEN_S = 86_400.0
"""Age [s] of files that are removed. Choice: a day, as no coil stays warm for 24 times the longest
`thermal_s`."""
_BOOT_ID = Path('/proc/sys/kernel/random/boot_id')


class HeatRecord:
    """The file with the heat of the coils of one amplifier.

    Parameters
    ----------
    url : str
        The amplifier's port or ports. They name the file, in `$XDG_STATE_HOME/microbot_ros/heat`
        (`~/.local/state/…` if that is not set).
    limits : Limits
        Limits of the gate; heat cools with their `thermal_s`.
    channels : int
        Number of coils N.
    """

    def __init__(self, url: str, limits: Limits, channels: int) -> None:
        root = Path(os.environ.get('XDG_STATE_HOME') or Path.home() / '.local/state')
        name = hashlib.sha256(url.encode()).hexdigest()[:16]
        self.path = root / _FOLDER / f'{name}.json'
        self._limits, self._channels = limits, channels

    def load(self) -> Currents:
        """Return the present heat of each coil, as a part of the heat it bears.

        It includes the heat that the driver may have added after the last `save`.

        Returns
        -------
        Currents, shape (N,)
            Zero without a file. 1, the most that the gate lets a coil reach, if the file cannot be
            read or is of other coils.
        """
        try:
            content = json.loads(self.path.read_text())
            heat = [float(value) for value in content['heat']]
            elapsed_s = self._elapsed(content)
        except FileNotFoundError:
            return (0.0,) * self._channels
        except (OSError, ValueError, KeyError, TypeError):
            return (1.0,) * self._channels
        valid = len(heat) == self._channels and all(0.0 <= value < math.inf for value in heat)
        if not (valid and elapsed_s >= 0.0):
            return (1.0,) * self._channels
        most = (self._limits.current_A / self._limits.rated_current_A) ** 2
        kept = math.exp(-_UNSAVED_S / self._limits.thermal_s)
        cooled = math.exp(-max(elapsed_s - _UNSAVED_S, 0.0) / self._limits.thermal_s)
        return tuple(cooled * max(value, value * kept + most * (1.0 - kept)) for value in heat)

    def save(self, heat: Currents) -> None:
        """Write the heat in one atomic step.

        Parameters
        ----------
        heat : Currents, shape (N,)
            Heat of each coil, as a part of the heat it bears.

        Raises
        ------
        OSError
            If the file cannot be written.
        """
        self.path.parent.mkdir(parents=True, exist_ok=True)
        content = {'heat': heat, 'wall_s': time.time(), 'boot_id': _boot_id(),
                   'boot_s': time.clock_gettime(time.CLOCK_BOOTTIME)}
        draft = self.path.with_suffix('.tmp')
        try:
            draft.write_text(json.dumps(content))
            draft.replace(self.path)
        except OSError:
            with suppress(OSError):  # what is there is too cold; an empty file counts as the most
                self.path.write_bytes(b'')
            raise

    def forget_old(self) -> None:
        """Remove files of any amplifier that were not written for a day."""
        for path in self.path.parent.glob('*.json'):
            with suppress(OSError):
                if time.time() - path.stat().st_mtime > _FORGOTTEN_S:
                    path.unlink()

    def _elapsed(self, content: dict[str, Any]) -> float:
        """Return the time since the file was written [s].

        Within one boot by the boot's clock, across boots by the wall clock.
        """
        if content['boot_id'] == _boot_id():
            return time.clock_gettime(time.CLOCK_BOOTTIME) - float(content['boot_s'])
        return time.time() - float(content['wall_s'])


def _boot_id() -> str:
    try:
        return _BOOT_ID.read_text().strip()
    except OSError:
        return ''
