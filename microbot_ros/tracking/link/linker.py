"""Which detection is which particle: prediction, gating, global assignment, birth and death."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from microbot_ros.common.compiled import numba
from microbot_ros.tracking.link.assign import Pairs, assign
from microbot_ros.tracking.link.doubt import doubt_told, grow_doubt, note_doubt, settle_doubt
from microbot_ros.tracking.link.global_motion import common_displacement, common_shake
from microbot_ros.tracking.link.heading import orient
from microbot_ros.tracking.link.looks import LOOKS_SPREAD, looks
from microbot_ros.tracking.link.lost import Lost
from microbot_ros.tracking.link.motion import Motion
from microbot_ros.tracking.link.states import (
    LEAST_SIGMA,
    PLACE,
    UNNAMED,
    VELOCITY_PHASOR,
    TrackStates,
    initiate_tracks,
    phasor,
    planar,
)
from microbot_ros.tracking.locate.detect import Detections
from microbot_ros.tracking.refine.appearance import Appearance
from microbot_ros.tracking.refine.neighbours import count_within
from microbot_ros.tracking.settings import TrackerSettings

_MISS_RATE = 0.02
"""Probability that a particle in view is not detected in a frame."""

_BIRTHS = (0.5, 0.02)
"""New particles per frame: the first guess, and the least that is reckoned with."""

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

    Who is unseen for longer than `coast_frames` is let go, but remembered: see `Lost`. `size` is
    the height and width [px] of the pictures.
    """

    def __init__(
        self, settings: TrackerSettings, appearance: Appearance, size: tuple[int, int]
    ) -> None:
        self._size = size
        self._motion = Motion(appearance.diameter_px)
        self.look_for(settings, appearance)
        self._birth_rate = _BIRTHS[0]
        self._next_id = 0
        self._interval: float | None = None
        self._drive_rate = 0.0
        self._jump: np.ndarray | None = None
        self._expected_step = np.empty((0, 2))
        self._early_frames = settings.confirm_frames - 1
        nothing = np.empty(0)
        self.states = initiate_tracks(
            np.empty((0, 2)), nothing, nothing, nothing, nothing, np.empty(0, int), 0.0, 0.0,
            self._early_frames)
        self._lost = Lost(self.states)
        self.named = self.states
        """The particles that were given their identities in the last frame."""

    def look_for(self, settings: TrackerSettings, appearance: Appearance) -> None:
        """Go on by other `settings`, with particles of another `appearance`."""
        self._diameter = appearance.diameter_px
        self._settings = settings
        # Round particles that touch are told apart by the fit; outlines run into one.
        self._merging = not appearance.round
        # Of a body of a taught kind the outline shows an axis; of a cap, the direction.
        self._axes = bool(settings.kinds)
        self.max_step_px = settings.max_step_px or appearance.diameter_px

    def renumber_kinds(self, numbers: np.ndarray) -> None:
        """Kind k is number `numbers`[k] from now on; −1: none, and its particles are let go."""
        self.states = _renumbered(self.states, numbers)
        self._lost.states = _renumbered(self._lost.states, numbers)

    @property
    def jump(self) -> float:
        """How far the whole picture jumped in the last frame [px]; 0 where it did not."""
        size = 0.0 if self._jump is None else float(np.linalg.norm(self._jump))
        return size if size > _JUMPED * self._diameter else 0.0

    @property
    def doubts(self) -> dict[str, str]:
        """Who may be another than its identity says: kind of remark → sentence."""
        return doubt_told(self.states)

    def predict(self, dt: float, drive: complex) -> None:
        """Move all to where they should be `dt` [s] later, after so much drive."""
        self._interval = dt if self._interval is None else 0.95 * self._interval + 0.05 * dt
        everybody = self.states, self._lost.states
        if abs(drive) / dt > 1.01 * self._drive_rate:
            # What was learned from less drive, or from a part of a frame, says next to nothing.
            self._drive_rate = abs(drive) / dt
            for states in everybody:
                states.forget_velocity_phasor(self._phasor_variance)
        self._expected_step = planar(drive * self.states.motion[:, VELOCITY_PHASOR])
        for states in everybody:
            states.predict(dt, self._interval, drive, self._motion, self._phasor_variance)
        grow_doubt(self.states, dt / self._interval, self._motion)

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

    def update(self, found: Detections) -> None:
        """Give each detection to a particle, or to a new one; drop who was unseen too long."""
        states = self.states
        offset = self._jumped(found)
        found, noise = self._doubted(found)
        pairs = self._associate(found, noise, offset)
        note_doubt(states, pairs)
        track, detection = pairs.track, pairs.detection
        if self._merging:
            track = self._merge(track, found, detection)
        alone = np.ones(len(track), bool)
        if self._merging:
            # What a clump looks like says nothing about its parts, once they part.
            alone = ~np.isin(states.id[track], states.host[states.host >= 0])
        before = states.measured[track]
        self._motion.learn(*_take_over(
            track, detection, found.xy, found.sigma, found.theta, found.contrast, found.radius,
            alone, self._expected_step, _TOUCHED * self._diameter, states.measured, states.step,
            states.sigma, states.theta, states.contrast, states.radius, states.hits,
            states.missed, states.early))
        if self._axes:
            orient(states, track, states.measured[track] - before)
        # In an outline that it shares, it is not known to be in the middle.
        states.correct(track, found.xy[detection], np.where(
            alone, noise[detection], np.maximum(noise, found.radius**2)[detection]))
        states.outline[track] = found.radius[detection]
        if self._merging:
            states.keep_within(track[~alone], found.xy[detection[~alone]])
            self._follow_hosts()
        settle_doubt(states, self._settings.coast_frames)
        self._delete_tracks()
        self._confirm_tracks()
        births = len(found) - len(detection)
        if len(track):
            self._birth_rate += 0.02 * (births - self._birth_rate)
            self._birth_rate = max(self._birth_rate, _BIRTHS[1])
        if births:
            fresh = np.ones(len(found), bool)
            fresh[detection] = False
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
        self._lost.states.motion[:, PLACE] += phasor(self._jump)
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
        sigma, noise = _overlapping(found.xy, found.sigma, named, self._diameter)
        found = Detections(found.xy, sigma, found.theta, found.contrast, found.radius,
                           found.quality, found.kind)
        return found, noise

    def _associate(
        self, found: Detections, noise: np.ndarray, offset: np.ndarray
    ) -> Pairs:
        states = self.states
        variance, reach = _search(
            states.covariance, states.missed, states.host, states.id, states.outline,
            self.max_step_px)
        return assign(
            states.xy + offset, variance, reach,
            looks(states.contrast, states.radius, states.kind), np.zeros(len(states)),
            found.xy, noise, looks(found.contrast, found.radius, found.kind), LOOKS_SPREAD,
            _MISS_RATE * self._strangers)

    @property
    def _strangers(self) -> float:
        """How many turn up in a frame, per px²."""
        return self._birth_rate / (self._size[0] * self._size[1])

    def _merge(
        self, track: np.ndarray, found: Detections, detection: np.ndarray
    ) -> np.ndarray:
        """Let named particles that vanish into the outline of another go on with it.

        The older of the two keeps the outline. Returns the tracks of the detections.
        """
        states, track = self.states, self._hosts_first(track)
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
            if (states.hits[i], -states.id[i]) > (states.hits[other], -states.id[other]):
                track[k], other, i = i, i, other
            states.host[i] = states.id[other]
        return track

    def _hosts_first(self, track: np.ndarray) -> np.ndarray:
        """The tracks of the detections, with the host in place of who goes with it unseen.

        As long as there is one outline for both, it goes on as that of the host, whatever the
        looks that each had on its own.
        """
        states, track, row = self.states, track.copy(), self._row_of_name()
        for k in np.flatnonzero(states.host[track] >= 0):
            host = row.get(int(states.host[track[k]]))
            if host is not None and host not in track:
                track[k] = host
        return track

    def _follow_hosts(self) -> None:
        """Merged particles are where their host is, give or take its radius."""
        states, row = self.states, self._row_of_name()
        states.host[states.missed == 0] = -1
        for i in np.flatnonzero(states.host >= 0):
            host = row.get(int(states.host[i]))
            while host is not None and states.host[host] >= 0 and host != i:
                host = row.get(int(states.host[host]))
            if host is None or host == i:
                states.host[i] = -1
                states.missed[i] = 1
                continue
            states.host[i] = states.id[host]
            states.motion[i, :VELOCITY_PHASOR] = states.motion[host, :VELOCITY_PHASOR]
            states.covariance[i, PLACE] = states.covariance[i, :, PLACE] = 0.0
            states.covariance[i, PLACE, PLACE] = states.radius[host] ** 2

    def _row_of_name(self) -> dict[int, int]:
        return {int(name): k for k, name in enumerate(self.states.id) if name != UNNAMED}

    def _delete_tracks(self) -> None:
        states = self.states
        stay = _staying(states.id, states.motion, states.missed, states.host,
                        self._settings.coast_frames, self._size)
        if not stay.all():
            self._lost.states = self._lost.states.join(states.take(~stay & (states.id != UNNAMED)))
            self.states = states.take(stay)
        if len(self._lost.states):
            self._lost.states.missed += 1
            self._lost.forget(self._strangers, self._size)

    def _confirm_tracks(self) -> None:
        states = self.states
        due = (states.id == UNNAMED) & (states.hits >= self._settings.confirm_frames)
        if due.any() or len(self.named):
            count = int(due.sum())
            states.id[due] = self._next_id + np.arange(count)
            if len(self._lost.states) and count:
                self._recognise(np.flatnonzero(due))
            self._next_id += int(np.sum(states.id[due] >= self._next_id))
            self.named = states.take(due)

    def _recognise(self, rows: np.ndarray) -> None:
        """Give their identities back to those of these new rows who were lost."""
        states, lost = self.states, self._lost.states
        pairs = self._lost.returned(states.take(rows), self._strangers)
        back = rows[pairs.detection]
        for name in ('id', 'hits', 'kind', 'doubt', 'unsure', 'astray'):
            getattr(states, name)[back] = getattr(lost, name)[pairs.track]
        note_doubt(states, replace(pairs, track=back))
        # No number is left out.
        strangers = np.setdiff1d(rows, back)
        states.id[strangers] = self._next_id + np.arange(len(strangers))
        self._lost.states = lost.take(np.setdiff1d(np.arange(len(lost)), pairs.track))

    def _initiate_tracks(self, found: Detections) -> TrackStates:
        speed = max(self._motion.velocity_step, (self.max_step_px / 4) ** 2)
        return initiate_tracks(
            found.xy, found.sigma, found.theta, found.contrast, found.radius, found.kind,
            speed / (self._interval or 1.0) ** 2, self._phasor_variance, self._early_frames)


