"""Play a timed list of field directions, whatever the particles do."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from microbot_ros.common import units
from microbot_ros.common.records import Commands
from microbot_ros.common.settings import setting
from microbot_ros.control.contract import (
    Controller,
    ControllerInput,
    FieldCommand,
    Input,
    Limits,
    NoSolutionError,
    Progress,
    no_field,
)


@dataclass(frozen=True)
class OpenLoopParameters:
    """Either the two lists or a file."""

    directions_deg: list[float] = setting(
        [0.0, 120.0, 240.0], 'Directions of the field, in sequence.')
    durations_s: list[float] = setting(
        [2.0, 2.0, 2.0], 'Time that each direction is held.', lower=0.01, upper=3600.0)
    field_mT: float = setting(5.0, 'Strength of the field.', lower=0.0, upper=100.0)
    frequency_hz: float = setting(
        0.0, 'Rotation frequency for rollers.', lower=0.0, upper=1000.0)
    file: str = setting(
        '', 'A commands.csv to play instead: t_s and bx_mT,by_mT or direction_rad,frequency_hz.')
    repeat: bool = setting(False, 'Begin again at the end.')


class OpenLoop(Controller):
    """Each row of the list holds until the next; after the last one the field is zero."""

    interface_version = 1
    summary = 'Play a timed list of field directions.'
    takes = frozenset[Input]()
    Parameters = OpenLoopParameters

    def __init__(self) -> None:
        super().__init__()
        self._commands, self._length = _from_lists(self.parameters)
        self._begun: float | None = None

    def configure(self, parameters: Any) -> None:
        """Read the list of `parameters`.

        Raises InputError naming file and line for a faulty file.
        """
        read = _from_file if parameters.file else _from_lists
        self._commands, self._length = read(parameters)
        super().configure(parameters)

    def activate(self, inputs: ControllerInput) -> None:
        """Start the list; NoSolutionError if it exceeds the limits of `inputs`."""
        check_limits(self._commands, inputs.limits)
        self._begun = inputs.t

    def compute(self, inputs: ControllerInput) -> FieldCommand:
        """Return the present row of the list for `inputs`."""
        check_limits(self._commands, inputs.limits)
        if self._begun is None:
            self._begun = inputs.t
        elapsed = inputs.t - self._begun
        if self.parameters.repeat:
            elapsed %= self._length
        elif elapsed < 0:  # the clock was set back: it must not go on by itself one day
            self._begun, elapsed = -math.inf, math.inf
        if elapsed >= self._length:
            return no_field('the list has been played', done=True)
        progress = Progress(f'{elapsed:.1f} of {self._length:.1f} s')
        field, frequency = self._commands.field_at(elapsed), self._commands.frequency_at(elapsed)
        return FieldCommand(field, float(frequency), progress)

    def reset(self) -> None:
        """Start the list again at the next tick."""
        self._begun = None


def _from_lists(parameters: OpenLoopParameters) -> tuple[Commands, float]:
    angles = units.to_si('directions_deg', np.array(parameters.directions_deg))
    durations = np.array(parameters.durations_s)
    if len(angles) != len(durations) or not len(angles):
        raise ValueError(f'expected one duration per direction; received {len(angles)} '
                         f'directions_deg and {len(durations)} durations_s')
    starts = np.cumsum(durations) - durations
    strength = units.to_si('field_mT', parameters.field_mT)
    field = strength * np.column_stack((np.cos(angles), np.sin(angles)))
    frequency = np.full(len(angles), parameters.frequency_hz)
    return Commands(starts, field, frequency), float(durations.sum())


def _from_file(parameters: OpenLoopParameters) -> tuple[Commands, float]:
    from microbot_ros.common.tables import Layout, read_table

    table = read_table(
        Path(parameters.file), Layout(('t_s', 'bx_mT', 'by_mT')),
        Layout(('t_s', 'direction_rad', 'frequency_hz')))
    t = table.columns['t_s'] - table.columns['t_s'][0]
    table.refuse(np.diff(t, prepend=-1.0) <= 0, 'expected ascending times')
    last = np.diff(t)[-1] if len(t) > 1 else 1.0
    if 'bx_mT' in table.columns:
        field = np.column_stack((table.columns['bx_mT'], table.columns['by_mT']))
        return Commands(t, field), float(t[-1] + last)
    angle = table.columns['direction_rad']
    strength = units.to_si('field_mT', parameters.field_mT)
    field = strength * np.column_stack((np.cos(angle), np.sin(angle)))
    return Commands(t, field, table.columns['frequency_hz']), float(t[-1] + last)


def check_limits(commands: Commands, limits: Limits) -> None:
    """Raise NoSolutionError if `commands` exceed the `limits`.

    Parameters
    ----------
    commands : Commands
        The commands.
    limits : Limits
        The limits.
    """
    strongest = float(np.hypot(*commands.field.T).max())
    if not strongest <= limits.field * (1 + 1e-9):
        raise NoSolutionError(f'the list asks for {strongest * 1e3:g} mT; '
                              f'the limit is {limits.field * 1e3:g} mT')
    fastest = 0.0 if commands.frequency is None else float(commands.frequency.max())
    if not fastest <= limits.frequency:
        raise NoSolutionError(f'the list asks for {fastest:g} Hz; '
                              f'the limit is {limits.frequency:g} Hz')
