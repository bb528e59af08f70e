"""Learning the appearance of a particle from a few frames, without examples."""

from __future__ import annotations

import math
from collections.abc import Generator, Iterable
from dataclasses import replace
from itertools import islice

import numpy as np

from microbot_ros.tracking.locate.outline import OutlineDetector
from microbot_ros.tracking.locate.search import background, pixel_noise
from microbot_ros.tracking.refine.appearance import Appearance
from microbot_ros.tracking.refine.cap import centre_shift, first_harmonic
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
from microbot_ros.tracking.refine.profiles import RadialBasis, Samples, samples
from microbot_ros.tracking.settings import TrackerSettings
from microbot_ros.tracking.teach.initial_size import (
    LEAST_DIAMETER,
    InitialSize,
    best_initial_size,
    initial_size_at,
    outer_diameter,
)

_MOST_FRAMES, _MOST_RESCALINGS = 6, 4  # choices: frames used, corrections of the first diameter
_NEAR = 0.25
"""Choice: relative error of a first diameter that is good enough."""

_LEAST_OUTLINE = 8.0
"""Choice: smallest diameter [px] with a usable outline."""

_CAP_SHOWS = 0.7
"""Choice: share of the residual variance that may remain with a cap."""

_IRREGULAR = 0.2
"""Choice: spread of ln(diameter), or ln(length/width), from which particles are irregular."""


def learn(frames: list[np.ndarray], settings: TrackerSettings) -> Appearance | None:
    """Return the typical particle of `frames` (H, W) by `settings`; None if all is noise.

    Parameters
    ----------
    frames : list of ndarray
        Pictures (H, W).
    settings : TrackerSettings
        Settings of the tracker.

    Returns
    -------
    Appearance or None
        The appearance, or None.
    """
    steps = learning(frames, settings)
    while True:
        try:
            next(steps)
        except StopIteration as done:
            appearance: Appearance | None = done.value
            return appearance


def learn_first(images: Iterable[np.ndarray], settings: TrackerSettings) -> Appearance | None:
    """Return the typical particle, by `settings`, of the first `images` (H, W) that show any.

    Parameters
    ----------
    images : iterable of ndarray
        Pictures (H, W).
    settings : TrackerSettings
        Settings of the tracker.

    Returns
    -------
    Appearance or None
        The appearance, or None.
    """
    rest = iter(images)
    while batch := list(islice(rest, settings.learning_frames)):
        if (appearance := learn(batch, settings)) is not None:
            return appearance
    return None


