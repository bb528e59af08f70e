"""Learning what a particle looks like from a few frames, without being told anything."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from microbot_ros.tracking.appearance import Appearance
from microbot_ros.tracking.cap import centre_shift, first_harmonic
from microbot_ros.tracking.fit import (
    CONTRAST,
    OFFSET,
    PARAMETERS,
    SIZE,
    TABLE_STEP,
    THETA,
    X,
    Y,
    background_of,
    fit,
)
from microbot_ros.tracking.outline import OutlineDetector
from microbot_ros.tracking.search import background, block_mean, peaks, pixel_noise, spread
from microbot_ros.tracking.settings import TrackerSettings

_LADDER = 2.0 ** np.arange(2, 6.6, 0.5)
"""Diameters [px] tried: 4 to 76."""

_MOST_CANDIDATES = 80
_MOST_FRAMES = 6
_MOST_PIXELS = 150_000
_LEAST_SIGMA = 8.0

_MOST_RESCALINGS = 4
_NEAR = 0.3
"""A guess within this of the found size, as a difference of logarithms, is good enough."""

_LEAST_OUTLINE = 8.0
"""Pixels: a smaller particle has no outline to speak of."""

_CAP_SHOWS = 0.7
"""Share of the residual variance that a cap must leave at most, to be believed."""

_IRREGULAR = 0.2
"""Spread of ln(diameter), or ln(length/width), from which particles count as irregular."""


@dataclass(frozen=True)
class _Guess:
    """A first idea: these spots of this width, with the energy their mean picture explains."""

    diameter: float
    sign: float
    spots: list[np.ndarray]
    energy: float


def learn(frames: list[np.ndarray], settings: TrackerSettings) -> Appearance | None:
    """The typical particle of some frames (H, W); None where nothing stands out of the noise."""
    step = max(1, len(frames) // _MOST_FRAMES)
    frames = frames[::step][:_MOST_FRAMES]
    guess = _best_guess(frames, settings)
    for _ in range(_MOST_RESCALINGS):
        if guess is None:
            return None
        learner = _Learner(frames, guess, settings)
        scale = learner.scale()
        if settings.diameter_px is not None or abs(math.log(scale)) < _NEAR:
            break
        # A wide window collects the energy of debris and halos too: look again at the size of
        # what was found, or the fits would run into the limits of their size.
        guess = _guess_at(frames, guess.diameter * scale, guess.sign)
    return learner.appearance()


def _best_guess(frames: list[np.ndarray], settings: TrackerSettings) -> _Guess | None:
    signs = {'dark': [-1.0], 'bright': [1.0], None: [-1.0, 1.0]}[settings.contrast]
    ladder = _LADDER if settings.diameter_px is None else [settings.diameter_px]
    some = frames[:3]
    guesses = [
        guess for diameter in ladder for sign in signs
        if 2 * diameter < min(frames[0].shape)
        and (guess := _guess(some, float(diameter), sign)) is not None
    ]
    best = max(guesses, key=lambda guess: guess.energy, default=None)
    if best is None:
        return None
    return _guess_at(frames, best.diameter, best.sign)


def _guess_at(frames: list[np.ndarray], diameter: float, sign: float) -> _Guess | None:
    """The strongest spots of one width and sign in every frame; None where there are none."""
    # Enough pixels for a smooth picture; the strongest spots are the likeliest particles.
    most = max(4, int(_MOST_PIXELS / len(frames) / (1.5 * diameter + 3) ** 2 / 4))
    everywhere = [_spots(frame, diameter, sign)[:most] for frame in frames]
    if not any(map(len, everywhere)):
        return None
    return _Guess(diameter, sign, everywhere, 0.0)


def _spots(frame: np.ndarray, diameter: float, sign: float) -> np.ndarray:
    """Rows (N, 3) x, y, response of the strongest blobs of one width and sign."""
    import cv2

    shrink = max(1, int(diameter / 8))
    image = block_mean(frame, shrink) * np.float32(sign)
    inner = 0.3 * diameter / shrink
    response = cv2.GaussianBlur(image, (0, 0), inner) - cv2.GaussianBlur(image, (0, 0), 1.6 * inner)
    noise = max(spread(response), 0.3 * 0.2 / inner)
    found = peaks(response, _LEAST_SIGMA * noise, max(1, int(0.5 * diameter / shrink)))
    found[:, :2] = (found[:, :2] + 0.5) * shrink - 0.5
    return found[np.argsort(-found[:, 2])][:_MOST_CANDIDATES]


def _guess(frames: list[np.ndarray], diameter: float, sign: float) -> _Guess | None:
    reach = 1.25 * diameter + 2
    spots = [_spots(frame, diameter, sign) for frame in frames]
    patches = [_patches(f, s, reach) for f, s in zip(frames, spots, strict=True)]
    radius, grey = (np.concatenate(part) for part in zip(*patches, strict=True))
    if len(radius) == 0:
        return None
    grey = grey - np.mean(grey, axis=1, keepdims=True)
    ring = np.minimum(radius.astype(int), int(reach))
    count = np.maximum(np.bincount(ring.ravel()), 1)
    profile = np.bincount(ring.ravel(), grey.ravel()) / count
    picture = profile[ring] - np.mean(profile[ring], axis=1, keepdims=True)
    overlap = np.sum(picture * grey, axis=1)
    explained = np.maximum(overlap, 0) ** 2 / np.sum(picture**2, axis=1)
    return _Guess(diameter, sign, spots, float(np.sum(explained)))


def _patches(
    frame: np.ndarray, spots: np.ndarray, reach: float
) -> tuple[np.ndarray, np.ndarray]:
    """Distance from the centre and grey value, (N, P) each, of discs inside the picture."""
    span = int(reach)
    v, u = np.mgrid[-span:span + 1, -span:span + 1]
    disc = u**2 + v**2 <= reach**2
    u, v = u[disc], v[disc]
    centre = np.rint(spots[:, :2]).astype(int)
    limit = np.array(frame.shape[::-1]) - span
    centre = centre[np.all((centre >= span) & (centre < limit), axis=1)]
    x, y = centre[:, :1] + u, centre[:, 1:] + v
    return np.broadcast_to(np.hypot(u, v), x.shape), frame[y, x].astype(float)


class _Learner:
    """Alternates between where the particles are and what they look like."""

    def __init__(self, frames: list[np.ndarray], guess: _Guess, settings: TrackerSettings) -> None:
        self._frames = frames
        self._settings = settings
        self._reach = 1.5 * guess.diameter + 3
        self._spacing = max(4, int(np.ceil(guess.diameter)))
        self._grids = [background(frame, self._spacing) for frame in frames]
        self._parameters = [_start(spots) for spots in guess.spots]
        radii = np.arange(0, 2.2 * self._reach, TABLE_STEP)
        sign = np.sign(guess.sign)
        self._table = sign * np.exp(-0.5 * (radii / (0.42 * guess.diameter)) ** 2)[None]
        for rows in self._parameters:
            rows[:, CONTRAST] *= 4.0

    def scale(self) -> float:
        """How large the spots are, in the median, as a part of the guessed diameter."""
        sizes = []
        for frame, grid, rows in zip(self._frames, self._grids, self._parameters, strict=True):
            fitted = rows.copy()
            fit(frame, grid, self._spacing, fitted, np.ones(len(rows), bool), self._table,
                self._reach, 4, 2)
            sizes += fitted[np.isfinite(fitted[:, SIZE]), SIZE].tolist()
        return float(np.median(sizes)) if sizes else 1.0

    def appearance(self) -> Appearance | None:
        for turn in range(5):
            self._fit(settled=turn > 1)
            if sum(map(len, self._parameters)) == 0:
                return None
            self._table = self._profiles(harmonics=[0])
            if turn == 1:
                self._trim()
        self._fit(settled=True)
        self._find_cap()
        return self._conclude()

    def _find_cap(self) -> None:
        """Add the cap to the picture if that explains much more of it."""
        plain, parameters = self._table, [rows.copy() for rows in self._parameters]
        before = self._misfit
        r, angle, grey, weight, owner = self._samples()
        radii = np.arange(plain.shape[1]) * TABLE_STEP
        rest = grey - np.interp(r, radii, plain[0])
        knots = self._knots()
        shape = first_harmonic(r, angle, rest, weight, owner, _even_splines(r, knots))
        profile = _even_splines(radii, knots) @ shape
        sense = -1.0 if self._settings.cap == 'dark' else 1.0
        profile *= 0.3 * sense * np.sign(np.sum(profile * radii)) / np.max(np.abs(profile))
        self._table = np.vstack([plain, profile, np.zeros_like(profile)])
        for _ in range(3):
            self._fit(settled=False)
            if sum(map(len, self._parameters)) == 0:
                break
            self._table = self._profiles(harmonics=[0, 1, 2])
        if not self._misfit < _CAP_SHOWS * before:
            self._table, self._parameters = plain, parameters
            return
        self._centre()

    def _centre(self) -> None:
        """Move the centre of the picture from where f₁ is least to the centre of the outline."""
        for _ in range(2):
            shift = centre_shift(self._table, self._diameter(), self._reach)
            for rows in self._parameters:
                rows[:, X] += shift * np.cos(rows[:, THETA])
                rows[:, Y] += shift * np.sin(rows[:, THETA])
            self._table = self._profiles(harmonics=[0, 1, 2])

    def _diameter(self) -> float:
        radii = np.arange(self._table.shape[1]) * TABLE_STEP
        return float(2 * radii[np.flatnonzero(np.abs(self._table[0]) > 0.5)[-1]])

    def _knots(self) -> np.ndarray:
        return np.arange(0, self._reach + 1, max(0.9, self._reach / 14))

    def _fit(self, settled: bool) -> None:
        """Refit all, keep what looks like most others do."""
        misfits: list[np.ndarray] = []
        for k, frame in enumerate(self._frames):
            rows = self._parameters[k]
            errors = fit(
                frame, self._grids[k], self._spacing, rows, np.ones(len(rows), bool),
                self._table, self._reach, 4, 2)
            noise = errors[:, PARAMETERS]
            keep = np.isfinite(noise) & (rows[:, CONTRAST] > 0)
            keep &= (rows[:, SIZE] > 0.5) & (rows[:, SIZE] < 2.0)
            self._parameters[k] = rows[keep]
            misfits.append(noise[keep])
        every = np.concatenate(misfits)
        self._misfit = float(np.median(every)) if len(every) else math.inf
        sizes = np.concatenate([rows[:, SIZE] for rows in self._parameters])
        for rows in self._parameters:
            rows[:, SIZE] /= np.median(sizes)
        if not settled:
            return
        contrast = np.concatenate([rows[:, CONTRAST] for rows in self._parameters])
        if len(contrast):
            least = 0.5 * np.quantile(contrast, 0.8)
            self._parameters = [rows[rows[:, CONTRAST] >= least] for rows in self._parameters]

    def _samples(self) -> tuple[np.ndarray, ...]:
        """Of all pixels in reach: distance r/s, angle φ−θ, grey/contrast, contrast, particle."""
        r, angle, grey, weight, owner = [], [], [], [], []
        span = int(self._reach)
        v, u = np.mgrid[-span:span + 1, -span:span + 1]
        for frame, grid, rows in zip(self._frames, self._grids, self._parameters, strict=True):
            for row in rows:
                x, y = int(round(row[X])) + u, int(round(row[Y])) + v
                inside = (x >= 0) & (y >= 0) & (x < frame.shape[1]) & (y < frame.shape[0])
                x, y = x[inside], y[inside]
                light = background_of(grid, self._spacing, x, y)
                r.append(np.hypot(x - row[X], y - row[Y]) / row[SIZE])
                angle.append(np.arctan2(y - row[Y], x - row[X]) - np.nan_to_num(row[THETA]))
                grey.append((frame[y, x] - light - row[OFFSET]) / row[CONTRAST])
                weight.append(np.full(len(x), row[CONTRAST]))
                owner.append(np.full(len(x), len(owner)))
        return tuple(np.concatenate(part) for part in (r, angle, grey, weight, owner))

    def _profiles(self, harmonics: list[int]) -> np.ndarray:
        """Least squares of smooth radial profiles, one per angular harmonic, to all pixels."""
        r, angle, grey, weight, _ = self._samples()
        knots = self._knots()
        near = r < knots[-1]
        r, angle, grey, weight = r[near], angle[near], grey[near], weight[near]
        basis = _even_splines(r, knots)
        design = np.hstack([basis * np.cos(m * angle)[:, None] for m in harmonics])
        scaled = design * weight[:, None]
        normal = scaled.T @ scaled
        normal += 1e-6 * np.trace(normal) / len(normal) * np.eye(len(normal))
        solution = np.linalg.solve(normal, scaled.T @ (grey * weight))
        radii = np.arange(self._table.shape[1]) * TABLE_STEP
        even = _even_splines(radii, knots)
        table = np.array([even @ part for part in np.split(solution, len(harmonics))])
        return self._bounded(table, radii)

    def _bounded(self, table: np.ndarray, radii: np.ndarray) -> np.ndarray:
        """f₀ relative to its far end, nothing beyond the reach, largest magnitude 1."""
        far = (radii > 0.9 * self._reach) & (radii <= self._reach)
        table[0] -= np.mean(table[0, far])
        fade = np.clip((self._reach + 1 - radii) / 2, 0, 1)
        table *= fade * fade * (3 - 2 * fade)
        return table / np.max(np.abs(table[0]))

    def _trim(self) -> None:
        """The reach is where the picture ends, with a margin to tell the light from it."""
        radii = np.arange(self._table.shape[1]) * TABLE_STEP
        shape = np.abs(self._table[0])
        end = radii[np.flatnonzero(shape > 0.04)[-1]]
        self._reach = min(self._reach, float(end) + 2.0)

    def _conclude(self) -> Appearance:
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
        """Whether outlines differ so much that one picture can't fit them all."""
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


def _even_splines(r: np.ndarray, knots: np.ndarray) -> np.ndarray:
    """Cubic B-splines about `knots` at r (N,): (N, K); flat at r = 0, as a smooth picture is."""
    spacing = knots[1]

    def bump(z: np.ndarray) -> np.ndarray:
        z = np.abs(z)
        return np.where(z < 1, 2 / 3 - z**2 + z**3 / 2, np.maximum(2 - z, 0) ** 3 / 6)

    direct = bump((r[:, None] - knots) / spacing)
    return direct + np.where(knots > 0, bump((r[:, None] + knots) / spacing), 0.0)
