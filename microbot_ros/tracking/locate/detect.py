"""From a picture to measured particles: search, fit, reject what is not a particle."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np

from microbot_ros.common.compiled import numba
from microbot_ros.tracking.locate.matched_filter import MatchedFilter
from microbot_ros.tracking.locate.search import background
from microbot_ros.tracking.refine.appearance import Appearance
from microbot_ros.tracking.refine.fit import (
    CONTRAST,
    OFFSET,
    PARAMETERS,
    SIZE,
    TABLE_STEP,
    THETA,
    X,
    Y,
    fit,
)
from microbot_ros.tracking.refine.lookup_fit import LookupFit
from microbot_ros.tracking.refine.neighbours import doubled
from microbot_ros.tracking.settings import TrackerSettings

_NONE = np.empty((0, 3))  # no positions
_ITERATIONS, _SWEEPS = 3, 6  # choices: Gauss–Newton steps of a particle; turns among neighbours

_CLOSEST = 0.4
"""Choice: diameters below which two fits are the same particle."""

_OWN_PEAK = 0.6
"""Choice: diameters from an expected particle within which a peak may be its own."""

_TOUCHING = 1.3
"""Choice: diameters from an expected particle within which a peak may hide it."""

_STRANGE = 0.1
"""Choice: share of the picture with neither light nor particles that is reported."""

_ALIKE = 3.0
"""Correlation length [px] of a particle's deviation from the learned picture.