def learning(
    frames: list[np.ndarray], settings: TrackerSettings
) -> Generator[None, None, Appearance | None]:
    """Run `learn` on `frames` and `settings` in portions of milliseconds, for a live loop.

    Parameters
    ----------
    frames : list of ndarray
        Pictures (H, W).
    settings : TrackerSettings
        Settings of the tracker.

    Returns
    -------
    Generator[None, None, Appearance or None]
        The appearance, or None.
    """
    step = max(1, len(frames) // _MOST_FRAMES)
    frames = [np.ascontiguousarray(frame) for frame in frames[::step][:_MOST_FRAMES]]
    initial = yield from best_initial_size(frames, settings)
    # A wide window also collects debris and halos: repeat at the size that was found, or the fits
    # would run into their size limits.
    for _ in range(_MOST_RESCALINGS):
        if initial is None:
            return None
        diameter = outer_diameter(frames, initial)
        if settings.diameter_px is not None or abs(diameter - initial.diameter) < _NEAR * diameter:
            break
        initial = initial_size_at(frames, max(diameter, LEAST_DIAMETER), initial.sign)
        yield
    if initial is None:
        return None
    return (yield from _Learner(frames, initial, settings).appearance())


class _Learner:
    """Alternates between positions of the particles and their appearance."""

    def __init__(
        self, frames: list[np.ndarray], initial: InitialSize, settings: TrackerSettings,
    ) -> None:
        self._frames = frames
        self._settings = settings
        self._reach = 1.5 * initial.diameter + 3
        self._spacing = max(4, int(np.ceil(initial.diameter)))
        self._grids = [background(frame, self._spacing) for frame in frames]
        self._parameters = [_start(spots) for spots in initial.spots]
        self._radii = np.arange(0, 2.2 * self._reach, TABLE_STEP)
        self._basis = RadialBasis(self._reach, self._radii)
        self._table = self._basis.fit(self._samples(), harmonics=[0])
        self._misfit = math.inf

    def appearance(self) -> Generator[None, None, Appearance | None]:
        """Compute the result, in portions."""
        for turn in range(5):
            self._fit(settled=turn > 1)
            yield
            if self._count == 0:
                return None
            self._table = self._basis.fit(self._samples(), harmonics=[0])
            yield
            if turn == 1:
                self._trim()
        self._fit(settled=True)
        yield from self._find_cap()
        return self._conclude()

    @property
    def _count(self) -> int:
        return sum(map(len, self._parameters))

    def _find_cap(self) -> Generator[None, None, None]:
        """Add the cap to the picture if that explains much more of it."""
        plain, parameters = self._table, [rows.copy() for rows in self._parameters]
        before = self._misfit
        pixels = self._samples()
        rest = pixels.grey - np.interp(pixels.r, self._radii, plain[0])
        profile = self._basis.profile(first_harmonic(pixels, rest, self._basis.at(pixels.r)))
        yield
        sense = -1.0 if self._settings.cap == 'dark' else 1.0
        sense *= np.sign(np.sum(profile * self._radii))
        profile *= 0.3 * sense / np.max(np.abs(profile))
        self._table = np.vstack([plain, profile, np.zeros_like(profile)])
        for _ in range(3):
            self._fit(settled=False)
            yield
            if self._count == 0:
                break
            self._table = self._basis.fit(self._samples(), harmonics=[0, 1, 2])
            yield
        if self._count and self._misfit < _CAP_SHOWS * before:
            self._centre()
        else:
            self._table, self._parameters = plain, parameters

    def _centre(self) -> None:
        """Move the centre of the picture from where f₁ is least to the centre of the sphere."""
        for _ in range(3):
            shift = centre_shift(self._table, self._reach)
            for rows in self._parameters:
                rows[:, X] += shift * np.cos(rows[:, THETA])
                rows[:, Y] += shift * np.sin(rows[:, THETA])
            self._table = self._basis.fit(self._samples(), harmonics=[0, 1, 2])

    def _diameter(self) -> float:
        return float(2 * self._radii[np.flatnonzero(np.abs(self._table[0]) > 0.5)[-1]])

    def _refit(self, k: int, rows: np.ndarray) -> np.ndarray:
        """Fit the particles of one frame in place; return the residual variance of each."""
        everything = np.ones(len(rows), bool)
        errors: np.ndarray = fit(
            self._frames[k], self._grids[k], self._spacing, rows, everything, self._table,
            self._reach, 4, 2)
        return errors[:, PARAMETERS]

    def _fit(self, settled: bool) -> None:
        """Refit all, and keep those that look like most others."""
        misfits = []
        for k, rows in enumerate(self._parameters):
            variance = self._refit(k, rows)
            keep = np.isfinite(variance) & (rows[:, CONTRAST] > 0)
            keep &= (rows[:, SIZE] > 0.5) & (rows[:, SIZE] < 2.0)
            self._parameters[k] = rows[keep]
            misfits.append(variance[keep])
        if self._count == 0:
            return
        self._misfit = float(np.median(np.concatenate(misfits)))
        every = np.concatenate(self._parameters)
        least = 0.5 * np.quantile(every[:, CONTRAST], 0.8) if settled else 0.0
        typical = np.median(every[:, SIZE])
        self._parameters = [rows[rows[:, CONTRAST] >= least] for rows in self._parameters]
        for rows in self._parameters:
            rows[:, SIZE] /= typical

    def _samples(self) -> Samples:
        return samples(
            self._frames, self._grids, self._spacing, self._parameters, self._reach)

    def _trim(self) -> None:
        """Reduce the reach to where the picture ends, with a margin of background."""
        end = self._radii[np.flatnonzero(np.abs(self._table[0]) > 0.04)[-1]]
        self._reach = min(self._reach, float(end) + 1.0)
        self._basis = RadialBasis(self._reach, self._radii)

    def _conclude(self) -> Appearance | None:
        if self._diameter() < LEAST_DIAMETER:
            return None
        contrast = np.concatenate([rows[:, CONTRAST] for rows in self._parameters])
        typical = float(np.median(contrast))
        least = self._settings.min_contrast_grey
        appearance = Appearance(
            table=self._table,
            reach_px=self._reach,
            diameter_px=self._diameter(),
            contrast_grey=typical,
            min_contrast_grey=0.35 * typical if least is None else least,
            round=self._settings.shape != 'any',
        )
        if self._settings.shape is None and self._irregular(appearance):
            return replace(appearance, round=False)
        return appearance

    def _irregular(self, appearance: Appearance) -> bool:
        """Return whether outlines differ too much for one picture."""
        noise = max(pixel_noise(frame) for frame in self._frames)
        if appearance.diameter_px < _LEAST_OUTLINE or appearance.contrast_grey < 15 * noise:
            return False
        detector = OutlineDetector(appearance, self._settings)
        found = [detector.irregularity(frame) for frame in self._frames]
        return float(np.median(found)) > _IRREGULAR


def _start(spots: np.ndarray) -> np.ndarray:
    rows = np.full((len(spots), PARAMETERS), np.nan)
    rows[:, [X, Y, CONTRAST]] = spots
    rows[:, OFFSET] = 0.0
    rows[:, SIZE] = 1.0
    return rows
