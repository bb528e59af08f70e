"""Online estimator of position, speed and direction of every particle."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from microbot_ros.common.compiled import numba
from microbot_ros.common.errors import InputError
from microbot_ros.common.records import Conditions
from microbot_ros.estimation.held import HeldWatch
from microbot_ros.estimation.likelihood.noise import Noise, stokes_einstein
from microbot_ros.estimation.online.commands import SET_BACK, CommandLog
from microbot_ros.estimation.online.estimates import FASTEST, Estimates, Settings, State, answer
from microbot_ros.estimation.online.jumps import JumpNotes
from microbot_ros.estimation.online.monitor import Monitor
from microbot_ros.estimation.online.population import AGAIN, Population, Readings
from microbot_ros.estimation.online.propagation import HEADING_MEMORY, Propagator, Swarm
from microbot_ros.estimation.online.shared import SharedKnowledge
from microbot_ros.estimation.online.track_faults import TrackFaults
from microbot_ros.estimation.online.window import SECONDS
from microbot_ros.model.io.model_file import read_model
from microbot_ros.model.model import Model
from microbot_ros.model.physics.vectors import as_complex

__all__ = ['Estimates', 'Estimator', 'Settings']

LONGEST_OPENING = 200
"""Frames after which the first ones are not kept for a second filtering. Choice: some seconds."""

NOTED = 5.0
"""Time [s] for which a sentence stays in the diagnosis. Choice: long enough to be read."""

CHANGE_INTERVAL = 3600.0
"""Mean time [s] between abrupt changes of one particle's speed or direction.

Choice: an hour; a shorter one takes noise for changes more often, a longer one finds them later.
"""

WANDER = 1e-3
"""Relative random walk of speed and direction in one second.

Choice: a change of 1 % in 100 s is followed; a larger value blurs constant speeds.
"""

FARTHEST = 1.0
"""Largest coordinate or σ of a reading [m]. Choice: beyond any stage, so only errors exceed it."""

BEST = 0.01
"""Smallest variance of a reading in a frame, relative to that of typical ones.