Measured with the virtual rig's microscopes, whose spheres rise and sink through the focus.
"""

_THETA_KNOWN = 0.6
"""Choice: largest standard deviation [rad] of a published cap direction."""


@dataclass(frozen=True)
class Detections:
    """Particles of one picture, arrays of equal length N.

    Attributes
    ----------
    xy : (N, 2) array [px]
    sigma : (N,) array [px]
        Standard deviation per coordinate.
    theta : (N,) array [rad]
        Direction of the cap, image sense; NaN if it does not show.
    contrast, radius : (N,) array [grey], [px]
        The radius is that at half contrast.
    quality : (N,) array
        Share of the particle's picture that the fit explains, noise taken into account.
    kind : (N,) int array
        Number of its kind, 0 if there is only one.
    """

    xy: np.ndarray
    sigma: np.ndarray
    theta: np.ndarray
    contrast: np.ndarray
    radius: np.ndarray
    quality: np.ndarray
    kind: np.ndarray

    def __len__(self) -> int:
        return len(self.xy)

    def __getitem__(self, rows: np.ndarray) -> Detections:
        return Detections(*(getattr(self, part.name)[rows] for part in fields(self)))


class RoundDetector:
    """Detector of particles that match one learned picture.

    `appearance` is that picture; `settings` hold the thresholds. `remark` describes problems of
    the last picture, '' if there are none.

    Parameters
    ----------
    appearance : Appearance
        The learned picture.
    settings : TrackerSettings
        Settings of the tracker.
    """

    def __init__(self, appearance: Appearance, settings: TrackerSettings) -> None:
        self.appearance = appearance
        self.remark = ''
        self._settings = settings
        self._filter = MatchedFilter(appearance)
        self._spacing = max(4, int(np.ceil(appearance.diameter_px)))
        self._lookup_fit = None if appearance.capped else LookupFit(appearance)
        radii = np.arange(appearance.table.shape[1]) * TABLE_STEP
        energy = 2 * np.pi * TABLE_STEP * float(np.sum(radii * appearance.table[0] ** 2))
        self._limits = (
            energy, appearance.min_contrast_grey, settings.min_detection_sigma,
            settings.size_tolerance, settings.min_quality, _CLOSEST * appearance.diameter_px)

    def detect(self, image: np.ndarray, expected: np.ndarray) -> Detections:
        """Return all particles of `image` (H, W).

        `expected` (M, 2) [px] are predicted positions. If there are fewer peaks than expected
        particles, the fit also starts from the expectations, so that touching particles are
        separated.

        Parameters
        ----------
        image : ndarray, shape (H, W)
            The picture.
        expected : ndarray, shape (M, 2)
            Predicted positions [px].

        Returns
        -------
        Detections
            The detections.
        """
        peaks = self._filter.candidates(
            image, self._settings.min_detection_sigma, 0.7 * self.appearance.min_contrast_grey)
        grid = background(image, self._spacing)
        found, hidden = self._assign(peaks, expected)
        rows = _starts(found, hidden)
        errors = self._fit(image, grid, rows, np.ones(len(rows), bool))
        quality, good = self._judge(rows, errors)
        if len(hidden) and not good[len(found):].all():
            wrong = np.flatnonzero(~good[len(found):]) + len(found)
            self._without(wrong, peaks, image, grid, rows, errors)
            quality, good = self._judge(rows, errors)
        known = np.pi * (self.appearance.reach_px + self._filter.shrink) ** 2
        strange = (self._filter.texture - np.count_nonzero(good) * known) / image.size
        self.remark = '' if strange < _STRANGE else (
            f'{100 * strange:.0f} % of the image is covered by something that is not a particle')
        return self._detections(rows[good], errors[good], quality[good])

    def _assign(self, peaks: np.ndarray, expected: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the starts of the fit: peaks, and expected particles hidden in another's peak.

        A peak that two particles share lies between them, so the fit starts from the expectation.
        """
        found, hidden = peaks.copy(), _NONE
        if len(peaks) == 0 or len(expected) == 0:
            return found, hidden
        diameter = self.appearance.diameter_px
        distance, nearest = _nearest(peaks, expected, _TOUCHING * diameter)
        owner, homeless = _claim(distance, nearest, _OWN_PEAK * diameter, len(peaks))
        if len(homeless) == 0:
            return found, hidden
        touching = homeless[distance[homeless, 0] < _TOUCHING * diameter]
        touching = touching[owner[nearest[touching, 0]] >= 0]
        shared = nearest[touching, 0]
        found[shared, :2] = expected[owner[shared]]
        return found, np.column_stack([expected[touching], peaks[shared, 2]])

    def _fit(
        self, image: np.ndarray, grid: np.ndarray, rows: np.ndarray, active: np.ndarray
    ) -> np.ndarray:
        """Fit the active rows in place; the direction of a cap needs the fit pixel by pixel."""
        if self._lookup_fit is not None:
            return self._lookup_fit.fit(image, grid, self._spacing, rows, active)
        return fit(
            image, grid, self._spacing, rows, active, self.appearance.table,
            self.appearance.reach_px, _ITERATIONS, _SWEEPS)

    def _without(
        self, wrong: np.ndarray, peaks: np.ndarray, image: np.ndarray, grid: np.ndarray,
        rows: np.ndarray, errors: np.ndarray,
    ) -> None:
        """Remove hidden particles that do not exist, and refit those they disturbed."""
        reach = 2 * self.appearance.reach_px
        offset = np.abs(rows[None, :len(peaks), :2] - rows[wrong, None, :2])
        disturbed = np.zeros(len(rows), bool)
        disturbed[:len(peaks)] = np.any(np.all(offset < reach, axis=2), axis=0)
        rows[wrong] = _starts(np.zeros((len(wrong), 3)), _NONE)
        errors[wrong] = np.nan
        rows[disturbed] = _starts(peaks[disturbed[:len(peaks)]], _NONE)
        again = self._fit(image, grid, rows, disturbed)
        errors[disturbed] = again[disturbed]

    def _judge(self, rows: np.ndarray, errors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the quality (N,) of each fit, and whether it is a particle, none twice."""
        quality, good = _judge(rows, errors, self._filter.noise, *self._limits)
        return quality, good

    def _detections(
        self, rows: np.ndarray, errors: np.ndarray, quality: np.ndarray
    ) -> Detections:
        described = _described(
            rows, errors, quality, self._filter.noise, self.appearance.capped,
            self.appearance.diameter_px / 2)
        parts = *described, np.zeros(len(rows), int)
        return Detections(*parts)


@numba.njit(cache=True, error_model='numpy')
def _described(rows, errors, quality, noise, capped, radius):  # type: ignore[no-untyped-def]
    """Return the fields of `Detections` except the kind."""
    theta = np.full(len(rows), np.nan)
    for n in range(len(rows)):
        if capped and errors[n, THETA] < _THETA_KNOWN:
            theta[n] = math.pi - (math.pi - rows[n, THETA]) % (2 * math.pi)
    return (rows[:, X:Y + 1].copy(), _sigma(errors, noise), theta, rows[:, CONTRAST].copy(),
            rows[:, SIZE] * radius, quality)


@numba.njit(cache=True, error_model='numpy')
def _sigma(errors, noise):  # type: ignore[no-untyped-def]
    """Return the standard deviation (N,) [px] per coordinate of the position.

    Pixel noise is independent, but the deviation of a particle from the learned picture is smooth,
    so that several pixels carry the same error. The part of the residual above the noise, by two
    of its standard deviations, counts as deviation.
    """
    sigma = np.empty(len(errors))
    for n in range(len(errors)):
        variance, pixels = errors[n, PARAMETERS], errors[n, PARAMETERS + 1]
        share = 1 - noise**2 * (1 + 2 * math.sqrt(2 / pixels)) / variance
        alike = 1 + (_ALIKE - 1) * max(share, 0.0)
        sigma[n] = math.sqrt((errors[n, X] ** 2 + errors[n, Y] ** 2) / 2 * alike)
    return sigma


@numba.njit(cache=True)
def _starts(found, hidden):  # type: ignore[no-untyped-def]
    """Return start parameters of a fit from rows x, y, contrast of both inputs."""
    rows = np.empty((len(found) + len(hidden), PARAMETERS))
    rows[:len(found), :OFFSET] = found
    rows[len(found):, :OFFSET] = hidden
    rows[:, OFFSET], rows[:, SIZE], rows[:, THETA] = 0.0, 1.0, np.nan
    return rows


@numba.njit(cache=True, error_model='numpy')
def _judge(rows, errors, noise, energy, contrast, sigma, tolerance, least, closest):  # type: ignore[no-untyped-def]
    """Return the quality (N,) of each fit, and whether contrast, σ, size and quality are good.

    Of two good ones nearer than `closest`, only that of higher contrast is.
    """
    quality, good = np.empty(len(rows)), np.empty(len(rows), np.bool_)
    for n in range(len(rows)):
        a, size = rows[n, CONTRAST], rows[n, SIZE]
        misfit = max(errors[n, PARAMETERS] - noise**2, 0.0) * errors[n, PARAMETERS + 1]
        quality[n] = 1 - misfit / (energy * (a * size) ** 2)
        good[n] = (a >= contrast and a >= sigma * errors[n, CONTRAST]
                   and 1 / tolerance <= size <= tolerance and quality[n] >= least)
    return quality, good & ~doubled(rows, good, closest)


@numba.njit(cache=True)
def _nearest(peaks, expected, reach):  # type: ignore[no-untyped-def]
    """Return distances (M, 4), infinite beyond `reach` [px], and numbers of the nearest peaks."""
    order = np.argsort(peaks[:, 1])
    heights = peaks[order, 1]
    distance = np.full((len(expected), 4), np.inf)
    nearest = np.zeros((len(expected), 4), np.int64)
    for m in range(len(expected)):
        first = np.searchsorted(heights, expected[m, 1] - reach)
        for i in order[first:]:
            down, right = peaks[i, 1] - expected[m, 1], peaks[i, 0] - expected[m, 0]
            if down > reach:
                break
            off = math.sqrt(right * right + down * down)
            k = 4
            while k > 0 and off < distance[m, k - 1]:
                if k < 4:
                    distance[m, k], nearest[m, k] = distance[m, k - 1], nearest[m, k - 1]
                k -= 1
            if k < 4:
                distance[m, k], nearest[m, k] = off, i
    return distance, nearest


@numba.njit(cache=True)
def _claim(distance, nearest, farthest, peaks):  # type: ignore[no-untyped-def]
    """Return the owner of each peak, −1 if none, and particles without: nearest free peak first.

    `nearest` (M, K) are the peaks nearest to each expected particle, at `distance` (M, K).
    """
    owner, homeless = np.full(peaks, -1), np.ones(len(distance), np.bool_)
    for i in np.argsort(distance[:, 0]):
        for n in range(distance.shape[1]):
            if distance[i, n] < farthest and owner[nearest[i, n]] < 0:
                owner[nearest[i, n]] = i
                homeless[i] = False
                break
    return owner, np.flatnonzero(homeless)
