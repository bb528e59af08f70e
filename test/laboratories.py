"""Sessions of a laboratory, made by the first-order model and a little noise."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from microbot_ros.records import Commands, Conditions, Session, Tracks
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
