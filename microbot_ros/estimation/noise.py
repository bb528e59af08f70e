"""What diffusion, localisation error and exposure do to tracks, and how to undo it exactly.

A particle diffuses with D; each position is read with a standard deviation σ per axis, from an
exposure of duration E during which the particle moves on. An increment over an interval h then
has, per axis, variance 2Dh + 2σ² − 2DE/3 and covariance −σ² + DE/3 with its neighbour (Berglund
2010; E = 0 is a strobe, E = h a full frame, his R = 1/6). That is a local level seen with the
variance σ² − DE/3, so the Kalman gain of the local-level model whitens increments exactly, in
one pass, across unequal intervals and gaps. Everything that is linear in unknowns may be passed
through the same filter.

Functions take *levels*: positions, and for a model column the displacement it has accumulated
since the start of the record. Levels make gaps trivial: a missing row is a row not used.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

SMALLEST, LARGEST = 1e-4, 1e5
"""Bounds of σ²/(D h) in the search; beyond them one of the two can't be seen at all."""

_GOLDEN, _SLICED_WITHIN = (math.sqrt(5) - 1) / 2, 0.02
"""Of the search in slices: the golden section, and how well it finds log σ²/D."""


@dataclass(frozen=True)
class Noise:
    """Diffusion D [m²/s], localisation error σ per axis [m] and exposure E [s].

    `diffusion_std`, `localisation_std` are NaN where the values were given, not fitted.
    """

    diffusion: float
    localisation: float
    exposure: float = 0.0
    diffusion_std: float = np.nan
    localisation_std: float = np.nan

    @property
    def reading(self) -> float:
        """Variance σ² − DE/3 [m²] of a position about the local level; below 0 with blur alone."""
        return self.localisation**2 - self.diffusion * self.exposure / 3


@dataclass(frozen=True)
class Whitened:
    """Independent columns (T, N, M) of unit variance per axis under the noise; unused rows 0.

    `log_det` is Σ ½ log variance over the `count` rows used, each of one axis: the Gaussian log
    likelihood of one real axis is −½ Σ residual² − log_det − ½ count log 2π.
    """

    columns: np.ndarray
    log_det: float
    count: int


