"""Rendered films for pointing: robots among cells, and discs of several sizes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

SIZES_NOISE = 5.0
"""Noise of a pixel [grey] in the field of several sizes."""


@dataclass(frozen=True)
class Film:
    """Frames (H, W) uint8, and the true places (T, N, 2) [px] of what is to be followed."""

    frames: list[np.ndarray]
    truth: np.ndarray
    radius: np.ndarray


def among_cells(
    frames: int = 200, cells: int = 500, robots: int = 10, seed: int = 3,
    size: tuple[int, int] = (900, 1200),
) -> Film:
    """Dark robots that swim over living cells: dark rims, bright insides, dark nuclei.

    The cells creep and jostle; some of their rims are half as dark as a robot.
    """
    rng = np.random.default_rng(seed)
    height, width = size
    room = np.array([width, height])
    place = rng.uniform(0, 1, (cells, 2)) * room
    look = np.column_stack([
        rng.uniform(9, 17, cells), rng.uniform(0.7, 1.4, cells), rng.uniform(0, np.pi, cells),
        rng.uniform(15, 45, cells), rng.uniform(5, 25, cells), rng.uniform(0, 30, cells)])
    truth = _swimmers(frames, robots, room, 60.0, 3.0, rng)
    lamp = 150 + 25 * np.cos(np.arange(width) / width * 3)[None, :] * np.ones((height, 1))
    film = []
    for t in range(frames):
        place = place + rng.normal(0, 0.25, place.shape)
        picture = lamp.copy()
        for centre, form in zip(place, look, strict=True):
            _draw_cell(picture, centre, form)
        for centre in truth[t]:
            _draw_disc(picture, centre, 6.0, -85.0)
        film.append(_exposed(picture, 4.0, rng))
    return Film(film, truth, np.full(robots, 6.0))


def over_texture(
    texture: np.ndarray, frames: int = 60, robots: int = 6, seed: int = 7,
) -> Film:
    """Robots, absorbing discs that swim over a micrograph that creeps and is deformed.

    `texture` (H, W) uint8 is the micrograph. Each of its parts goes its own way at random, some
    pixels in the film, as living cells do; neighbours go together.
    """
    import cv2

    rng = np.random.default_rng(seed)
    height, width = texture.shape
    truth = _swimmers(frames, robots, np.array([width, height]), 40.0, 2.5, rng)
    v, u = np.mgrid[:height, :width].astype(np.float32)
    shift = np.zeros((2, height, width), np.float32)
    film = []
    for t in range(frames):
        shift += [cv2.resize(rng.normal(0, 0.15, (5, 5)).astype(np.float32), (width, height),
                             interpolation=cv2.INTER_CUBIC) for _ in range(2)]
        picture = cv2.remap(texture.astype(np.float32), u + shift[0], v + shift[1],
                            cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
        shade = np.zeros(texture.shape)
        for centre in truth[t]:
            _draw_disc(shade, centre, 6.0, 0.7)
        film.append(_exposed(picture * (1 - np.minimum(shade, 0.7)), 3.0, rng))
    return Film(film, truth, np.full(robots, 6.0))


def of_sizes(
    frames: int = 40, seed: int = 5, radii: tuple[float, ...] = (4.0, 6.3, 10.0, 16.0),
    each: int = 8, noise: float = SIZES_NOISE,
) -> Film:
    """Dark discs of several radii [px] in one field, all in focus."""
    rng = np.random.default_rng(seed)
    size = np.array([900, 700])
    radius = np.repeat(radii, each)
    places: list[np.ndarray] = []
    while len(places) < len(radius):
        place = rng.uniform(45, size - 45)
        if all(np.hypot(*(place - other)) > 70 for other in places):
            places.append(place)
    truth = np.empty((frames, len(radius), 2))
    truth[0] = places
    for t in range(1, frames):
        truth[t] = truth[t - 1] + rng.normal(0, 0.5, truth[0].shape)
    film = []
    for t in range(frames):
        picture = np.full(size[::-1], 160.0)
        for centre, r in zip(truth[t], radius, strict=True):
            _draw_disc(picture, centre, r, -60.0)
        film.append(_exposed(picture, noise, rng))
    return Film(film, truth, radius)


def disc_bound(radius: float, noise: float, contrast: float = 60.0) -> float:
    """Cramér–Rao bound of a disc's position per coordinate [px], its look known."""
    u, v = np.meshgrid(*(np.arange(-2 * radius - 8, 2 * radius + 9),) * 2)
    step = 1e-3
    slope = (_disc(u - step, v, radius) - _disc(u + step, v, radius)) / (2 * step) * contrast
    return float(noise / np.sqrt(np.sum(slope**2)))


def _disc(u: np.ndarray, v: np.ndarray, radius: float) -> np.ndarray:
    return np.asarray(1 / (1 + np.exp(1.6 * (np.hypot(u, v) - radius))))


def _draw_disc(picture: np.ndarray, centre: np.ndarray, radius: float, contrast: float) -> None:
    rows, columns = _window(picture, centre, radius + 8)
    v, u = np.mgrid[rows, columns]
    picture[rows, columns] += contrast * _disc(u - centre[0], v - centre[1], radius)


def _draw_cell(picture: np.ndarray, centre: np.ndarray, form: np.ndarray) -> None:
    radius, aspect, angle, rim, inside, nucleus = form
    rows, columns = _window(picture, centre, 1.5 * radius + 6)
    v, u = np.mgrid[rows, columns]
    u, v = u - centre[0], v - centre[1]
    a = (u * np.cos(angle) + v * np.sin(angle)) * np.sqrt(aspect)
    b = (v * np.cos(angle) - u * np.sin(angle)) / np.sqrt(aspect)
    r = np.hypot(a, b)
    picture[rows, columns] += (
        inside * _disc(a, b, radius) - rim * np.exp(-((r - radius) / 1.6) ** 2)
        - nucleus * np.exp(-((a - 2) ** 2 + b**2) / (0.3 * radius) ** 2))


def _window(picture: np.ndarray, centre: np.ndarray, reach: float) -> tuple[slice, slice]:
    x, y = centre
    height, width = picture.shape
    return (slice(max(int(y - reach), 0), min(max(int(y + reach) + 1, 0), height)),
            slice(max(int(x - reach), 0), min(max(int(x + reach) + 1, 0), width)))


def _exposed(picture: np.ndarray, noise: float, rng: np.random.Generator) -> np.ndarray:
    seen = picture + rng.normal(0, noise, picture.shape)
    return np.clip(np.rint(seen), 0, 255).astype(np.uint8)


def _swimmers(
    frames: int, count: int, room: np.ndarray, margin: float, speed: float,
    rng: np.random.Generator,
) -> np.ndarray:
    """Places (T, N, 2) [px] of swimmers that turn at random and are reflected at the margin."""
    place = rng.uniform(margin, room - margin, (count, 2))
    heading = rng.uniform(-np.pi, np.pi, count)
    truth = np.empty((frames, count, 2))
    for t in range(frames):
        truth[t] = place
        heading += rng.normal(0, 0.08, count)
        step = speed * np.column_stack([np.cos(heading), np.sin(heading)])
        for axis in (0, 1):
            out = (place[:, axis] + step[:, axis] < margin)
            out |= place[:, axis] + step[:, axis] > room[axis] - margin
            heading = np.where(out, -heading if axis else np.pi - heading, heading)
            step = speed * np.column_stack([np.cos(heading), np.sin(heading)])
        place = place + step
    return truth
