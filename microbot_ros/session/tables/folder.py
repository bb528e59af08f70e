"""A session as a folder: `tracks.csv`, `commands.csv`, `session.yaml`."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
import yaml

from microbot_ros.common.checked import Field, PositiveFloat, Settings, SettingsError
from microbot_ros.common.errors import InputError
from microbot_ros.common.files import output_folder, read_yaml
from microbot_ros.common.plausible import LONGEST_S
from microbot_ros.common.records import (
    Commands,
    Conditions,
    Session,
    SpeedWindow,
    TimeBase,
    Tracks,
    height_problem,
)
from microbot_ros.common.tables import Layout, Table, read_table, write_table
from microbot_ros.common.units import exact_display, exact_si
from microbot_ros.session.tables.plausibility import LARGEST_ID

NOMINAL_FIELD = 1e-3
"""Choice: field [T] given to a rolling field if a session states none.

Only its direction and frequency are known then.
"""

FILES = ('tracks.csv', 'commands.csv', 'session.yaml')
"""Files of a session."""

# `sigma_um` and `field_mT` preserve data of recordings; the columns in pixels are for people.
TRACKS = Layout(
    ('t_s', 'particle', 'x_um', 'y_um'), ('theta_rad', 'sigma_um'),
    ('frame', 'x_px', 'y_px', 'kind'),
)
UNIFORM = Layout(('t_s', 'bx_mT', 'by_mT'))
ROLLING = Layout(('t_s', 'direction_rad', 'frequency_hz'), ('field_mT', 'tilt_rad'))

_SUFFIXED = {
    'radius': 'radius_um', 'viscosity': 'viscosity_mPa_s', 'temperature': 'temperature_K',
    'frame_rate': 'frame_rate_hz', 'pixel_size': 'pixel_size_um',
    'reference_field': 'reference_field_mT', 'height': 'height_um',
}


class SessionFile(Settings):
    """`session.yaml`; all keys are optional."""

    propulsion: Literal['catalytic', 'rolling'] | None = None
    radius_um: PositiveFloat | None = None
    viscosity_mPa_s: PositiveFloat | None = None
    temperature_K: PositiveFloat | None = None
    frame_rate_hz: PositiveFloat | None = None
    pixel_size_um: PositiveFloat | None = None
    reference_field_mT: PositiveFloat | None = None
    height_um: PositiveFloat | None = None
    speed_window_frames: int | None = Field(default=None, ge=1, le=10_000)
    speed_window_base: TimeBase = 'elapsed'
    assumed: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if problem := height_problem(self.height_um, self.radius_um):
            raise SettingsError(problem, 'height_um')

    def conditions(self, rolling: bool) -> Conditions:
        """Return the conditions in SI; `rolling` commands replace a missing propulsion.

        Parameters
        ----------
        rolling : bool
            Whether the commands are those of rollers.

        Returns
        -------
        Conditions
            The conditions.
        """
        values = {
            name: exact_si(key, value)
            for name, key in _SUFFIXED.items() if (value := getattr(self, key)) is not None
        }
        propulsion = self.propulsion or ('rolling' if rolling else 'catalytic')
        return Conditions(propulsion=propulsion, **values)

    @property
    def speed_window(self) -> SpeedWindow | None:
        """Definition of speed in the tables from which the session was imported."""
        if self.speed_window_frames is None:
            return None
        return SpeedWindow(self.speed_window_frames, self.speed_window_base)


def session_text(session: Session) -> str:
    """Return the content of `session.yaml` for a `session`.

    Parameters
    ----------
    session : Session
        The session.

    Returns
    -------
    str
        YAML.
    """
    conditions = session.conditions
    content: dict[str, object] = {'propulsion': conditions.propulsion}
    for name, key in _SUFFIXED.items():
        if (value := getattr(conditions, name)) is not None:
            content[key] = float(exact_display(key, value))
    if (window := session.speed_window) is not None:
        content |= {'speed_window_frames': window.frames, 'speed_window_base': window.base}
    if session.assumed:
        content['assumed'] = list(session.assumed)
    return yaml.safe_dump(content, sort_keys=False, allow_unicode=True, width=1000)


def read_folder(path: Path) -> Session:
    """Read the session in the folder `path`; without `commands.csv` nothing was commanded.

    Raises InputError (file, line, expectation) for wrong columns, text instead of numbers, times
    that go back, a particle twice at one time, and commands that begin after the tracks have
    ended.

    Parameters
    ----------
    path : Path
        File or folder.

    Returns
    -------
    Session
        The session.
    """
    if not (path / 'tracks.csv').is_file():
        inside = [item.name for item in sorted(path.iterdir()) if any(item.glob('*.mcap'))]
        hint = f'; {inside[0]} in it is one' if inside else ''
        raise InputError(
            path, f'expected a session: a folder with tracks.csv, or a recording{hint}')
    tracks = _read_tracks(path / 'tracks.csv')
    table = None
    if (path / 'commands.csv').exists():
        table = read_table(path / 'commands.csv', UNIFORM, ROLLING)
    settings = SessionFile()
    if (path / 'session.yaml').exists():
        settings = read_yaml(path / 'session.yaml', SessionFile)
    conditions = settings.conditions(table is not None and table.layout is ROLLING)
    if table is None:
        commands = Commands(np.empty(0), np.empty((0, 2)))
    else:
        _check_times(table, tracks)
        commands = _commands(table, conditions)
    return Session(tracks, commands, conditions, path.resolve().name,
                   assumed=settings.assumed, speed_window=settings.speed_window)


def write_session(path: str | Path, session: Session) -> None:
    """Write `session` to `path` as `tracks.csv`, `commands.csv`, `session.yaml`, all or none.

    `read_session` restores the numbers bit for bit, except for the components of a rolling field,
    which pass through its direction.

    Parameters
    ----------
    path : str or Path
        Folder to write.
    session : Session
        The session.
    """
    path, tracks, commands = Path(path), session.tracks, session.commands
    measured = {'t_s': tracks.t, 'x_um': tracks.position[:, 0], 'y_um': tracks.position[:, 1]}
    if not len(tracks.t) or not all(np.isfinite(column).all() for column in measured.values()):
        raise ValueError('a session needs tracks, and every row of them a time and a position')
    table = {'t_s': tracks.t, 'particle': tracks.particle.astype(np.int64), **measured}
    for name, column in {'theta_rad': tracks.theta, 'sigma_um': tracks.sigma}.items():
        if np.isfinite(column).any():
            table[name] = column
    with output_folder(path, FILES) as folder:
        write_table(folder / 'tracks.csv', table)
        if len(commands.t):
            write_table(folder / 'commands.csv', _command_columns(session))
        (folder / 'session.yaml').write_text(
            session_text(session), encoding='utf-8')


def _read_tracks(path: Path) -> Tracks:
    table = read_table(path, TRACKS)
    columns = table.columns
    t, particle = columns['t_s'], columns['particle']
    whole = (particle == np.floor(particle)) & (particle >= 0) & (particle <= LARGEST_ID)
    table.refuse(~whole, f"expected a whole number from 0 to {LARGEST_ID} in 'particle'")
    table.refuse(np.abs(t - t.min()) > LONGEST_S,
                 f'expected times within {LONGEST_S:g} s of the first')
    # Files may list frame by frame or particle by particle: times ascend for each particle.
    by_particle = np.argsort(particle, kind='stable')
    step, same = np.diff(t[by_particle]), np.diff(particle[by_particle]) == 0
    back, twice = np.zeros(len(t), bool), np.zeros(len(t), bool)
    back[by_particle[1:]] = same & (step < 0)
    twice[by_particle[1:]] = same & (step == 0)
    table.refuse(back, 'expected ascending times of a particle, found an earlier time')
    table.refuse(twice, 'expected one row per particle and time, found a second')
    order = np.lexsort((particle, t))
    unknown = np.full(len(t), np.nan)
    return Tracks(
        t[order], particle[order].astype(np.int64),
        np.column_stack([columns['x_um'], columns['y_um']])[order],
        columns.get('theta_rad', unknown)[order], columns.get('sigma_um', unknown)[order],
    )


def _check_times(table: Table, tracks: Tracks) -> None:
    t = table.columns['t_s']
    step = np.diff(t, prepend=-np.inf)
    table.refuse(step < 0, 'expected ascending times, found an earlier time')
    table.refuse(step == 0, 'expected one row per time, found a second')
    table.refuse(np.abs(t - tracks.t[0]) > LONGEST_S,
                 f'expected times within {LONGEST_S:g} s of the first of the tracks')
    late = np.zeros(len(t), bool)
    late[0] = t[0] > tracks.t[-1]
    table.refuse(late, f'expected commands before the tracks end at {tracks.t[-1]:g} s')


def _commands(table: Table, conditions: Conditions) -> Commands:
    columns = table.columns
    t = columns['t_s']
    if table.layout is UNIFORM:
        return Commands(t, np.column_stack([columns['bx_mT'], columns['by_mT']]))
    nominal = conditions.reference_field or NOMINAL_FIELD
    magnitude = columns.get('field_mT', np.full(len(t), nominal))
    magnitude = np.where(np.isnan(magnitude), nominal, magnitude)
    angle = columns['direction_rad']
    unit = np.column_stack([np.cos(angle), np.sin(angle)])
    tilt = columns.get('tilt_rad')
    return Commands(t, magnitude[:, None] * unit, columns['frequency_hz'],
                    None if tilt is None else np.where(np.isnan(tilt), np.pi / 2, tilt))


def _command_columns(session: Session) -> dict[str, np.ndarray]:
    commands = session.commands
    bx, by = commands.field.T
    if commands.frequency is None:
        return {'t_s': commands.t, 'bx_mT': bx, 'by_mT': by}
    columns = {
        't_s': commands.t, 'direction_rad': np.arctan2(by, bx), 'frequency_hz': commands.frequency,
    }
    magnitude = np.hypot(bx, by)
    if not np.allclose(magnitude, session.conditions.reference_field or NOMINAL_FIELD, rtol=1e-9):
        columns['field_mT'] = magnitude
    if commands.tilt is not None:
        columns['tilt_rad'] = commands.tilt
    return columns
