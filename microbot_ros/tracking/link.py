"""Which detection is which particle: prediction, gating, global assignment, birth and death."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from microbot_ros.tracking.appearance import Appearance
from microbot_ros.tracking.assign import assign
from microbot_ros.tracking.detect import Detections
from microbot_ros.tracking.global_motion import common_displacement, common_shake
from microbot_ros.tracking.motion import Motion
from microbot_ros.tracking.neighbours import count_within
from microbot_ros.tracking.settings import TrackerSettings
from microbot_ros.tracking.states import (
    LEAST_SIGMA,
    PLACE,
    UNNAMED,
    VELOCITY_PHASOR,
    TrackStates,
    initiate_tracks,
    phasor,
    planar,
)

_MISS_RATE = 0.02
"""Probability that a particle in view is not detected in a frame."""

_BIRTHS = (0.5, 0.02)
"""New particles per frame: the first guess, and the least that is reckoned with."""

_LOOKS_SPREAD = 0.25
"""Standard deviation of ln(contrast) and ln(radius) of one particle from frame to frame."""

_OVERLAP = 1.0
"""Diameters: particles nearer than this overlap in the picture."""

_TOUCHED, _HIDDEN = 0.1, 0.35
"""Diameters: error of a position where two particles overlap, and where one is seen for two."""

_JUMPED = 0.5
"""Diameters: when most particles are off by more, the picture may have jumped."""

_SHAKEN, _ALIKE = 0.1, 0.15
"""Diameters: common displacements that are made up for, and how far from one another they lie."""

_GOES_ON = 0.25
"""Share of a common displacement by which it may be off the last one's way to be one motion."""

_EXPECTED_FOR = 5
"""Frames for which an unseen particle is still looked for at its prediction."""

