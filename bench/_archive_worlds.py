"""An archive with a known truth: fine Langevin physics, filmed, and films of spots."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from bench._estimation_runs import FIELD, FLUID, RADIUS
from microbot_ros.common.files import write_text
from microbot_ros.common.records import Conditions, Session
from microbot_ros.session import write_session
from microbot_ros.virtual_rig.commands import steps
from microbot_ros.virtual_rig.injected_effects import inject_effect
from microbot_ros.virtual_rig.record_session import Camera, draw_swarm, record_session
from microbot_ros.virtual_rig.world import World

SECONDS = 60.0


def record(seed: int, lag: float = 0.0, particles: int = 3, archive: int = 0) -> Session:
    """A session of an `archive`, drawn by `seed`, whose `particles` take a `lag` [s] to align."""
    rng = np.random.default_rng([archive, seed])
    extent = 60e-6 * max(1.0, particles / 3) ** 0.5
    swarm = draw_swarm(rng, particles, FLUID, FIELD, half_extent=extent, spacing=4 * RADIUS)
    if lag:
        inject_effect(swarm, 'alignment_lag', {'tau_s': lag}, FIELD)
    conditions = Conditions(radius=RADIUS, viscosity=FLUID.viscosity, reference_field=FIELD)
    session, _ = record_session(
        World(swarm, rng), steps(rng, SECONDS, FIELD, (0.5, 2.0)), Camera(20.0, 0.0, 1e-7),
        SECONDS, rng, conditions)
    return session


def fill(folder: Path, lags: np.ndarray) -> Path:
    """A session of 60 s for each of `lags` (K,) [s], over days, batches and two rigs."""
    for k, lag in enumerate(lags.tolist()):
        place = folder / f'2026-{k // 28 % 12 + 1:02d}-{k % 28 + 1:02d}' / f's{k:03d}'
        write_session(place, record(k, lag))
        write_text(place / 'archive.yaml', f'rig: {"AB"[k % 2]}\nbatch: b{k // 20}\n')
    return folder


def films(folder: Path, count: int, frames: int = 300) -> Path:
    """As many films of three dark spots that wander on grey noise."""
    folder.mkdir(parents=True)
    y, x = np.mgrid[:240, :320]
    for seed in range(count):
        rng = np.random.default_rng(seed)
        writer = cv2.VideoWriter(str(folder / f'film{seed:02d}.avi'),
                                 cv2.VideoWriter_fourcc(*'MJPG'), 20, (320, 240))
        places = np.array([[80.0, 60.0], [160.0, 180.0], [240.0, 90.0]])
        for _ in range(frames):
            places += rng.normal(0, 0.7, places.shape)
            image = 150 + 3 * rng.standard_normal(x.shape)
            for at in places:
                image -= 90 * np.exp(-((x - at[0]) ** 2 + (y - at[1]) ** 2) / 32)
            grey = np.clip(image, 0, 255).astype(np.uint8)
            writer.write(cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR))
        writer.release()
    return folder