def _renumbered(states: TrackStates, numbers: np.ndarray) -> TrackStates:
    """Those of kinds that go on: kind k is number `numbers`[k], and none where that is −1."""
    kind = numbers[states.kind]
    states = states.take(kind >= 0)
    states.kind = kind[kind >= 0]
    return states


def _goes_on(before: np.ndarray, now: np.ndarray) -> bool:
    """Whether a displacement (2,) is of the same motion as that before, as far as not learned."""
    share = np.clip(now @ before / (before @ before), 0, 1)
    return bool(np.linalg.norm(now - share * before) < _GOES_ON * np.linalg.norm(now))


@numba.njit(cache=True)
def _search(covariance, missed, host, ids, outline, max_step):  # type: ignore[no-untyped-def]
    """Variance [px²] of every particle's place, and how far [px] it is looked for: (N,).

    Where two go in one outline, neither is known to be in the middle of it.
    """
    variance, reach = np.empty(len(missed)), np.empty(len(missed))
    for n in range(len(missed)):
        variance[n] = covariance[n, PLACE, PLACE].real
        reach[n] = max_step * math.sqrt(1.0 + missed[n])
    for part in np.flatnonzero(host >= 0):
        reach[part] = max_step + math.sqrt(variance[part])
        for k in np.flatnonzero(ids == host[part]):
            variance[k] = max(variance[k], outline[k] ** 2)
            reach[k] = max(reach[k], max_step + math.sqrt(variance[k]))
    return variance, reach


