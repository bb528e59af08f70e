"""Results of a recording of the demo."""

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
from microbot_ros.session.mcap.recording import Recording

LAST_SECONDS = 5.0
"""Duration [s] at the end of the run over which the goal error is averaged. Choice: half is
noisier, twice includes the approach."""

_REACHED_UM = 3.0
"""True distance [µm] from which a goal counts as reached. Choice: the controller uses 2 µm of its
estimate, whose error is added."""


@dataclass
class DemoRun:
    """Recording of the demo as arrays, in SI.

    Attributes
    ----------
    truth : dict of float to ndarray
        TRUTH of each particle, by time of the frame [s].
    particles : dict of float to ndarray
        PARTICLE of each particle, by time of the frame [s].
    estimates : dict of float to ndarray
        ESTIMATE of each particle, by time of the frame [s].
    goals : list of tuple[float, ndarray]
        Goals (n, 2) [m] with the time [s] at which they were sent.
    latency : ndarray, shape (K,)
        Time from exposure to acknowledgement [s].
    health : dict[str, dict of str to str]
        Last values that each node reported.
    origin : float
        Stamp of the first frame [s].
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
        """Read a recording, without its pictures.

        Parameters
        ----------
        path : Path
            The recording.

        Returns
        -------
        DemoRun
            The run.
        """
        kinds = {'/virtual_rig/truth': messages.TRUTH, '/particles': PARTICLE}
        run = cls({}, {}, {}, [], np.empty(0), {}, math.nan)
        clouds = {'/virtual_rig/truth': run.truth, '/particles': run.particles}
        latency = []
        with Recording(path) as recording:
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
        """True identity of each tracked particle, by their positions at the end."""
        stamp = max(set(self.truth) & set(self.estimates))
        true, seen = self.truth[stamp], self.estimates[stamp]
        distance = np.hypot(seen['x'][:, None] - true['x'], seen['y'][:, None] - true['y'])
        return {int(i): int(true['id'][row.argmin()])
                for i, row in zip(seen['id'], distance, strict=True)}

    @property
    def steered(self) -> int:
        """Particle that visits the goals: the one seen first."""
        return min(self.matches)

    def path(self, clouds: dict[float, np.ndarray], particle: int) -> np.ndarray:
        """Return the path of one particle.

        Parameters
        ----------
        clouds : dict of float to ndarray
            One of `truth`, `particles` and `estimates`.
        particle : int
            Its identity.

        Returns
        -------
        ndarray, shape (n, 3)
            Rows of time since the first frame [s], x and y [m].
        """
        rows = [
            (t, *points[['x', 'y']][points['id'] == particle][0].tolist())
            for t, points in sorted(clouds.items()) if particle in points['id']]
        return np.array(rows).reshape(-1, 3) - [self.origin, 0.0, 0.0]


def summarise(run: DemoRun, goals: np.ndarray, armed_at: float) -> dict[str, Any]:
    """Return the numbers of `summary.json`.

    Frames count from arming: before, the tracker learns the appearance of particles and skips
    frames.

    Parameters
    ----------
    run : DemoRun
        The run.
    goals : ndarray, shape (n, 2)
        Goals in order [m].
    armed_at : float
        Time of arming, ROS time [s].

    Returns
    -------
    dict of str to object
        Values by name.
    """
    truth = run.path(run.truth, run.matches[run.steered])
    end = truth[truth[:, 0] > truth[-1, 0] - LAST_SECONDS]
    error = np.hypot(*(end[:, 1:] - goals[-1]).T).mean()
    given = min((t for t, _ in run.goals), default=math.inf) - run.origin
    # The last frames had no time to be tracked.
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
    """Return a percentile of the latency [ms]; None if no command was acknowledged."""
    return round(float(np.percentile(latency, q) * 1e3), 2) if len(latency) else None


def goals_reached(path: np.ndarray, goals: np.ndarray) -> int:
    """Return the number of goals that a path visits, in order.

    Parameters
    ----------
    path : ndarray, shape (m, 2)
        Positions [m].
    goals : ndarray, shape (n, 2)
        Goals in order [m].

    Returns
    -------
    int
        The number.
    """
    reached = 0
    for place in path:
        if reached < len(goals) and np.hypot(*(place - goals[reached])) <= _REACHED_UM * 1e-6:
            reached += 1
    return reached


def _estimates(run: DemoRun) -> Iterator[tuple[str, dict[str, float]]]:
    """Yield the best estimate of every particle that exists at the end.

    A particle at rest does not determine its speed, and may leave the model in doubt.
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
