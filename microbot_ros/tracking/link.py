"""Which detection is which particle: prediction, gating, global assignment, birth and death."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from microbot_ros.tracking.appearance import Appearance
from microbot_ros.tracking.assign import assign
from microbot_ros.tracking.detect import Detections
from microbot_ros.tracking.motion import Motion
from microbot_ros.tracking.settings import TrackerSettings

_MISS_RATE = 0.02
"""Probability that a particle in view is not detected in a frame."""

_BIRTHS = (0.5, 0.02)
"""New particles per frame: the first guess, and the least that is reckoned with."""

_SURPRISE = 9.0
"""Squared innovation, in its variance, from which a particle is taken to have changed course."""

_LOOKS_SPREAD = 0.25
"""Standard deviation of ln(contrast) and ln(radius) of one particle from frame to frame."""

_LEAST_SIGMA = 0.05
"""Pixels: no prediction is better than this, whatever the formulas say."""

_OVERLAP = 1.0
"""Diameters: particles nearer than this overlap in the picture."""

_TOUCHED, _HIDDEN = 0.1, 0.35
"""Diameters: error of a position where two particles overlap, and where one is seen for two."""

_EXPECTED_FOR = 5
"""Frames for which an unseen particle is still looked for at its prediction."""

_UNNAMED = -1


@dataclass
class TrackStates:
    """The particles being followed, arrays of equal length N; px, s, rad.

    `xy` and `velocity` (N, 2); `covariance` (N, 3): variances of position, of both together, of
    velocity, per coordinate; `step` the last measured displacement, NaN after a gap; `hits` the
    frames seen, `missed` the frames since; `host` the identity of the particle that it has merged
    with, −1 where it is on its own.
    """

    id: np.ndarray
    xy: np.ndarray
    velocity: np.ndarray
    covariance: np.ndarray
    measured: np.ndarray
    step: np.ndarray
    sigma: np.ndarray
    theta: np.ndarray
    contrast: np.ndarray
    radius: np.ndarray
    hits: np.ndarray
    missed: np.ndarray
    host: np.ndarray

    def __len__(self) -> int:
        return len(self.id)

    def take(self, rows: np.ndarray) -> TrackStates:
        """Some of the particles."""
        return TrackStates(*(getattr(self, part.name)[rows] for part in fields(self)))

    def join(self, other: TrackStates) -> TrackStates:
        """These and others."""
        return TrackStates(*(
            np.concatenate([getattr(self, part.name), getattr(other, part.name)])
            for part in fields(self)
        ))


class Linker:
    """Follows particles from frame to frame. Identities count up from 0 and are never reused."""

    def __init__(
        self, settings: TrackerSettings, appearance: Appearance, size: tuple[int, int]
    ) -> None:
        diameter_px = self._diameter = appearance.diameter_px
        self._settings = settings
        # Round particles that touch are told apart by the fit; outlines run into one.
        self._merging = not appearance.round
        self._size = size
        self._motion = Motion(diameter_px)
        self._max_step = settings.max_step_px or diameter_px
        self._birth_rate = _BIRTHS[0]
        self._next_id = 0
        self._interval: float | None = None
        self._shift = np.zeros(2)
        self.states = _none()

    def predict(self, dt: float, shift: np.ndarray) -> None:
        """Move all to where they should be `dt` [s] later; `shift` (2,) [px] is known of all."""
        self._interval = dt if self._interval is None else 0.95 * self._interval + 0.05 * dt
        frames = dt / self._interval
        states, keep = self.states, self._motion.keep(frames)
        states.xy = states.xy + states.velocity * dt + shift
        states.velocity = states.velocity * keep
        place, both, speed = states.covariance.T
        change = self._motion.velocity_step / self._interval**2 * (1 - keep**2)
        states.covariance = np.column_stack([
            place + 2 * dt * both + dt**2 * speed + self._motion.random_step * frames,
            keep * (both + dt * speed),
            keep**2 * speed + change,
        ])
        self._shift = shift

    def expected(self) -> np.ndarray:
        """Positions (M, 2) [px] at which named particles are to be looked for."""
        states = self.states
        near = (states.id != _UNNAMED) & (states.missed < _EXPECTED_FOR)
        return states.xy[near]

    def update(self, found: Detections) -> None:
        """Give each detection to a particle, or to a new one; drop who was unseen too long."""
        states = self.states
        found, noise = self._doubted(found)
        track, detection = self._associate(found, noise)
        if self._merging:
            track = self._merge(track, found, detection)
        self._learn(track, found, detection)
        self._correct(track, found, detection, noise[detection])
        states.missed = states.missed + 1
        states.missed[track] = 0
        states.hits[track] += 1
        unseen = np.setdiff1d(np.arange(len(states)), track)
        states.step[unseen] = np.nan
        states.theta[unseen] = np.nan
        self._follow_hosts()
        self._bury()
        self._christen()
        fresh = np.setdiff1d(np.arange(len(found)), detection)
        if len(track):
            self._birth_rate += 0.02 * (len(fresh) - self._birth_rate)
            self._birth_rate = max(self._birth_rate, _BIRTHS[1])
        self.states = self.states.join(self._born(found[fresh]))

    def _doubted(self, found: Detections) -> tuple[Detections, np.ndarray]:
        """Detections with larger σ where one is seen for two; the variance (N,) to link with.

        What the fit says of itself holds for a particle on its own: where particles overlap, a
        position may be off by more, and must not bend the prediction.
        """
        if self._merging or len(found) == 0:
            return found, found.sigma**2 + _LEAST_SIGMA**2
        named = self.states.xy[self.states.id != _UNNAMED]
        detections = _within(found.xy, found.xy, _OVERLAP * self._diameter)
        expected = _within(found.xy, named, _OVERLAP * self._diameter)
        hidden = np.where(expected > detections, _HIDDEN * self._diameter, 0.0)
        touched = np.where(detections > 1, _TOUCHED * self._diameter, 0.0)
        found = replace(found, sigma=np.hypot(found.sigma, hidden))
        return found, found.sigma**2 + touched**2 + _LEAST_SIGMA**2

    def _associate(
        self, found: Detections, noise: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        states = self.states
        alone = states.host < 0
        wider = np.where(alone, np.sqrt(1.0 + states.missed), 1.0)
        reach = self._max_step * wider + np.where(alone, 0.0, np.sqrt(states.covariance[:, 0]))
        rate = _MISS_RATE * self._birth_rate / (self._size[0] * self._size[1])
        return assign(
            states.xy, states.covariance[:, 0], reach, _looks(states),
            found.xy, noise, _looks(found), _LOOKS_SPREAD, rate)

    def _merge(
        self, track: np.ndarray, found: Detections, detection: np.ndarray
    ) -> np.ndarray:
        """Let named particles that vanish into the outline of another go on with it.

        The older of the two keeps the outline. Returns the tracks of the detections.
        """
        states, track = self.states, track.copy()
        lost = np.setdiff1d(np.flatnonzero((states.id != _UNNAMED) & (states.host < 0)), track)
        for i in lost[np.argsort(-states.hits[lost])]:
            offset = np.linalg.norm(found.xy[detection] - states.xy[i], axis=1)
            inside = offset - found.radius[detection] - states.radius[i] / 2
            if states.missed[i] > 0 or len(inside) == 0 or not inside.min() < 0:
                continue
            k = int(np.argmin(inside))
            other = track[k]
            if states.id[other] == _UNNAMED:
                continue
            if states.hits[i] > states.hits[other]:
                track[k], other, i = i, i, other
            states.host[i] = states.id[other]
        return track

    def _follow_hosts(self) -> None:
        """Merged particles are where their host is, give or take its radius."""
        states = self.states
        states.host[states.missed == 0] = -1
        row = {int(name): k for k, name in enumerate(states.id) if name != _UNNAMED}
        for i in np.flatnonzero(states.host >= 0):
            host = row.get(int(states.host[i]))
            while host is not None and states.host[host] >= 0 and host != i:
                host = row.get(int(states.host[host]))
            if host is None or host == i or states.missed[host] > 0:
                states.host[i] = -1
                states.missed[i] = 1
                continue
            states.host[i] = states.id[host]
            states.xy[i], states.velocity[i] = states.xy[host], states.velocity[host]
            states.covariance[i, :2] = states.radius[host] ** 2, 0.0

    def _learn(self, track: np.ndarray, found: Detections, detection: np.ndarray) -> None:
        states = self.states
        step = found.xy[detection] - states.measured[track] - self._shift
        again = (states.missed[track] == 0) & np.isfinite(states.step[track, 0])
        again &= found.sigma[detection] < _TOUCHED * self._diameter
        self._motion.learn(step[again], states.step[track][again], found.sigma[detection][again])
        states.step[track] = np.where((states.missed[track] == 0)[:, None], step, np.nan)

    def _correct(
        self, track: np.ndarray, found: Detections, detection: np.ndarray, noise: np.ndarray
    ) -> None:
        """Kalman update per coordinate; what is published is the measurement itself."""
        states = self.states
        innovation = found.xy[detection] - states.xy[track]
        surprise = np.mean(innovation**2, axis=1) / (states.covariance[track, 0] + noise)
        # A particle that starts, stops or turns has outrun its covariance; let that catch up.
        doubt = np.maximum(surprise / _SURPRISE, 1.0)[:, None]
        place, both, speed = (states.covariance[track] * doubt).T
        total = place + noise
        gain_place, gain_speed = place / total, both / total
        states.xy[track] += gain_place[:, None] * innovation
        states.velocity[track] += gain_speed[:, None] * innovation
        states.covariance[track] = np.column_stack([
            (1 - gain_place) * place, (1 - gain_place) * both, speed - gain_speed * both])
        states.measured[track] = found.xy[detection]
        states.sigma[track] = found.sigma[detection]
        states.theta[track] = found.theta[detection]
        # What a clump looks like says nothing about its parts, once they part.
        alone = ~np.isin(states.id[track], states.host[states.host >= 0])
        for name in ('contrast', 'radius'):
            value, now = getattr(states, name), getattr(found, name)[detection]
            value[track[alone]] *= (now[alone] / value[track[alone]]) ** 0.2

    def _bury(self) -> None:
        states = self.states
        patience = np.where(states.id == _UNNAMED, 0, self._settings.coast_frames)
        height, width = self._size
        x, y = states.xy.T
        inside = (x > -0.5) & (y > -0.5) & (x < width - 0.5) & (y < height - 0.5)
        living = (states.missed <= patience) | (states.host >= 0)
        self.states = states.take(living & (inside | (states.missed == 0)))

    def _christen(self) -> None:
        states = self.states
        often = states.hits >= self._settings.confirm_frames
        due = np.flatnonzero((states.id == _UNNAMED) & often)
        states.id[due] = self._next_id + np.arange(len(due))
        self._next_id += len(due)

    def _born(self, found: Detections) -> TrackStates:
        count = len(found)
        dt = self._interval or 1.0
        speed = max(self._motion.velocity_step, (self._max_step / 4) ** 2) / dt**2
        return TrackStates(
            id=np.full(count, _UNNAMED), xy=found.xy.copy(), velocity=np.zeros((count, 2)),
            covariance=np.column_stack([
                found.sigma**2 + _LEAST_SIGMA**2, np.zeros(count), np.full(count, speed)]),
            measured=found.xy.copy(), step=np.full((count, 2), np.nan), sigma=found.sigma.copy(),
            theta=found.theta.copy(), contrast=found.contrast.copy(), radius=found.radius.copy(),
            hits=np.ones(count, int), missed=np.zeros(count, int), host=np.full(count, -1),
        )


def _within(places: np.ndarray, others: np.ndarray, distance: float) -> np.ndarray:
    """How many of `others` (M, 2) lie within `distance` of each of `places` (N, 2)."""
    from scipy.spatial import cKDTree

    if len(others) == 0:
        return np.zeros(len(places), int)
    count: np.ndarray = cKDTree(others).query_ball_point(places, distance, return_length=True)
    return count


def _looks(of: TrackStates | Detections) -> np.ndarray:
    """Traits (N, 2) that tell particles apart: logarithms of contrast and radius."""
    return np.log(np.column_stack([of.contrast, of.radius]))


def _none() -> TrackStates:
    empty = np.empty(0)
    return TrackStates(
        id=np.empty(0, int), xy=np.empty((0, 2)), velocity=np.empty((0, 2)),
        covariance=np.empty((0, 3)), measured=np.empty((0, 2)), step=np.empty((0, 2)),
        sigma=empty, theta=empty, contrast=empty, radius=empty, hits=np.empty(0, int),
        missed=np.empty(0, int), host=np.empty(0, int),
    )
