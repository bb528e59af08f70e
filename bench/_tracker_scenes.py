"""Pictures with known truth for the tracker: drawn five times finer than the pixels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

_FINE = 5
_HALF = 15
_STEP = 1e-3

KINDS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    'spot': lambda r: np.exp(-(r**2) / 8),
    'disc': lambda r: 0.5 * (1 - np.tanh((r - 5) / 0.9)),
    'ring': lambda r: np.exp(-((r - 4) ** 2) / 3.4),
}
"""Profiles of contrast 1 over the distance [px]: a bright dot, a blurred disc, a ring."""


@dataclass(frozen=True)
class Scene:
    """Frames of particles that stand still: truth (N, 2) [px] and its Cramér–Rao bound [px]."""

    frames: list[np.ndarray]
    truth: np.ndarray
    bound: float


def light(height: int, width: int) -> np.ndarray:
    """An uneven lamp: brightest off the centre, with a slope."""
    y, x = np.mgrid[0:height, 0:width]
    falloff = 0.15 * ((x - 0.47 * width) / width) ** 2 + 0.1 * ((y - 0.42 * height) / height) ** 2
    return 140 * (1 - falloff) + 10 * x / width


def patch(profile: Callable[[np.ndarray], np.ndarray], x: float, y: float) -> np.ndarray:
    """A particle at (x, y) [px] from the middle pixel, averaged over each pixel: (31, 31)."""
    cell = (np.arange(_FINE) + 0.5) / _FINE - 0.5
    grid = (np.arange(-_HALF, _HALF + 1)[:, None] + cell).ravel()
    fine = profile(np.hypot(grid[None, :] - x, grid[:, None] - y))
    side = 2 * _HALF + 1
    return fine.reshape(side, _FINE, side, _FINE).mean(axis=(1, 3))


def draw(picture: np.ndarray, place: np.ndarray, profile: Callable[[np.ndarray], np.ndarray],
         contrast: float) -> None:
    """Add a particle at `place` (2,) [px]; whatever lies outside is cut off."""
    padded = np.pad(np.zeros_like(picture), _HALF)
    x, y = np.rint(place).astype(int)
    if -_HALF <= x < picture.shape[1] + _HALF and -_HALF <= y < picture.shape[0] + _HALF:
        x, y = np.clip([x, y], 0, np.array(picture.shape[::-1]) - 1)
        padded[y:y + 2 * _HALF + 1, x:x + 2 * _HALF + 1] = patch(
            profile, place[0] - x, place[1] - y)
        picture += contrast * padded[_HALF:-_HALF, _HALF:-_HALF]


def expose(picture: np.ndarray, noise: float, rng: np.random.Generator) -> np.ndarray:
    """A frame in whole grey levels, with Gaussian noise of so many."""
    return np.clip(np.rint(picture + rng.normal(0, noise, picture.shape)), 0, 255).astype(np.uint8)


def scene(kind: str, contrast: float, snr: float, seed: int, frames: int = 8) -> Scene:
    """A lattice of particles, each off its site by up to 4 px, on uneven light; 480 × 640 px.

    `snr` is the contrast over the pixel noise. The bound is σ/√Σ(∂I/∂x)², position unknown in
    one coordinate, from the noiseless picture; rounding to whole levels counts as noise.
    """
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(40, 600, 48), np.arange(40, 440, 48))
    truth = np.column_stack([x.ravel(), y.ravel()]) + rng.uniform(-4, 4, (x.size, 2))
    picture = light(480, 640)
    information = []
    for place in truth:
        draw(picture, place, KINDS[kind], contrast)
        dx, dy = place - np.rint(place)
        slope = (patch(KINDS[kind], dx + _STEP, dy) - patch(KINDS[kind], dx - _STEP, dy)) / _STEP
        information.append(np.sum((contrast * slope / 2) ** 2))
    noise = abs(contrast) / snr
    bound = np.hypot(noise, 12**-0.5) / np.sqrt(np.mean(information))
    return Scene([expose(picture, noise, rng) for _ in range(frames)], truth, float(bound))


@dataclass(frozen=True)
class Crowd:
    """Swimmers that cross: truth (T, N, 2) [px], whether each is drawn (T, N), and frames."""

    truth: np.ndarray
    drawn: np.ndarray
    frames: list[np.ndarray]

    def crossings(self, distance: float = 10.0) -> int:
        """How often two particles come to overlap."""
        count = 0
        for i in range(self.truth.shape[1]):
            apart = np.linalg.norm(self.truth - self.truth[:, i:i + 1], axis=2)[:, :i] < distance
            count += int(np.sum(apart[1:] & ~apart[:-1]) + np.sum(apart[0]))
        return count


def crowd(frames: int, seed: int, particles: int = 20, side: int = 160) -> Crowd:
    """Particles 10 px wide that swim 1 to 2.5 px a frame, turn, jitter, and vanish at times.

    They bounce off the walls, pass over one another (the light of one is dimmed by the other) and
    go unseen for up to 15 frames.
    """
    rng = np.random.default_rng(seed)
    truth = _swim(frames, particles, side, rng)
    drawn = _gaps(frames, particles, rng)
    lamp = light(side, side)
    profile = KINDS['disc']
    pictures = []
    for places, visible in zip(truth, drawn, strict=True):
        passed = np.ones((side, side))
        for place in places[visible]:
            shade = np.zeros((side, side))
            _draw_fast(shade, place, profile)
            passed *= 1 - 0.43 * shade
        pictures.append(expose(lamp * passed, 4.0, rng))
    return Crowd(truth, drawn, pictures)


def _draw_fast(picture: np.ndarray, place: np.ndarray,
               profile: Callable[[np.ndarray], np.ndarray]) -> None:
    """Like `draw`, sampled at the pixels' centres: fine enough where positions aren't judged."""
    x, y = np.rint(place).astype(int)
    rows = slice(max(y - 9, 0), y + 10)
    columns = slice(max(x - 9, 0), x + 10)
    height, width = picture.shape
    u = np.arange(width)[columns] - place[0]
    v = np.arange(height)[rows] - place[1]
    picture[rows, columns] += profile(np.hypot(u[None, :], v[:, None]))


def _swim(frames: int, particles: int, side: int, rng: np.random.Generator) -> np.ndarray:
    place = rng.uniform(20, side - 20, (particles, 2))
    speed = rng.uniform(1.0, 2.5, particles)
    heading = rng.uniform(-np.pi, np.pi, particles)
    truth = np.empty((frames, particles, 2))
    for t in range(frames):
        heading = heading + rng.normal(0, 0.04, particles)
        place = place + speed[:, None] * np.column_stack([np.cos(heading), np.sin(heading)])
        place = place + rng.normal(0, 0.1, place.shape)
        for axis in (0, 1):
            beyond = (place[:, axis] < 10) | (place[:, axis] > side - 10)
            heading = np.where(beyond, -heading if axis else np.pi - heading, heading)
        place = np.clip(place, 10, side - 10)
        truth[t] = place
    return truth


def _gaps(frames: int, particles: int, rng: np.random.Generator) -> np.ndarray:
    drawn = np.ones((frames, particles), bool)
    for k in range(particles):
        t = 20
        while t < frames:
            t += int(rng.exponential(250))
            length = int(rng.integers(1, 16))
            drawn[t:t + length, k] = False
            t += length + 20
    return drawn


def identity_switches(
    crowd: Crowd, seen: list[tuple[np.ndarray, np.ndarray]], distance: float = 10.0
) -> int:
    """How often a particle that stands clear of all others has another identity than before.

    `seen` holds identities (K,) and positions (K, 2) of each frame. Judged only where no other
    particle is nearer than `distance`, so that nobody is blamed for what overlaps.
    """
    switches, last = 0, {}
    for places, drawn, (names, found) in zip(crowd.truth, crowd.drawn, seen, strict=True):
        if len(found) == 0:
            continue
        apart = np.linalg.norm(places[:, None] - places, axis=2) + 1e9 * np.eye(len(places))
        away = np.linalg.norm(places[:, None] - found, axis=2)
        for k in np.flatnonzero(drawn & (apart.min(axis=1) > distance)):
            nearest = int(np.argmin(away[k]))
            if away[k, nearest] < 4:
                switches += last.get(k, names[nearest]) != names[nearest]
                last[k] = names[nearest]
    return switches
