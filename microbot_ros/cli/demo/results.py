"""What a recording of the demo shows: numbers, a figure, a video."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from microbot_ros.common import units
from microbot_ros.loop.points import PARTICLE
from microbot_ros.nodes.base import messages
from microbot_ros.session.mcap.recording import open_recording

LAST_SECONDS = 5.0
"""The goal error is the mean over the end of the run."""

_REACHED_UM = 3.0
"""A place counts as reached from this close, in truth; the controller takes 2 µm."""


@dataclass
class DemoRun:
    """The demo's recording as arrays. Times [s] since the first frame; everything else in SI.

    By the time of the frame: `truth`, `particles` and `estimates`, a row each particle. `goals` as
    they were given, with when; `latency` (K,) from exposure to acknowledgement; `health`, the last
    values that each node told; `origin`, the stamp of the first frame.
    """

    truth: dict[float, np.ndarray]
    particles: dict[float, np.ndarray]
    estimates: dict[float, np.ndarray]
    goals: list[tuple[float, np.ndarray]]
    latency: np.ndarray
    health: dict[str, dict[str, str]]
    origin: float

    @classmethod
    def read(cls, path: Path) -> DemoRun:
        """Everything but the pictures in the recording at `path`, read once."""
        kinds = {'/virtual_rig/truth': messages.TRUTH, '/particles': PARTICLE}
        run = cls({}, {}, {}, [], np.empty(0), {}, math.nan)
        clouds = {'/virtual_rig/truth': run.truth, '/particles': run.particles}
        latency = []
        with open_recording(path) as recording:
            topics = [*kinds, '/model/state', '/goals', '/coil_driver/latency', '/diagnostics']
            for raw in recording.messages(topics=topics):
                message: Any = recording.decode(raw)
                if raw.topic == '/diagnostics':
                    for status in message.status:
                        run.health[status.name.split(':')[0]] = {
                            pair.key: pair.value for pair in status.values}
                    continue
                stamp = messages.to_seconds(message.header.stamp)
                if raw.topic == '/coil_driver/latency':
                    latency.append(stamp - messages.to_seconds(message.time_ref))
                elif raw.topic == '/goals':
                    run.goals.append((stamp, np.array(
                        [(pose.position.x, pose.position.y) for pose in message.poses])))
                elif raw.topic == '/model/state':
                    run.estimates[stamp] = messages.estimates(message)
                else:
                    clouds[raw.topic][stamp] = messages.points(message, kinds[raw.topic])
        run.latency = np.array(latency)
        run.origin = min(run.truth, default=math.nan)
        return run

    @property
    def matches(self) -> dict[int, int]:
        """Identity given by the tracker → true identity, by where they are at the end."""
        stamp = max(set(self.truth) & set(self.estimates))
        true, seen = self.truth[stamp], self.estimates[stamp]
        distance = np.hypot(seen['x'][:, None] - true['x'], seen['y'][:, None] - true['y'])
        return {int(i): int(true['id'][row.argmin()])
                for i, row in zip(seen['id'], distance, strict=True)}

    @property
    def steered(self) -> int:
        """The particle that visits the goals: the one seen first."""
        return min(self.matches)

    def path(self, clouds: dict[float, np.ndarray], particle: int) -> np.ndarray:
        """Rows (t, x, y) of one `particle` in `clouds`: `truth`, `particles` or `estimates`."""
        rows = [
            (t, *points[['x', 'y']][points['id'] == particle][0].tolist())
            for t, points in sorted(clouds.items()) if particle in points['id']]
        return np.array(rows).reshape(-1, 3) - [self.origin, 0.0, 0.0]


def summarise(run: DemoRun, goals: np.ndarray, armed_at: float) -> dict[str, Any]:
    """The numbers of `summary.json` that a `run` holds; `goals` (n, 2) [m] in order.

    Frames count from `armed_at` [s, ROS time]: before, the tracker is learning what particles
    look like and lets frames pass.
    """
    truth = run.path(run.truth, run.matches[run.steered])
    end = truth[truth[:, 0] > truth[-1, 0] - LAST_SECONDS]
    error = np.hypot(*(end[:, 1:] - goals[-1]).T).mean()
    given = min((t for t, _ in run.goals), default=math.inf) - run.origin
    # Nothing may be in flight at the end: what was exposed last had no time to be tracked.
    expected = [t for t in run.truth if armed_at <= t <= max(run.truth) - 0.2]
    driver = run.health['coil_driver']
    return {
        'goal_error_um': round(float(units.from_si('x_um', error)), 3),
        'goals': len(goals),
        'goals_reached': goals_reached(truth[truth[:, 0] >= given, 1:], goals),
        'frames': len(expected),
        'frames_dropped': sum(t not in run.particles for t in expected),
        'latency_ms': {f'p{q}': _percentile_ms(run.latency, q) for q in (50, 99)},
        'amplifier': {'frames': int(driver['frames_sent']),
                      'crc_errors': int(driver['crc_errors'])},
        'estimate': dict(_estimates(run)),
    }


def _percentile_ms(latency: np.ndarray, q: int) -> float | None:
    """None where no command was ever acknowledged."""
    return round(float(np.percentile(latency, q) * 1e3), 2) if len(latency) else None


def goals_reached(path: np.ndarray, goals: np.ndarray) -> int:
    """How many of the `goals` (n, 2) [m] a `path` (m, 2) [m] comes to, one after the other."""
    reached = 0
    for place in path:
        if reached < len(goals) and np.hypot(*(place - goals[reached])) <= _REACHED_UM * 1e-6:
            reached += 1
    return reached


def _estimates(run: DemoRun) -> Iterator[tuple[str, dict[str, float]]]:
    """Of every particle that is there at the end what was known of it when it was known best.

    Who comes to rest tells nothing of its speed, and may leave the model in doubt.
    """
    true = {int(point['id']): point for point in run.truth[max(run.truth)]}
    for name, match in run.matches.items():
        known = [point for points in run.estimates.values()
                 for point in points[(points['id'] == name) & np.isfinite(points['speed_std'])]]
        if not known:
            continue
        point, truth = min(known, key=itemgetter('speed_std')), true[match]
        yield str(name), {
            'speed_um_s': round(float(point['speed'] * 1e6), 4),
            'speed_std_um_s': round(float(point['speed_std'] * 1e6), 4),
            'phi_rad': round(float(point['phi']), 4),
            'phi_std_rad': round(float(point['phi_std']), 4),
            'true_speed_um_s': round(float(truth['speed'] * 1e6), 4),
            'true_phi_rad': round(math.remainder(float(truth['phi']), math.tau), 4),
        }