def seen_rows(times: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """Where positions (T, N, ...) can be used: all coordinates finite; (T, N) bool.

    `times` (T,) must ascend strictly: a moment repeated is an error of the caller.
    """
    if not (np.diff(times) > 0).all():
        raise ValueError('frame times must ascend strictly')
    finite = np.isfinite(positions)
    return finite.all(axis=tuple(range(2, finite.ndim))) if finite.ndim > 2 else finite


def whiten(
    levels: np.ndarray, times: np.ndarray, noise: Noise, seen: np.ndarray | None = None,
) -> Whitened:
    """Whiten levels (T, N, M), real or complex, at `times` (T,) [s] under `noise`.

    `seen` (T, N) says which rows exist; default: those whose columns are all finite. Pass the
    same `seen` for positions and for model columns, so that all go through the same filter.
    """
    from microbot_ros.estimation.kernels import whiten_levels

    seen = seen_rows(times, levels) if seen is None else seen
    columns, log_det, count = whiten_levels(
        np.ascontiguousarray(times, float), np.ascontiguousarray(seen),
        np.ascontiguousarray(levels), noise.reading / noise.diffusion,
    )
    scale = noise.diffusion
    log_det = 0.5 * (log_det + count * np.log(scale))
    return Whitened(columns / np.sqrt(scale), float(log_det), count)


def covariance_estimate(
    residual: np.ndarray, times: np.ndarray, exposure: float = 0.0,
) -> Noise:
    """D and σ from the variance and the neighbour covariance of increments, robustly.

    The estimator of Vestergaard, Blainey and Flyvbjerg (2014), with medians of increments and of
    sums of two neighbouring increments in place of means, so that a few jumps do no harm.
    `residual` (T, N) complex levels [m] with what moves the particle taken out; NaN for gaps.
    Starting values: never negative, never zero.
    """
    step = np.diff(times)
    one, two = np.diff(residual, axis=0), residual[2:] - residual[:-2]
    # Median of |complex Gaussian|² is 2 ln 2 times the variance of one axis.
    per_axis = 1 / (2 * np.log(2))
    h = float(np.median(step))
    v1, v2 = (
        float(np.nanmedian(np.abs(d) ** 2)) * per_axis if np.isfinite(d).any() else np.nan
        for d in (one, two)
    )
    if not (v1 > 0 and v2 > 0):
        return Noise(1e-13, 1e-7, exposure)
    diffusion = max((v2 - v1) / (2 * h), 1e-3 * v1 / h)
    localisation = (v1 - 2 * diffusion * h) / 2 + diffusion * exposure / 3
    return Noise(diffusion, float(np.sqrt(max(localisation, 1e-3 * v1))), exposure)


@dataclass(frozen=True)
class GainFit:
    """Maximum-likelihood gains c of z = p₀ + c·path + noise, and the noise that goes with them.

    `gain` (N,) complex [m/s, or m/s/Hz] and `variance` (N,) per axis, NaN and inf where the
    path never moved; `noise` with standard deviations; `log_likelihood` at the maximum;
    `residual` (T, N) whitened innovations of unit variance per axis, 0 in unused rows.
    """

    gain: np.ndarray
    variance: np.ndarray
    noise: Noise
    log_likelihood: float
    residual: np.ndarray
    count: int


@dataclass(frozen=True)
class Profile:
    """Everything that follows in closed form from one value of σ²/D."""

    gain: np.ndarray
    power: np.ndarray
    residual: np.ndarray
    diffusion: float
    count: int
    log_likelihood: float


class GainLikelihood:
    """Likelihood of tracks z = p₀ + c·path + noise, with gains c and D in closed form.

    `times` (T,) [s]; `z` (T, N) complex positions [m], NaN for gaps; `path` (T,) or (T, N)
    complex ∫u dt. Exact for correlated increments and gaps. Raises ValueError with fewer than 3
    increments.
    """

    def __init__(
        self, times: np.ndarray, z: np.ndarray, path: np.ndarray, exposure: float = 0.0,
    ) -> None:
        self._seen = seen_rows(times, z)
        path = np.broadcast_to(path if path.ndim == 2 else path[:, None], z.shape)
        self._levels = np.ascontiguousarray(np.stack([np.where(self._seen, z, 0), path], axis=-1))
        self._times = np.ascontiguousarray(times, float)
        self.exposure = exposure
        if self._seen.sum() - self._seen.any(axis=0).sum() < 3:
            raise ValueError('fewer than 3 increments: nothing to fit')

    def at(self, ratio: float) -> Profile:
        """The maximum over gains and D for σ²/D = `ratio` [s]."""
        from microbot_ros.estimation.kernels import whiten_levels

        white, log_det, count = whiten_levels(
            self._times, self._seen, self._levels, ratio - self.exposure / 3
        )
        response, regressor = white[..., 0], white[..., 1]
        power = (np.abs(regressor) ** 2).sum(axis=0)
        gain = (np.conj(regressor) * response).sum(axis=0) / np.where(power > 0, power, 1)
        left = response - gain * regressor
        # Two axes each; every gain takes up one degree of freedom an axis.
        free = max(count - int((power > 0).sum()), 1)
        squares = float((np.abs(left) ** 2).sum())
        diffusion = max(squares / (2 * free), 1e-30)
        value = -count * np.log(2 * np.pi * diffusion) - log_det - squares / (2 * diffusion)
        return Profile(gain, power, left, diffusion, count, float(value))

    def maximum(self) -> GainFit:
        """Gains, D and σ together at the maximum, with their standard deviations."""
        from scipy.optimize import minimize_scalar

        h = float(np.median(np.diff(self._times)))
        bounds = (np.log(SMALLEST * h), np.log(LARGEST * h))
        found = minimize_scalar(
            lambda log_ratio: -self.at(float(np.exp(log_ratio))).log_likelihood,
            bounds=bounds, method='bounded', options={'xatol': 1e-3},
        )
        return self.fit(float(np.exp(found.x)))

    def maximum_in_slices(self) -> Iterator[GainFit | None]:
        """`maximum` for a caller with frames to serve: None after each evaluation, last the fit.

        By golden section, since SciPy's bounded search cannot be left and taken up again.
        """
        def value(log_ratio: float) -> float:
            return self.at(math.exp(log_ratio)).log_likelihood

        h = float(np.median(np.diff(self._times)))
        low, high = math.log(SMALLEST * h), math.log(LARGEST * h)
        left, right = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
        at_left, at_right = value(left), value(right)
        while high - low > _SLICED_WITHIN:
            yield None
            if at_left > at_right:
                high, right, at_right = right, left, at_left
                left = high - _GOLDEN * (high - low)
                at_left = value(left)
            else:
                low, left, at_left = left, right, at_right
                right = low + _GOLDEN * (high - low)
                at_right = value(right)
        yield None
        yield self.fit(math.exp((low + high) / 2))

    def fit(self, ratio: float) -> GainFit:
        """The fit for a known σ²/D; standard deviations as if it had been the maximum."""
        step = 0.05
        best, lower, upper = (self.at(ratio * np.exp(k * step)) for k in (0, -1, 1))
        values = [p.log_likelihood for p in (lower, best, upper)]
        # Fisher information of log ratio with D profiled out, and how log D follows it.
        curvature = max(-(values[0] - 2 * values[1] + values[2]) / step**2, 1e-9)
        slope = np.log(upper.diffusion / lower.diffusion) / (2 * step)
        log_diffusion_std = np.sqrt(1 / best.count + slope**2 / curvature)
        log_localisation_std = 0.5 * np.sqrt(1 / best.count + (1 + slope) ** 2 / curvature)
        localisation = float(np.sqrt(ratio * best.diffusion))
        moved = best.power > 0
        return GainFit(
            gain=np.where(moved, best.gain, np.nan),
            variance=np.where(moved, best.diffusion / np.where(moved, best.power, 1), np.inf),
            noise=Noise(
                best.diffusion, localisation, self.exposure,
                float(best.diffusion * log_diffusion_std),
                float(localisation * log_localisation_std),
            ),
            log_likelihood=best.log_likelihood,
            residual=best.residual / np.sqrt(best.diffusion),
            count=best.count,
        )


def fit_noise(
    residual: np.ndarray, times: np.ndarray, exposure: float = 0.0,
) -> Noise:
    """D and σ by exact maximum likelihood from levels (T, N) or (T, N, 2) with no motion left in.

    `residual` [m] holds positions less the modelled displacement, complex or as two axes; NaN
    for gaps. The noise is isotropic and shared by the particles. Raises ValueError with fewer
    than 3 increments.
    """
    if residual.ndim == 3:
        residual = residual[..., 0] + 1j * residual[..., 1]
    path = np.zeros(residual.shape, complex)
    return GainLikelihood(times, residual, path, exposure).maximum().noise
