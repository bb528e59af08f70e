"""Linking of detections: prediction, gating, global assignment, birth and death of tracks."""

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
"""Choice: probability that a visible particle is not detected in a frame."""

_BIRTHS = (0.5, 0.02)
"""Choices: new particles per frame, initially and at least."""

_OVERLAP = 1.0
"""Choice: diameters below which two particles overlap in the picture."""

_TOUCHED, _HIDDEN = 0.1, 0.35
"""Choices, in diameters: position error where particles overlap, and where one hides another."""

_JUMPED = 0.5
"""Choice: diameters by which most particles are off when a jump is considered."""

_SHAKEN, _ALIKE = 0.1, 0.15
"""Choices, in diameters: common displacements that are compensated, and their tolerance."""

_GOES_ON = 0.25
"""Choice: relative deviation from the last common displacement up to which it is one motion."""

_EXPECTED_FOR = 5
"""Choice: frames for which a missed particle is still searched at its prediction."""

class Linker:
    """Follows particles from frame to frame. Identities count up from 0 and are never reused.

    A particle that is missed for more than `coast_frames` is dropped, but remembered: see `Lost`.
    `settings` and `appearance` describe the particles; `size` is height and width of the pictures
    [px].

    Parameters
    ----------
    settings : TrackerSettings
        Settings of the tracker.
    appearance : Appearance
        The learned picture.
    size : tuple[int, int]
        Height and width of the pictures [px].
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
        """Particles that received their identities in the last frame."""

    def look_for(self, settings: TrackerSettings, appearance: Appearance) -> None:
        """Continue with other `settings` and particles of another `appearance`.

        Parameters
        ----------
        settings : TrackerSettings
            Settings of the tracker.
        appearance : Appearance
            The learned picture.
        """
        self._diameter = appearance.diameter_px
        self._settings = settings
        # The fit separates round particles that touch; outlines merge.
        self._merging = not appearance.round
        # The outline of a taught kind shows an axis only, a cap shows a direction.
        self._axes = bool(settings.kinds)
        self.max_step_px = settings.max_step_px or appearance.diameter_px

    def renumber_kinds(self, numbers: np.ndarray) -> None:
        """Renumber kind k as `numbers`[k]; −1 drops the kind and its particles.

        Parameters
        ----------
        numbers : ndarray
            New number of each kind; −1 to drop it.
        """
        self.states = _renumbered(self.states, numbers)
        self._lost.states = _renumbered(self._lost.states, numbers)

    @property
    def jump(self) -> float:
        """Jump of the whole picture in the last frame [px]; 0 if there was none."""
        size = 0.0 if self._jump is None else float(np.linalg.norm(self._jump))
        return size if size > _JUMPED * self._diameter else 0.0

    @property
    def doubts(self) -> dict[str, str]:
        """Particles with uncertain identity: kind of remark → sentence."""
        return doubt_told(self.states)

    def predict(self, dt: float, drive: complex) -> None:
        """Predict all particles `dt` [s] ahead, under a `drive` integrated over that time.

        Parameters
        ----------
        dt : float
            Time ahead [s].
        drive : complex
            Drive, complex, integrated over that time.
        """
        self._interval = dt if self._interval is None else 0.95 * self._interval + 0.05 * dt
        everybody = self.states, self._lost.states
        if abs(drive) / dt > 1.01 * self._drive_rate:
            # Values learned under less drive, or in part of a frame, are too uncertain to keep.
            self._drive_rate = abs(drive) / dt
            for states in everybody:
                states.forget_velocity_phasor(self._phasor_variance)
        self._expected_step = planar(drive * self.states.motion[:, VELOCITY_PHASOR])
        for states in everybody:
            states.predict(dt, self._interval, drive, self._motion, self._phasor_variance)
        grow_doubt(self.states, dt / self._interval, self._motion)

    @property
    def _phasor_variance(self) -> float:
        """Variance of a velocity phasor before it is learned."""
        if self._drive_rate == 0.0 or self._interval is None:
            return 0.0
        return (self.max_step_px / 4 / (self._drive_rate * self._interval)) ** 2

    def expected(self) -> np.ndarray:
        """Return positions (M, 2) [px] at which named particles are to be searched.

        Returns
        -------
        ndarray, shape (M, 2)
            Positions [px].
        """
        states = self.states
        near = (states.id != UNNAMED) & (states.missed < _EXPECTED_FOR)
        return states.xy[near]

    def update(self, found: Detections) -> None:
        """Assign each detection `found` to an old or a new particle; drop those long missed.

        Parameters
        ----------
        found : Detections
            The detections.
        """
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
            # The appearance of a clump is not that of its parts after they separate.
            alone = ~np.isin(states.id[track], states.host[states.host >= 0])
        before = states.measured[track]
        self._motion.learn(*self._take_over(track, found[detection], alone))
        if self._axes:
            orient(states, track, states.measured[track] - before)
        # In a shared outline a particle need not be in the middle.
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

    def _take_over(self, track: np.ndarray, seen: Detections, alone: np.ndarray,
                   ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Write appearance and measurements of `seen` particles into the states of each `track`.

        A particle that shares its outline, and is not `alone`, keeps its appearance. Published
        positions are measurements. Returns displacements (M, 2) in this frame and in the last, and
        σ (M,), of the M particles that were followed in both.
        """
        states = self.states
        states.missed += 1
        followed = states.missed[track] == 1
        step = seen.xy - states.measured[track] - self._expected_step[track]
        known = followed & np.isfinite(states.step[track, 0])
        known &= seen.sigma < _TOUCHED * self._diameter
        learned = step[known], states.step[track[known]], seen.sigma[known]
        states.step[:], states.theta[:] = np.nan, np.nan
        states.step[track[followed]] = step[followed]
        states.measured[track], states.sigma[track] = seen.xy, seen.sigma
        states.theta[track] = seen.theta
        own = track[alone]
        states.contrast[own] *= (seen.contrast[alone] / states.contrast[own]) ** 0.2
        states.radius[own] *= (seen.radius[alone] / states.radius[own]) ** 0.2
        states.missed[track] = 0
        states.hits[track] += 1
        early = track[states.hits[track] <= states.early.shape[1]]
        states.early[early, states.hits[early] - 1] = states.measured[early]
        return learned

    def _jumped(self, found: Detections) -> np.ndarray:
        """Return the offset (2,) [px] of the predictions, if the whole picture moved.

        A jump or shaking is not a velocity: the states take it as a new position. If it continues
        in the next frame it is common motion, which is left to the filter.
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
        """Return the displacement (2,) [px] of the whole picture, if large enough to mislead."""
        jump = common_displacement(seen, found, _JUMPED * self._diameter, self._size)
        if jump is not None:
            return jump
        shake = common_shake(seen, found, self.max_step_px, _ALIKE * self._diameter)
        if shake is None or np.linalg.norm(shake) < _SHAKEN * self._diameter:
            return None
        return shake

    def _doubted(self, found: Detections) -> tuple[Detections, np.ndarray]:
        """Return detections with larger σ where one hides another, and the linking variance.

        The error of the fit holds for isolated particles: where particles overlap, a position may
        be off by more, and must not distort the prediction.
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
        """New particles per frame and px²."""
        return self._birth_rate / (self._size[0] * self._size[1])

    def _merge(
        self, track: np.ndarray, found: Detections, detection: np.ndarray
    ) -> np.ndarray:
        """Attach named particles that vanish into another's outline; return the tracks (N,).

        The older of the two keeps the outline.
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
        """Return the tracks of the detections, with the host in place of particles merged into it.

        As long as both share one outline, it is that of the host, whatever both looked like
        before.
        """
        states, track, row = self.states, track.copy(), self._row_of_name()
        for k in np.flatnonzero(states.host[track] >= 0):
            host = row.get(int(states.host[track[k]]))
            if host is not None and host not in track:
                track[k] = host
        return track

    def _follow_hosts(self) -> None:
        """Place merged particles at their host, with its radius as uncertainty."""
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
        """Return their identities to those of the new `rows` that were lost."""
        states, lost = self.states, self._lost.states
        pairs = self._lost.returned(states.take(rows), self._strangers)
        back = rows[pairs.detection]
        for name in ('id', 'hits', 'kind', 'doubt', 'unsure', 'astray'):
            getattr(states, name)[back] = getattr(lost, name)[pairs.track]
        note_doubt(states, replace(pairs, track=back))
        # Numbers stay consecutive.
        strangers = np.setdiff1d(rows, back)
        states.id[strangers] = self._next_id + np.arange(len(strangers))
        self._lost.states = lost.take(np.setdiff1d(np.arange(len(lost)), pairs.track))

    def _initiate_tracks(self, found: Detections) -> TrackStates:
        speed = max(self._motion.velocity_step, (self.max_step_px / 4) ** 2)
        return initiate_tracks(
            found.xy, found.sigma, found.theta, found.contrast, found.radius, found.kind,
            speed / (self._interval or 1.0) ** 2, self._phasor_variance, self._early_frames)


def _renumbered(states: TrackStates, numbers: np.ndarray) -> TrackStates:
    """Return the states with kind k renumbered as `numbers`[k], dropped where that is −1."""
    kind = numbers[states.kind]
    states = states.take(kind >= 0)
    states.kind = kind[kind >= 0]
    return states


def _goes_on(before: np.ndarray, now: np.ndarray) -> bool:
    """Return whether a displacement (2,) continues the last one, as far as not yet learned."""
    share = np.clip(now @ before / (before @ before), 0, 1)
    return bool(np.linalg.norm(now - share * before) < _GOES_ON * np.linalg.norm(now))


@numba.njit(cache=True)
def _search(covariance, missed, host, ids, outline, max_step):  # type: ignore[no-untyped-def]
    """Return the position variance [px²] of every particle and its search radius [px], (N,).

    If two share an outline, neither is known to be in its middle.
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
    """Return σ (N,) of detections, larger where one hides another, and the linking variance."""
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
def _staying(ids, motion, missed, host, coasting, size):  # type: ignore[no-untyped-def]
    """Return which particles (N,) are still followed."""
    stay = np.empty(len(ids), np.bool_)
    for n in range(len(ids)):
        x, y = motion[n, PLACE].real, motion[n, PLACE].imag
        inside = -0.5 < x < size[1] - 0.5 and -0.5 < y < size[0] - 0.5
        patience = 0 if ids[n] == UNNAMED else coasting
        stay[n] = (missed[n] <= patience or host[n] >= 0) and (inside or missed[n] == 0)
    return stay