class Linker:
    """Follows particles from frame to frame. Identities count up from 0 and are never reused.

    `size` is the height and width [px] of the pictures.
    """

    def __init__(
        self, settings: TrackerSettings, appearance: Appearance, size: tuple[int, int]
    ) -> None:
        diameter_px = self._diameter = appearance.diameter_px
        self._settings = settings
        # Round particles that touch are told apart by the fit; outlines run into one.
        self._merging = not appearance.round
        self._size = size
        self._motion = Motion(diameter_px)
        self.max_step_px = settings.max_step_px or diameter_px
        self._birth_rate = _BIRTHS[0]
        self._next_id = 0
        self._interval: float | None = None
        self._drive_rate = 0.0
        self._jump: np.ndarray | None = None
        self._expected_step = np.empty((0, 2))
        self._early_frames = settings.confirm_frames - 1
        nothing = np.empty(0)
        self.states = initiate_tracks(
            np.empty((0, 2)), nothing, nothing, nothing, nothing, 0.0, 0.0, self._early_frames)
        self.named = self.states
        """The particles that were given their identities in the last frame."""

    @property
    def jump(self) -> float:
        """How far the whole picture jumped in the last frame [px]; 0 where it did not."""
        size = 0.0 if self._jump is None else float(np.linalg.norm(self._jump))
        return size if size > _JUMPED * self._diameter else 0.0

    def predict(self, dt: float, drive: complex) -> None:
        """Move all to where they should be `dt` [s] later, after so much drive."""
        self._interval = dt if self._interval is None else 0.95 * self._interval + 0.05 * dt
        states = self.states
        if abs(drive) / dt > 1.01 * self._drive_rate:
            # What was learned from less drive, or from a part of a frame, says next to nothing.
            self._drive_rate = abs(drive) / dt
            states.forget_velocity_phasor(self._phasor_variance)
        self._expected_step = planar(drive * states.motion[:, VELOCITY_PHASOR])
        states.predict(dt, self._interval, drive, self._motion, self._phasor_variance)

    @property
    def _phasor_variance(self) -> float:
        """What is reckoned with before a particle's velocity phasor is known."""
        if self._drive_rate == 0.0 or self._interval is None:
            return 0.0
        return (self.max_step_px / 4 / (self._drive_rate * self._interval)) ** 2

    def expected(self) -> np.ndarray:
        """Positions (M, 2) [px] at which named particles are to be looked for."""
        states = self.states
        near = (states.id != UNNAMED) & (states.missed < _EXPECTED_FOR)
        return states.xy[near]

    def update(self, found: Detections, everywhere: bool = True) -> None:
        """Give each detection to a particle, or to a new one; drop who was unseen too long.

        Only where the detections are from `everywhere` do they say how often new ones turn up.
        """
        states = self.states
        offset = self._jumped(found)
        found, noise = self._doubted(found)
        track, detection = self._associate(found, noise, offset)
        if self._merging:
            track = self._merge(track, found, detection)
        self._learn(track, found, detection)
        states.correct(track, found.xy[detection], noise[detection])
        self._describe(track, found, detection)
        states.missed = states.missed + 1
        states.missed[track] = 0
        states.hits[track] += 1
        young = track[states.hits[track] <= self._early_frames]
        states.early[young, states.hits[young] - 1] = states.measured[young]
        unseen = states.missed > 0
        states.step[unseen] = np.nan
        states.theta[unseen] = np.nan
        self._follow_hosts()
        self._delete_tracks()
        self._confirm_tracks()
        fresh = np.ones(len(found), bool)
        fresh[detection] = False
        if len(track) and everywhere:
            self._birth_rate += 0.02 * (int(fresh.sum()) - self._birth_rate)
            self._birth_rate = max(self._birth_rate, _BIRTHS[1])
        if np.any(fresh):
            self.states = self.states.join(self._initiate_tracks(found[fresh]))

    def _jumped(self, found: Detections) -> np.ndarray:
        """Where to look beside the predictions (2,) [px], if the whole picture moved.

        A jump is no velocity, nor is shaking: the states take it as their new place. What goes on
        in the next frame is motion in common, and is left to the filter.
        """
        states = self.states
        seen = states.xy[(states.id != UNNAMED) & (states.missed == 0)]
        before, self._jump = self._jump, self._moved(seen, found.xy)
        if self._jump is None:
            return np.zeros(2)
        if before is not None and _goes_on(before, self._jump):
            return self._jump
        states.motion[:, PLACE] += phasor(self._jump)
        self._expected_step = self._expected_step + self._jump
        return np.zeros(2)

    def _moved(self, seen: np.ndarray, found: np.ndarray) -> np.ndarray | None:
        """The displacement (2,) [px] of the whole picture, if it is enough to mislead."""
        jump = common_displacement(seen, found, _JUMPED * self._diameter, self._size)
        if jump is not None:
            return jump
        shake = common_shake(seen, found, self.max_step_px, _ALIKE * self._diameter)
        if shake is None or np.linalg.norm(shake) < _SHAKEN * self._diameter:
            return None
        return shake

    def _doubted(self, found: Detections) -> tuple[Detections, np.ndarray]:
        """Detections with larger σ where one is seen for two; the variance (N,) to link with.

        What the fit says of itself holds for a particle on its own: where particles overlap, a
        position may be off by more, and must not bend the prediction.
        """
        if self._merging or len(found) == 0:
            return found, found.sigma**2 + LEAST_SIGMA**2
        named = self.states.xy[self.states.id != UNNAMED]
        detections = count_within(found.xy, found.xy, _OVERLAP * self._diameter)
        expected = count_within(found.xy, named, _OVERLAP * self._diameter)
        hidden = np.where(expected > detections, _HIDDEN * self._diameter, 0.0)
        touched = np.where(detections > 1, _TOUCHED * self._diameter, 0.0)
        found = replace(found, sigma=np.hypot(found.sigma, hidden))
        return found, found.sigma**2 + touched**2 + LEAST_SIGMA**2

    def _associate(
        self, found: Detections, noise: np.ndarray, offset: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        states = self.states
        alone = states.host < 0
        wider = np.where(alone, np.sqrt(1.0 + states.missed), 1.0)
        reach = self.max_step_px * wider + np.where(alone, 0.0, np.sqrt(states.variance))
        rate = _MISS_RATE * self._birth_rate / (self._size[0] * self._size[1])
        return assign(
            states.xy + offset, states.variance, reach, _looks(states),
            found.xy, noise, _looks(found), _LOOKS_SPREAD, rate)

    def _merge(
        self, track: np.ndarray, found: Detections, detection: np.ndarray
    ) -> np.ndarray:
        """Let named particles that vanish into the outline of another go on with it.

        The older of the two keeps the outline. Returns the tracks of the detections.
        """
        states, track = self.states, track.copy()
        lost = np.setdiff1d(np.flatnonzero((states.id != UNNAMED) & (states.host < 0)), track)
        for i in lost[np.argsort(-states.hits[lost])]:
            offset = np.linalg.norm(found.xy[detection] - states.xy[i], axis=1)
            inside = offset - found.radius[detection] - states.radius[i] / 2
            if states.missed[i] > 0 or len(inside) == 0 or not inside.min() < 0:
                continue
            k = int(np.argmin(inside))
            other = track[k]
            if states.id[other] == UNNAMED:
                continue
            if states.hits[i] > states.hits[other]:
                track[k], other, i = i, i, other
            states.host[i] = states.id[other]
        return track

    def _follow_hosts(self) -> None:
        """Merged particles are where their host is, give or take its radius."""
        states = self.states
        states.host[states.missed == 0] = -1
        row = {int(name): k for k, name in enumerate(states.id) if name != UNNAMED}
        for i in np.flatnonzero(states.host >= 0):
            host = row.get(int(states.host[i]))
            while host is not None and states.host[host] >= 0 and host != i:
                host = row.get(int(states.host[host]))
            if host is None or host == i or states.missed[host] > 0:
                states.host[i] = -1
                states.missed[i] = 1
                continue
            states.host[i] = states.id[host]
            states.motion[i, :VELOCITY_PHASOR] = states.motion[host, :VELOCITY_PHASOR]
            states.covariance[i, PLACE] = states.covariance[i, :, PLACE] = 0.0
            states.covariance[i, PLACE, PLACE] = states.radius[host] ** 2

    def _learn(self, track: np.ndarray, found: Detections, detection: np.ndarray) -> None:
        states = self.states
        step = found.xy[detection] - states.measured[track] - self._expected_step[track]
        again = (states.missed[track] == 0) & np.isfinite(states.step[track, 0])
        again &= found.sigma[detection] < _TOUCHED * self._diameter
        self._motion.learn(step[again], states.step[track][again], found.sigma[detection][again])
        states.step[track] = np.where((states.missed[track] == 0)[:, None], step, np.nan)

    def _describe(self, track: np.ndarray, found: Detections, detection: np.ndarray) -> None:
        """Take over how the particles look; what is published is the measurement itself."""
        states = self.states
        states.measured[track] = found.xy[detection]
        states.sigma[track] = found.sigma[detection]
        states.theta[track] = found.theta[detection]
        # What a clump looks like says nothing about its parts, once they part.
        alone = ~np.isin(states.id[track], states.host[states.host >= 0])
        for name in ('contrast', 'radius'):
            value, now = getattr(states, name), getattr(found, name)[detection]
            value[track[alone]] *= (now[alone] / value[track[alone]]) ** 0.2

    def _delete_tracks(self) -> None:
        states = self.states
        patience = np.where(states.id == UNNAMED, 0, self._settings.coast_frames)
        height, width = self._size
        x, y = states.xy.T
        inside = (x > -0.5) & (y > -0.5) & (x < width - 0.5) & (y < height - 0.5)
        living = (states.missed <= patience) | (states.host >= 0)
        stay = living & (inside | (states.missed == 0))
        if not np.all(stay):
            self.states = states.take(stay)

    def _confirm_tracks(self) -> None:
        states = self.states
        often = states.hits >= self._settings.confirm_frames
        due = np.flatnonzero((states.id == UNNAMED) & often)
        states.id[due] = self._next_id + np.arange(len(due))
        self._next_id += len(due)
        self.named = states.take(due)

    def _initiate_tracks(self, found: Detections) -> TrackStates:
        speed = max(self._motion.velocity_step, (self.max_step_px / 4) ** 2)
        return initiate_tracks(
            found.xy, found.sigma, found.theta, found.contrast, found.radius,
            speed / (self._interval or 1.0) ** 2, self._phasor_variance, self._early_frames)


def _goes_on(before: np.ndarray, now: np.ndarray) -> bool:
    """Whether a displacement (2,) is of the same motion as that before, as far as not learned."""
    share = np.clip(now @ before / (before @ before), 0, 1)
    return bool(np.linalg.norm(now - share * before) < _GOES_ON * np.linalg.norm(now))


def _looks(of: TrackStates | Detections) -> np.ndarray:
    """Traits (N, 2) that tell particles apart: logarithms of contrast and radius."""
    return np.log(np.column_stack([of.contrast, of.radius]))