Choice: a σ of a tenth; a reading that claims more is not trusted.
"""

_HELD = 'held by a wall or the edge of the image'
_RESTLESS = 'neither field nor noise explains the motion'


@dataclass(frozen=True)
class _Frame:
    """Usable readings of one frame: time, identities (n,), complex places, and σ or NaN."""

    t: float
    ids: np.ndarray
    z: np.ndarray
    sigma: np.ndarray


class Estimator:
    """Exact filter of every particle, with noise and delay learned from the recent past.

    Call it with commands and frames in the order of their time. One call of `update` costs about
    the same for one particle as for a hundred: all arrays are over particles.

    Parameters
    ----------
    conditions : Conditions, optional
        Conditions of the rig.
    settings : Settings, optional
        Settings of a user.
    model : Model, optional
        The model; by default the first-order one.
    """

    def __init__(
        self, conditions: Conditions | None = None, settings: Settings | None = None,
        model: Model | None = None,
    ) -> None:
        self.conditions = conditions or Conditions()
        self.settings = settings or Settings()
        self._log = CommandLog()
        self._notes: dict[str, float] = {}
        self._jumps = JumpNotes(NOTED)
        self._start(model or Model.baseline(self.conditions, self._log.since(0.0)))

    def _start(self, model: Model) -> None:
        self._begin(model)
        self._shared: SharedKnowledge | None = None
        self._opening: list[_Frame] | None = []
        self._monitor = Monitor()
        self._track_faults = TrackFaults(model.propulsion)
        self._faults: tuple[str, ...] = ()
        self._restless: set[int] = set()
        self._held = HeldWatch(model.propulsion == 'rolling')
        self._moved: dict[int, tuple[complex, complex]] = {}
        self._next_question = -np.inf
        self._t = -np.inf

    def _begin(self, model: Model) -> None:
        self._propagator = Propagator(model)
        self._population = Population(FASTEST / 2)

    @property
    def _rotational_diffusion(self) -> float:
        """Rotational diffusion [rad²/s]; 0 if radius or viscosity are unknown."""
        return (stokes_einstein(self.conditions) or (0.0, 0.0))[1]

    @property
    def model(self) -> Model:
        """Model of the filter."""
        return self._propagator.model

    def load(self, path: str | Path) -> None:
        """Use the model of a file from the next frame on.

        Parameters
        ----------
        path : str or Path
            A `model.yaml`.

        Raises
        ------
        InputError
            If the file is not valid or its propulsion differs; the old model stays in use.
        """
        model, _ = read_model(path)
        if model.propulsion != self.model.propulsion:
            raise InputError(path, f'expected propulsion: {self.model.propulsion}, as this '
                                   f'estimator was started with; found {model.propulsion}')
        self.use(model)

    def use(self, model: Model) -> None:
        """Use another model from the next frame on. Estimates of v and φ stay.

        Parameters
        ----------
        model : Model
            The model.
        """
        self._propagator = Propagator(model)
        self._monitor = Monitor()
        if self._shared is not None:
            self._shared.forget_model()

    def command(self, t: float, field: np.ndarray, frequency: float | None = None) -> None:
        """Add a command.

        Commands that are not finite or out of order are ignored, with a note in the diagnosis. A
        clock that is set back starts the log anew.

        Parameters
        ----------
        t : float
            Time from which it is in force [s].
        field : ndarray, shape (2,)
            Field [T].
        frequency : float, optional
            Frequency of rollers [Hz].
        """
        if math.isfinite(t) and t < self._log.last - SET_BACK:
            self._log = CommandLog()
        self._note(self._log.append(t, field, frequency))

    def update(
        self, t: float, ids: np.ndarray, position: np.ndarray, sigma: np.ndarray | None = None,
    ) -> Estimates:
        """Update with a frame.

        Readings that are not finite, or beyond a microscope's size, are ignored, and their
        particles coast. A frame that is not newer than the one before changes nothing; a clock
        that is set back restarts everything. The model's observation stage corrects the readings.
        A reading far from its prediction is refused, but only for a few frames: then the particle
        is restarted there.

        Parameters
        ----------
        t : float
            Time of exposure [s].
        ids : ndarray of int, shape (N,)
            Particles.
        position : ndarray, shape (N, 2)
            Positions [m].
        sigma : ndarray, shape (N,), optional
            Localisation errors as the tracker states them [m]; NaN where it does not.

        Returns
        -------
        Estimates
            The estimates after the frame.
        """
        if math.isfinite(t) and t < self._t - SET_BACK:
            self._start(self.model)
            self._notes, self._jumps = {}, JumpNotes(NOTED)
            self._note('the clock of the frames was set back; the estimator starts anew')
        if not (math.isfinite(t) and t > self._t):
            self._note(f'a frame is stamped {t:.6g} s, not later than the one before: ignored')
            return self._answer(np.zeros(len(self._population.ids), bool), ())
        frame = self._usable(t, ids, position, sigma)
        shared = self._knowledge(frame.sigma)
        readings, changed = self._filter(frame, shared)
        begun = self._begun_anew(readings)
        free = self._held.add(
            t, self._population.ids, readings.z, readings.seen, self._moved)
        self._population.begin_anew(free)
        self._watch(readings)
        shared.add(t, self._population.ids, readings, changed)
        if shared.work(t, self.model, self._log, self._population):
            self._track_faults.forget()
        self._refilter_opening(frame, shared)
        self._population.forget(t - self.settings.forget_after)
        self._log.forget_before(t - SECONDS - HEADING_MEMORY)
        return self._answer(self._population.last_seen == t, begun)

    def _begun_anew(self, readings: Readings) -> tuple[str, ...]:
        """Return sentences on particles whose predictions failed."""
        ids = self._population.ids
        rows = [row for row in readings.jumped if self._population.restarts[row] < AGAIN]
        for row in rows:
            self._jumps.add(self._t, int(ids[row]), abs(readings.jump[row]))
        jumped = {f'particle {ids[row]} ' for row in rows}
        jumps = tuple(text for text in self._jumps.sentences(self._t)
                      if text.startswith(tuple(jumped)))
        before, self._restless = self._restless, set(ids[readings.restless].tolist())
        new = self._restless - before
        return (*jumps, _of_restless(new)) if new else jumps

    def _usable(
        self, t: float, ids: np.ndarray, position: np.ndarray, sigma: np.ndarray | None,
    ) -> _Frame:
        """Return the readings that are finite, the first of each identity."""
        ids, position = np.array(ids, int), np.array(position, float).reshape(-1, 2)
        sigma = np.full(len(ids), np.nan) if sigma is None else np.array(sigma, float)
        if not _in_order(ids, position):
            ids, position, sigma = self._cleaned(ids, position, sigma)
        return _Frame(t, ids, as_complex(self.model.true_position(position)), sigma)

    def _cleaned(self, ids: np.ndarray, position: np.ndarray, sigma: np.ndarray,
                 ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        good = (np.abs(position) < FARTHEST).all(axis=1)
        for name, place in zip(ids[~good], position[~good], strict=True):
            what = 'is in no microscope' if np.isfinite(place).all() else 'is not a number'
            self._note(f'particle {name} was reported at a position that {what}')
        ids, position, sigma = ids[good], position[good], sigma[good]
        names, first, count = np.unique(ids, return_index=True, return_counts=True)
        for name in names[count > 1]:
            self._note(f'particle {name} was reported twice in one frame: the first is used')
        return names, position[first], sigma[first]

    def _knowledge(self, sigma: np.ndarray) -> SharedKnowledge:
        """Return noise and delay; assumed from conditions and tracker at the first reading."""
        if self._shared is not None:
            return self._shared
        diffusion, _ = stokes_einstein(self.conditions) or (1e-13, 0.0)
        stated = sigma[(sigma > 0) & (sigma < FARTHEST)]
        typical = float(np.median(stated)) if len(stated) else 1e-7
        shared = SharedKnowledge(Noise(diffusion, typical, self.settings.exposure))
        if len(sigma):
            self._shared = shared
        return shared

    def _filter(self, frame: _Frame, shared: SharedKnowledge,
                ) -> tuple[Readings, list[tuple[int, float]]]:
        """Predict and update with one frame; return its readings and which c changed."""
        bank, noise = self._population.bank, shared.noise
        start = self._t if math.isfinite(self._t) else frame.t - 1e-3
        step = self._propagator.advance(
            self._log, shared.delay.value, start, frame.t,
            Swarm(self._population.ids, bank.p[0], bank.velocity_phasor[0]))
        wander = (WANDER * np.abs(bank.velocity_phasor[0])) ** 2 * step.span
        # Where headings do not lag, their deviations are noise of the position.
        if (self.model.lags and self._rotational_diffusion > 0) or bank.s_var.any():
            bent = self._propagator.heading_deviation(
                self._log, shared.delay.value, start, frame.t
            )
            bank.predict_deviation(*bent, 2 * self._rotational_diffusion * step.span)
        delay, path, diffused = shared.delay.value, step.path, 2 * noise.diffusion * step.span
        if self._log.rests(start - delay, frame.t - delay):
            # The way is unknown, at most as long as that of the fastest: it says nothing about c.
            farthest = float(np.abs(bank.velocity_phasor[0]).max(initial=0.0)) * step.span
            path, diffused = 0 * path, diffused + farthest ** 2
        ids = self._population.ids
        both = (np.broadcast_to(part, len(ids)).tolist() for part in (path, step.drift))
        self._moved = dict(zip(ids.tolist(), zip(*both, strict=True), strict=True))
        bank.predict(path, step.drift, diffused, wander)
        self._t = frame.t
        readings = self._population.take(
            frame.t, frame.ids, frame.z, _reading_variance(
                noise.localisation**2, frame.sigma, noise.diffusion * noise.exposure / 3)
        )
        return readings, self._population.consider_changes(frame.t, CHANGE_INTERVAL)

    def _watch(self, readings: Readings) -> None:
        """Pass the innovations to the monitor, once the noise is learned."""
        if self._opening is None:
            heading = self._propagator.heading
            self._monitor.add(self._t, self._population.ids, readings.innovation,
                              readings.predicted, heading, readings.direction * heading)

    def _refilter_opening(self, frame: _Frame, shared: SharedKnowledge) -> None:
        """Filter the first frames again as soon as the noise has been learned from them.

        Until then noise levels are assumed, and frames weighted by wrong ones are never forgotten.
        """
        if self._opening is None:
            return
        self._opening.append(frame)
        if shared.reviewed or len(self._opening) >= LONGEST_OPENING:
            self._begin(self.model)
            self._t = -np.inf
            for again in self._opening:
                self._filter(again, shared)
            self._opening = None

    def _answer(self, seen: np.ndarray, begun_anew: tuple[str, ...]) -> Estimates:
        state = State(self._t, self._population.ids, seen,
                      *self._population.known(self._t, self._held.held))
        swarm = Swarm(state.ids, state.p, state.velocity_phasor)
        shared = self._shared or self._knowledge(np.empty(0))
        if self._t >= self._next_question:
            self._next_question = self._t + 1.0
            moving = bool(self._propagator.heading.any())
            self._faults = (
                *self._track_faults.find(state, self._log.last, moving),
                *self._propagator.beyond_learned(self._log, shared.delay.value, self._t, swarm))
        # Notes from before the first frame count from that frame on.
        self._notes = {
            text: max(at, self._t) if math.isinf(at) else at
            for text, at in self._notes.items() if math.isinf(at) or self._t - at < NOTED
        }
        told = (
            *self._notes, *self._jumps.sentences(self._t), *self._faults, *shared.sentences,
            *self._monitor.sentences
        )
        if self._restless:
            told = _of_restless(self._restless), *told
        if self._held.held:
            told = _of_held(self._held.held), *told
        now = self._t if math.isfinite(self._t) else 0.0
        ahead = self._propagator.look_ahead(
            self._log, shared.delay.value, now, now + max(self.settings.horizon, 1e-6), swarm)
        unknown = dict.fromkeys(self._restless, _RESTLESS) | dict.fromkeys(self._held.held, _HELD)
        return answer(state, ahead, shared, self.conditions, told, begun_anew,
                      self.model.gain_change_since_start(now), unknown)

    def _note(self, text: str) -> None:
        """Keep a sentence for the diagnosis of the next seconds."""
        if text:
            self._notes[text] = self._t


def _of_restless(ids: set[int]) -> str:
    names = ', '.join(map(str, sorted(ids)))
    return (f'particle{"s" * (len(ids) > 1)} {names}: neither field nor noise explains the '
            'motion, so v and φ are not known; positions are as measured')


def _of_held(ids: set[int]) -> str:
    names = ', '.join(map(str, sorted(ids)))
    return (f'particle{"s" * (len(ids) > 1)} {names}: held by a wall or the edge of the image, so '
            'v and φ are not known')


@numba.njit(cache=True)
def _in_order(ids, position):  # type: ignore[no-untyped-def]
    """Return whether `ids` (N,) ascend and every `position` (N, 2) fits a microscope."""
    for n in range(len(ids)):
        if n and not ids[n - 1] < ids[n]:
            return False
        if not (abs(position[n, 0]) < FARTHEST and abs(position[n, 1]) < FARTHEST):
            return False
    return True


@numba.njit(cache=True)
def _reading_variance(level, sigma, blur):  # type: ignore[no-untyped-def]
    """Return the variance (N,) of each reading: the learned `level`, distributed by `sigma` (N,).

    An exposure reduces it by `blur`. A reading far better than the others is not trusted as far,
    and one far worse is not worse than stated.
    """
    stated = sigma[(sigma > 0) & (sigma < FARTHEST)]
    typical = np.median(stated) if len(stated) else 1.0
    variance = np.empty(len(sigma))
    for n, value in enumerate(sigma):
        shared = level
        if 0 < value < FARTHEST:
            relative = max((value / typical) ** 2, BEST)
            shared = min(level * relative, max(level, value**2))
        variance[n] = max(shared - blur, 1e-20)
    return variance
