"""The data types that all rooms exchange: what was measured and commanded, as arrays in SI."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np


@dataclass(frozen=True)
class Tracks:
    """Positions of particles over time, one row per particle and frame; gaps are missing rows.

    Rows are sorted by time. `t` (M,) [s]; `particle` (M,) integer identities; `position` (M, 2)
    [m], x right, y up; `theta` (M,) heading [rad], NaN where it is not known; `sigma` (M,)
    standard deviation of each coordinate [m], NaN where it is not known.
    """

    t: np.ndarray
    particle: np.ndarray
    position: np.ndarray
    theta: np.ndarray
    sigma: np.ndarray

    @property
    def particles(self) -> np.ndarray:
        """The identities present, ascending."""
        return np.unique(self.particle)

    def of(self, particles: int | np.ndarray) -> Tracks:
        """Return the rows of one particle, or of several `particles` (P,)."""
        rows = np.isin(self.particle, particles)
        return Tracks(
            self.t[rows], self.particle[rows], self.position[rows], self.theta[rows],
            self.sigma[rows],
        )

    def grid(self) -> tuple[np.ndarray, np.ndarray]:
        """Frame times (T,) and positions (T, N, 2) in the order of `particles`; NaN for gaps."""
        times, row = np.unique(self.t, return_inverse=True)
        ids, column = np.unique(self.particle, return_inverse=True)
        positions = np.full((len(times), len(ids), 2), np.nan)
        positions[row, column] = self.position
        return times, positions


@dataclass(frozen=True)
class Commands:
    """The commanded field over time; each row holds until the next.

    `t` (K,) [s], ascending; `field` (K, 2) [T] in the plane; for rolling particles `field`
    points in the rolling direction and `frequency` (K,) [Hz] is the rotation frequency, else
    `frequency` is None. `tilt` (K,) [rad] is the angle of the axis of rotation from the vertical;
    None where it lies in the plane throughout. Before the first row nothing is commanded: zero
    field.
    """

    t: np.ndarray
    field: np.ndarray
    frequency: np.ndarray | None = None
    tilt: np.ndarray | None = None

    def index_at(self, t: np.ndarray | float) -> np.ndarray:
        """The row in force at each time; −1 before the first."""
        return np.searchsorted(self.t, t, side='right') - 1

    def field_at(self, t: np.ndarray | float) -> np.ndarray:
        """Commanded field [T] at times of shape (...): (..., 2)."""
        return np.vstack([np.zeros(2), self.field])[self.index_at(t) + 1]

    def frequency_at(self, t: np.ndarray | float) -> np.ndarray:
        """Rotation frequency [Hz] at times of shape (...): (...); zero where there is none."""
        index = self.index_at(t)
        if self.frequency is None:
            return np.zeros(np.shape(index))
        return np.append(0.0, self.frequency)[index + 1]


TimeBase = Literal['elapsed', 'last_interval', 'frames']
"""Divisor of a displacement: the time elapsed, frames times the last interval, or frames."""


@dataclass(frozen=True)
class SpeedWindow:
    """How a laboratory's own tables measure speed: the displacement over the last `frames`
    frames, divided as `base` says.
    """

    frames: int
    base: TimeBase


@dataclass(frozen=True)
class Conditions:
    """What a session knows of its rig, in SI; None where it was not said.

    `propulsion` 'catalytic' or 'rolling'; `radius` [m] of the particles; `viscosity` [Pa·s] and
    `temperature` [K] of the fluid; `frame_rate` [Hz]; `pixel_size` [m] in the workspace;
    `reference_field` [T] at which alignment times are stated; `height` [m] of the particles'
    centres above the floor, more than `radius`.
    """

    propulsion: str = 'catalytic'
    radius: float | None = None
    viscosity: float | None = None
    temperature: float | None = None
    frame_rate: float | None = None
    pixel_size: float | None = None
    reference_field: float | None = None
    height: float | None = None


def height_problem(height_um: float | None, radius_um: float | None) -> str:
    """What is wrong with a height of the centre above the floor, `height_um` [µm], for people.

    '' where nothing is, or where it or the `radius_um` [µm] is not known (None, 0).
    """
    if not (height_um and radius_um) or height_um > radius_um:
        return ''
    return (f'expected height_um to be more than radius_um, {radius_um:g}: it is the height of '
            f'the centre above the floor; received {height_um:g}')


@dataclass(frozen=True)
class Session:
    """One recording: what was seen, what was commanded, under which conditions; its `name`.

    `breaks` (K,) [s], ascending, are where what was seen was joined: nothing is known of the way
    from the last frame before one to the first at or after it. `remarks` are sentences on what is
    not as it should be: data that were cut off. `assumed` are the assumptions of an import, and
    `speed_window` is how the imported tables measure speed.
    """

    tracks: Tracks
    commands: Commands
    conditions: Conditions = field(default_factory=Conditions)
    name: str = ''
    breaks: np.ndarray = field(default_factory=lambda: np.empty(0))
    remarks: tuple[str, ...] = ()
    assumed: tuple[str, ...] = ()
    speed_window: SpeedWindow | None = None