@numba.njit(cache=True)
def _overlapping(xy, sigma, named, diameter):  # type: ignore[no-untyped-def]
    """σ (N,) of detections, larger where one is seen for two, and the variance to link with."""
    wide, noise = np.empty(len(sigma)), np.empty(len(sigma))
    detections = count_within(xy, xy, _OVERLAP * diameter)
    expected = count_within(xy, named, _OVERLAP * diameter)
    for n in range(len(sigma)):
        hidden = _HIDDEN * diameter if expected[n] > detections[n] else 0.0
        touched = _TOUCHED * diameter if detections[n] > 1 else 0.0
        wide[n] = math.hypot(sigma[n], hidden)
        noise[n] = wide[n]**2 + touched**2 + LEAST_SIGMA**2
    return wide, noise


@numba.njit(cache=True)
def _take_over(  # type: ignore[no-untyped-def]
        track, detection, xy, found_sigma, found_theta, found_contrast, found_radius, alone,
        expected_step, certain, measured, step, sigma, theta, contrast, radius, hits, missed,
        early):
    """Note in the states how the particles look; what is published is the measurement itself.

    The displacements (M, 2) of those followed through, in the frame before too, and σ (M,).
    """
    steps, previous = np.empty((len(track), 2)), np.empty((len(track), 2))
    spread, count = np.empty(len(track)), 0
    missed += 1
    for j, i in enumerate(track):
        k = detection[j]
        x = xy[k, 0] - measured[i, 0] - expected_step[i, 0]
        y = xy[k, 1] - measured[i, 1] - expected_step[i, 1]
        followed = missed[i] == 1
        if followed and math.isfinite(step[i, 0]) and found_sigma[k] < certain:
            steps[count, 0], steps[count, 1], spread[count] = x, y, found_sigma[k]
            previous[count] = step[i]
            count += 1
        step[i, 0], step[i, 1] = (x, y) if followed else (np.nan, np.nan)
        measured[i], sigma[i], theta[i] = xy[k], found_sigma[k], found_theta[k]
        if alone[j]:
            contrast[i] *= (found_contrast[k] / contrast[i]) ** 0.2
            radius[i] *= (found_radius[k] / radius[i]) ** 0.2
        missed[i] = 0
        hits[i] += 1
        if hits[i] <= early.shape[1]:
            early[i, hits[i] - 1] = measured[i]
    for i in range(len(missed)):
        if missed[i] > 0:
            step[i], theta[i] = np.nan, np.nan
    return steps[:count], previous[:count], spread[:count]


@numba.njit(cache=True)
def _staying(ids, motion, missed, host, coasting, size):  # type: ignore[no-untyped-def]
    """Which particles (N,) are still followed."""
    stay = np.empty(len(ids), np.bool_)
    for n in range(len(ids)):
        x, y = motion[n, PLACE].real, motion[n, PLACE].imag
        inside = -0.5 < x < size[1] - 0.5 and -0.5 < y < size[0] - 0.5
        patience = 0 if ids[n] == UNNAMED else coasting
        stay[n] = (missed[n] <= patience or host[n] >= 0) and (inside or missed[n] == 0)
    return stay
