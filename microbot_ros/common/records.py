"""Data exchanged between all rooms: measurements and commands as arrays in SI units."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np


@dataclass(frozen=True)
class Tracks:
    """Positions of particles over time, sorted by time; one row per particle and frame.

    Gaps are missing rows.

    Attributes
    ----------
    t : (M,) array [s]
    particle : (M,) int array
        Identities.
    position : (M, 2) array [m]
        x right, y up.
    theta : (M,) array [rad]
        Heading, NaN if unknown.
    sigma : (M,) array [m]
        Standard deviation of each coordinate, NaN if unknown.
    """

    t: np.ndarray
    particle: np.ndarray
    position: np.ndarray
    theta: np.ndarray
    sigma: np.ndarray

    @cached_property
    def particles(self) -> np.ndarray:
        """Identities present, ascending."""
        return np.unique(self.particle)

    def of(self, particles: int | np.ndarray) -> Tracks:
        """Return the rows of one particle, or of several `particles` (P,).

        Parameters
        ----------
        particles : int or ndarray
            Identity of one particle, or identities (P,).

        Returns
        -------
        Tracks
            Rows of these.
        """
        return self.rows(np.isin(self.particle, particles))

    def rows(self, chosen: np.ndarray | slice) -> Tracks:
        """Return the `chosen` rows.

        Parameters
        ----------
        chosen : ndarray or slice
            Mask (M,) or indices of the rows.

        Returns
        -------
        Tracks
            These rows.
        """
        return Tracks(self.t[chosen], self.particle[chosen], self.position[chosen],
                      self.theta[chosen], self.sigma[chosen])

    def grid(self) -> tuple[np.ndarray, np.ndarray]:
        """Return frame times (T,) and positions (T, N, 2) by `particles`, NaN in gaps.

        Returns
        -------
        tuple[ndarray, ndarray]
            Times (T,) [s] and positions (T, N, 2) [m].
        """
        times, row = np.unique(self.t, return_inverse=True)
        ids, column = np.unique(self.particle, return_inverse=True)
        positions = np.full((len(times), len(ids), 2), np.nan)
        positions[row, column] = self.position
        return times, positions


@dataclass(frozen=True)
class Commands:
    """Commanded field over time; each row holds until the next, before the first it is zero.

    Attributes
    ----------
    t : (K,) array [s]
        Ascending.
    field : (K, 2) array [T]
        Field in the plane; for rolling particles it points in the rolling direction.
    frequency : (K,) array [Hz] or None
        Rotation frequency of a rolling field.
    tilt : (K,) array [rad] or None
        Angle of the axis of rotation from the vertical; None if the axis always lies in the plane.
    """

    t: np.ndarray
    field: np.ndarray
    frequency: np.ndarray | None = None
    tilt: np.ndarray | None = None

    def index_at(self, t: np.ndarray | float) -> np.ndarray:
        """Return the row in force at each time `t`; −1 before the first.

        Parameters
        ----------
        t : ndarray or float
            Times, of any shape [s].

        Returns
        -------
        ndarray
            Row numbers, of the same shape.
        """
        return np.searchsorted(self.t, t, side='right') - 1

    def field_at(self, t: np.ndarray | float) -> np.ndarray:
        """Return the field [T] at times `t` of shape (...), shape (..., 2).

        Parameters
        ----------
        t : ndarray or float
            Times, of any shape [s].

        Returns
        -------
        ndarray, shape (..., 2)
            Field [T].
        """
        return np.vstack([np.zeros(2), self.field])[self.index_at(t) + 1]

    def frequency_at(self, t: np.ndarray | float) -> np.ndarray:
        """Return the rotation frequency [Hz] at times `t` (...); 0 without rotation.

        Parameters
        ----------
        t : ndarray or float
            Times, of any shape [s].

        Returns
        -------
        ndarray
            Frequency [Hz], of the same shape.
        """
        index = self.index_at(t)
        if self.frequency is None:
            return np.zeros(np.shape(index))
        return np.append(0.0, self.frequency)[index + 1]


TimeBase = Literal['elapsed', 'last_interval', 'frames']
"""Divisor of a displacement: time elapsed, frames × last interval, or number of frames."""


@dataclass(frozen=True)
class SpeedWindow:
    """Definition of speed in a laboratory's tables.

    It is the displacement over the last `frames` frames, divided by the `base`.
    """

    frames: int
    base: TimeBase


@dataclass(frozen=True)
class Conditions:
    """Known conditions of a session, in SI; None if unknown.

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
    """Return a message if `height_um` is not more than `radius_um` [µm], else ''.

    '' also if either is unknown (None or 0).

    Parameters
    ----------
    height_um : float or None
        Height above the floor [µm]; None or 0 for unknown.
    radius_um : float or None
        Radius of the particles [µm]; None or 0 for unknown.

    Returns
    -------
    str
        The message, or ''.
    """
    if not (height_um and radius_um) or height_um > radius_um:
        return ''
    return (f'expected height_um to be more than radius_um, {radius_um:g}: it is the height of '
            f'the centre above the floor; received {height_um:g}')


@dataclass(frozen=True)
class Session:
    """One recording: tracks, commands and conditions.

    Attributes
    ----------
    tracks : Tracks
    commands : Commands
    conditions : Conditions
    name : str
    breaks : (K,) array [s]
        Ascending times at which recordings were joined: the motion from the last frame before one
        to the first at or after it is unknown.
    remarks : tuple of str
        Sentences about defects, such as data that were cut off.
    assumed : tuple of str
        Assumptions of an import.
    speed_window : SpeedWindow or None
        Definition of speed in the imported tables.
    """

    tracks: Tracks
    commands: Commands
    conditions: Conditions = field(default_factory=Conditions)
    name: str = ''
    breaks: np.ndarray = field(default_factory=lambda: np.empty(0))
    remarks: tuple[str, ...] = ()
    assumed: tuple[str, ...] = ()
    speed_window: SpeedWindow | None = None
