"""What diffusion, localisation error and exposure do to tracks, and how to undo it exactly.

A particle diffuses with D; each position is read with a standard deviation σ per axis, from an
exposure of duration E during which the particle moves on. An increment over an interval h then
has, per axis, variance 2Dh + 2σ² − 2DE/3 and covariance −σ² + DE/3 with its neighbour (Berglund
2010; E = 0 is a strobe, E = h a full frame, his R = 1/6). That is a local level seen with the
variance σ² − DE/3, so the Kalman gain of the local-level model whitens increments exactly, in
one pass, across unequal intervals and gaps. Everything that is linear in unknowns may be passed
through the same filter.

What is whitened are positions, and for a model's column the displacement that it has accumulated
since the start of the record. That makes gaps trivial: a missing row is a row not used.
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
"""Radius [m] of the smallest sphere that a light microscope shows as a body, and the viscosity
[Pa s] of water at 25 °C: together they bound the D of what moves by heat alone."""


@dataclass(frozen=True)
class Noise:
    """`diffusion` D [m²/s], `localisation` error σ per axis [m] and `exposure` E [s].

    `diffusion_std`, `localisation_std` are NaN where the values were given, not fitted.
    """

    diffusion: float
    localisation: float
    exposure: float = 0.0
    diffusion_std: float = np.nan
    localisation_std: float = np.nan

    @property
    def ratio(self) -> float:
        """σ²/D − E/3 [s], the `noise_ratio` of the likelihood; below 0 with blur alone."""
        return self.localisation**2 / self.diffusion - self.exposure / 3


def sphere_in_fluid(conditions: Conditions) -> tuple[Fluid, float] | None:
    """The fluid, above its floor, and the radius [m] under some `conditions`.

    None where they are not known; at 25 °C where the temperature is not.
    """
    if not (conditions.radius and conditions.viscosity):
        return None
    fluid = Fluid(conditions.viscosity, conditions.temperature or 298.15, conditions.height)
    return fluid, conditions.radius


def stokes_einstein(conditions: Conditions) -> tuple[float, float] | None:
    """D [m²/s] and D_r [rad²/s] of a sphere under some `conditions`; None where not known.

    At their height above the floor (Stokes–Einstein and Stokes–Einstein–Debye).
    """
    known = sphere_in_fluid(conditions)
    return known and (translational_diffusion(*known), rotational_diffusion(*known))


def implausible_diffusion(conditions: Conditions, noise: Noise) -> list[str]:
    """A sentence where the D of some `noise` is not that of Stokes–Einstein under `conditions`.

    Where these do not say the radius and the viscosity: where D exceeds that of any sphere that a
    microscope shows, of SMALLEST radius in water.
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
        return [f'{found}: most likely the particles move near a floor. A centre '
                f'{height * 1e6:.3g} µm above it would explain D; drag, and with it every force, '
                f'is then {factor:.2g} times as large. State height_um where it is known']
    what = f'{"height, " if fluid.height else ""}radius or viscosity are wrong'
    if factor > 1:
        return [f'{found}: {what}']
    return [f'{found}: the model lacks an effect that moves the particles; `microbot discover` '
            f'looks for it. Otherwise {what}']


def whiten(
    columns: np.ndarray, times: np.ndarray, noise: Noise, pieces: np.ndarray | None = None,
) -> np.ndarray:
    """Independent columns (T, N, M) of unit variance per axis under `noise`; unused rows are 0.

    From `columns` (T, N, M) [m], real or complex, at `times` (T,) [s]. `pieces` (T, N) says to
    which piece of a track rows belong, 0 to none, by default all whose columns are finite to one:
    positions and model columns must go through the same filter. ValueError unless times ascend
    strictly.
    """
    from microbot_ros.estimation.likelihood.kernels import whiten_columns

    if not (np.diff(times) > 0).all():
        raise ValueError('frame times must ascend strictly')
    pieces = np.isfinite(columns).all(axis=2) if pieces is None else pieces
    white: np.ndarray = whiten_columns(
        np.ascontiguousarray(times, float), np.ascontiguousarray(pieces, int),
        np.ascontiguousarray(columns), noise.ratio)[0]
    return white / np.sqrt(noise.diffusion)
