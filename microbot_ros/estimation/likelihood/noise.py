"""Noise of tracks by diffusion, localisation error and exposure, and its exact whitening.

A particle diffuses with D. Each position is read with a standard deviation σ per axis, from an
exposure of duration E during which the particle moves on. An increment over an interval h then
has, per axis, variance 2Dh + 2σ² − 2DE/3 and covariance −σ² + DE/3 with its neighbour (Berglund
2010; E = 0 is a strobe, E = h a full frame, his R = 1/6). That is a local level observed with
variance σ² − DE/3. The Kalman gain of the local-level model therefore whitens increments exactly,
in one pass, across unequal intervals and gaps. All that is linear in unknowns may pass the same
filter.

Positions are whitened, and for a column of the model the displacement accumulated since the start
of the recording. Gaps then need no care: a missing row is a row not used.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ros.common.records import Conditions
from microbot_ros.model.physics.floor import height_of_drag
from microbot_ros.model.physics.particle import (
    Fluid,
    rotational_diffusion,
    translational_diffusion,
)

SMALLEST, WATER = 0.1e-6, 0.89e-3
"""Radius [m] of the smallest sphere that a light microscope shows as a body, and the viscosity of
water [Pa s] at 25 °C (`WATER`): together they bound the D of thermal motion."""


@dataclass(frozen=True)
class Noise:
    """Noise of tracks.

    Attributes
    ----------
    diffusion : float
        D [m²/s].
    localisation : float
        Localisation error σ per axis [m].
    exposure : float
        Exposure E [s].
    diffusion_std, localisation_std : float
        Standard deviations; NaN for values that were given, not fitted.
    """

    diffusion: float
    localisation: float
    exposure: float = 0.0
    diffusion_std: float = np.nan
    localisation_std: float = np.nan

    @property
    def ratio(self) -> float:
        """σ²/D − E/3 [s], the `noise_ratio` of the likelihood; negative for blur alone."""
        return self.localisation**2 / self.diffusion - self.exposure / 3


def sphere_in_fluid(conditions: Conditions) -> tuple[Fluid, float] | None:
    """Return fluid and radius of the particles.

    Parameters
    ----------
    conditions : Conditions
        Conditions of a session.

    Returns
    -------
    (Fluid, float) or None
        Fluid above its floor, at 25 °C if the temperature is unknown, and radius [m]. None if
        radius or viscosity are unknown.
    """
    if not (conditions.radius and conditions.viscosity):
        return None
    fluid = Fluid(conditions.viscosity, conditions.temperature or 298.15, conditions.height)
    return fluid, conditions.radius


def stokes_einstein(conditions: Conditions) -> tuple[float, float] | None:
    """Return the thermal diffusion of a sphere at its height above the floor.

    By Stokes–Einstein and Stokes–Einstein–Debye.

    Parameters
    ----------
    conditions : Conditions
        Conditions of a session.

    Returns
    -------
    (float, float) or None
        D [m²/s] and D_r [rad²/s]; None if radius or viscosity are unknown.
    """
    known = sphere_in_fluid(conditions)
    return known and (translational_diffusion(*known), rotational_diffusion(*known))


def implausible_diffusion(conditions: Conditions, noise: Noise) -> list[str]:
    """Return a sentence if D differs from its thermal value by Stokes–Einstein.

    If radius or viscosity are unknown: if D exceeds that of a sphere of SMALLEST radius in water.

    Parameters
    ----------
    conditions : Conditions
        Conditions of the session.
    noise : Noise
        Fitted noise.

    Returns
    -------
    list of str
        Empty if D is plausible.
    """
    if not 0 < noise.diffusion < np.inf:
        return []
    sphere = sphere_in_fluid(conditions)
    if sphere is None:
        most = translational_diffusion(Fluid(WATER), SMALLEST)
        if not noise.diffusion > most:
            return []
        return [f'D is {noise.diffusion * 1e12:.3g} µm²/s, that of a sphere of {SMALLEST * 1e6:g} '
                f'µm in water is {most * 1e12:.2g}: it is not thermal. The speed fluctuates, or '
                'positions are inaccurate']
    fluid, radius = sphere
    expected = translational_diffusion(fluid, radius)
    if abs(noise.diffusion - expected) < max(4 * noise.diffusion_std, 0.2 * expected):
        return []
    where = f'{fluid.height * 1e6:g} µm above a floor' if fluid.height else 'far from walls'
    found = (f'D is {noise.diffusion * 1e12:.3g} µm²/s where Stokes–Einstein gives '
             f'{expected * 1e12:.3g} {where}')
    factor = expected / noise.diffusion
    height = None if fluid.height else height_of_drag(factor, radius)
    if height is not None:
        return [f'{found}: the particles probably move near a floor. A centre {height * 1e6:.3g} '
                'µm above it would explain D; drag, and with it every force, is then '
                f'{factor:.2g} times as large. State height_um if you know it']
    what = f'{"height, " if fluid.height else ""}radius or viscosity are wrong'
    if factor > 1:
        return [f'{found}: {what}']
    return [f'{found}: the model lacks an effect that moves the particles; `microbot discover` '
            f'looks for it. Otherwise {what}']


def whiten(
    columns: np.ndarray, times: np.ndarray, noise: Noise, pieces: np.ndarray | None = None,
) -> np.ndarray:
    """Whiten columns under known noise.

    Positions and columns of a model must pass the same filter.

    Parameters
    ----------
    columns : ndarray, shape (T, N, M)
        Real or complex positions or displacements [m].
    times : ndarray, shape (T,)
        Times of the frames [s], strictly ascending.
    noise : Noise
        The noise.
    pieces : ndarray of int, shape (T, N), optional
        Piece of the track that each row belongs to; 0 for unused rows. By default all rows with
        finite columns are one piece.

    Returns
    -------
    ndarray, shape (T, N, M)
        Independent increments of unit variance per axis; 0 in unused rows.

    Raises
    ------
    ValueError
        If times do not ascend.
    """
    from microbot_ros.estimation.likelihood.kernels import whiten_columns

    if not (np.diff(times) > 0).all():
        raise ValueError('frame times must ascend strictly')
    pieces = np.isfinite(columns).all(axis=2) if pieces is None else pieces
    white: np.ndarray = whiten_columns(
        np.ascontiguousarray(times, float), np.ascontiguousarray(pieces, int),
        np.ascontiguousarray(columns), noise.ratio)[0]
    return white / np.sqrt(noise.diffusion)
