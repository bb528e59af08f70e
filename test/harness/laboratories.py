"""Sessions and films of a laboratory, made by the first-order model and a little noise."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from microbot_ros.common.records import Commands, Conditions, Session, Tracks
from microbot_ros.session import write_session


def make_session(seed: int, particles: int = 2, seconds: float = 12.0) -> Session:
    """Swimmers under a field that turns every second; 20 frames a second."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, 0.05)
    angle = np.repeat(rng.uniform(-np.pi, np.pi, int(seconds)), 20)[:len(t)]
    commands = Commands(t[::20].copy(), 5e-3 * np.column_stack(
        [np.cos(angle[::20]), np.sin(angle[::20])]))
    positions = []
    for _ in range(particles):
        velocity = 5e-6 * np.exp(1j * (angle + 0.3))
        steps = 0.05 * velocity + np.sqrt(2 * 5e-14 * 0.05) * (
            rng.standard_normal(len(t)) + 1j * rng.standard_normal(len(t)))
        read = 5e-8 * (rng.standard_normal(len(t)) + 1j * rng.standard_normal(len(t)))
        z = 3e-5 * complex(*rng.uniform(-1, 1, 2)) + np.cumsum(steps) - steps + read
        positions.append(np.column_stack([z.real, z.imag]))
    unknown = np.full(len(t) * particles, np.nan)
    return Session(
        Tracks(np.repeat(t, particles), np.tile(np.arange(particles), len(t)),
               np.stack(positions, axis=1).reshape(-1, 2), unknown, unknown),
        commands, Conditions(radius=4.6e-6, viscosity=1.2e-3, reference_field=5e-3))


def fill(folder: Path, count: int) -> Path:
    """A folder with as many sessions."""
    for seed in range(count):
        write_session(folder / f'day-{seed % 3}' / f's{seed}', make_session(seed))
    return folder


_RATE = 25.0


def rolling_recording(levels=(1.0, 2.0, 5.0), seed=0, *, slip=0.1, delay=0.1, seconds=6.0,
                      noise=0.05e-6, diffusion=0.3e-12, gain=3e-6, robots=1, frequency=True,
                      tilt=None, alpha=None, speed=None) -> Session:
    """Robots that follow each of the `levels` for `seconds`, to and fro, `delay` late."""
    rng = np.random.default_rng(seed)
    starts = np.arange(2 * len(levels)) * seconds / 2
    drive = np.repeat(np.asarray(levels, float), 2)
    direction = np.tile([0.7, 0.7 + np.pi], len(levels)) if alpha is None else alpha(starts)
    t = np.arange(0, starts[-1] + seconds / 2, 1 / _RATE)
    at = np.searchsorted(starts, t - delay, side='right') - 1
    size = np.where(at < 0, 0.0, (speed or (lambda f: gain * f))(drive[at]))
    step = size * np.exp(1j * (direction[at] + slip)) / _RATE
    z = np.cumsum(step)[:, None] + np.cumsum(
        np.sqrt(2 * diffusion / _RATE) * (rng.normal(size=(len(t), robots))
                                         + 1j * rng.normal(size=(len(t), robots))), axis=0)
    z = z + noise * (rng.normal(size=z.shape) + 1j * rng.normal(size=z.shape))
    unknown = np.full(z.size, np.nan)
    tracks = Tracks(np.repeat(t, robots), np.tile(np.arange(robots), len(t)),
                    np.column_stack([z.real.ravel(), z.imag.ravel()]), unknown, unknown)
    field = np.column_stack([np.cos(direction), np.sin(direction)])
    commands = Commands(starts, (1e-3 if frequency else drive[:, None] * 1e-3) * field,
                        drive if frequency else None, tilt)
    return Session(tracks, commands, Conditions('rolling' if frequency else 'catalytic'), 'made')


def write_film(path: Path, places: np.ndarray) -> None:
    """Write dark spots on grey at `places` (T, N, 2) [px]: 160 × 120 pixels, 10 frames/s."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*'FFV1'), 10, (160, 120))
    y, x = np.mgrid[:120, :160]
    noise = np.random.default_rng(1)
    for spots in places:
        image = 150 + 3 * noise.standard_normal(x.shape)
        for at in spots:
            image -= 90 * np.exp(-((x - at[0]) ** 2 + (y - at[1]) ** 2) / 18)
        writer.write(cv2.cvtColor(np.clip(image, 0, 255).astype(np.uint8), cv2.COLOR_GRAY2BGR))
    writer.release()
