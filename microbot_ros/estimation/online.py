"""The online estimator: where every particle is, how fast and which way it swims."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from microbot_ros.errors import InputError
from microbot_ros.estimation.commands import CommandLog
from microbot_ros.estimation.noise import Noise
from microbot_ros.estimation.phasor import Polar, polar
from microbot_ros.estimation.population import Population, Taken
from microbot_ros.estimation.propagation import Propagator
from microbot_ros.estimation.shared import SharedKnowledge
from microbot_ros.model.model import Model
from microbot_ros.model.model_file import read_model
from microbot_ros.model.particle import Fluid, stokes_drag, translational_diffusion
from microbot_ros.records import Conditions


LONGEST_OPENING = 200
"""Frames after which the first ones are no longer kept to be filtered again."""


@dataclass(frozen=True)
class Settings:
    """What a user may want different; SI."""

    horizon: float = 0.5
    """How far ahead to predict [s]."""
    forget_after: float = 5.0
    """Seconds without a sighting after which a particle is dropped."""
    exposure: float = 0.0
    """Exposure time of a frame [s]."""
    fastest: float = 20e-6
    """Largest plausible speed [m/s], or gain [m/s/Hz]: two standard deviations of the prior."""
    change_interval: float = 3600.0
    """Mean seconds between abrupt changes of one particle's speed or direction."""
    wander: float = 1e-3
    """Relative random walk of speed and direction in one second."""
    viscosity_relative_std: float = 0.05
    radius_relative_std: float = 0.05


@dataclass(frozen=True)
class Estimates:
    """What is known after a frame; one row per living particle, ordered by identity.

    SI; `*_std` are standard deviations, of positions per axis. `seen`: in this frame. `speed`
    [m/s] (rollers: gain [m/s/Hz]), `phi` [rad] and `force` [N] are NaN, and `known` False, until
    the command has excited them enough. `force` is NaN where radius or viscosity are not known,
    and for rollers. `prediction` (N, 2) is the position `horizon` ahead under the present
    command. `delay` [s] is the one in use; `delay_std` NaN while undetermined.
    """

    t: float
    id: np.ndarray
    seen: np.ndarray
    known: np.ndarray
    position: np.ndarray
    position_std: np.ndarray
    speed: np.ndarray
    speed_std: np.ndarray
    phi: np.ndarray
    phi_std: np.ndarray
    force: np.ndarray
    force_std: np.ndarray
    prediction: np.ndarray
    prediction_std: np.ndarray
    delay: float
    delay_std: float
    noise: Noise
    diagnosis: tuple[str, ...] = ()

    @property
    def ok(self) -> bool:
        """Whether nothing speaks against the numbers."""
        return not self.diagnosis


@dataclass(frozen=True)
class _Frame:
    """The usable readings of one frame: time, identities (n,), complex places, σ or NaN."""

    t: float
    ids: np.ndarray
    z: np.ndarray
    sigma: np.ndarray


class Estimator:
    """Exact filter for every particle, with what they share learned from the recent past.

    Feed it commands and frames in the order of their time. One call of `update` costs about the
    same for one particle as for a hundred: everything is an array over particles.
    """

    def __init__(
        self, conditions: Conditions | None = None, settings: Settings | None = None,
        model: Model | None = None,
    ) -> None:
        self.conditions = conditions or Conditions()
        self.settings = settings or Settings()
        rolling = self.conditions.propulsion == 'rolling'
        bare = Model(
            self.conditions.reference_field or 1e-3, 'rolling' if rolling else 'catalytic'
        )
        self._log = CommandLog()
        self._propagator = Propagator(model or bare, self.settings.horizon)
        self._population = Population(self.settings.fastest / 2)
        self._shared: SharedKnowledge | None = None
        self._opening: list[_Frame] | None = []
        self._t = -np.inf
        self._notes: dict[str, float] = {}

    @property
    def model(self) -> Model:
        """The model that the filter runs on."""
        return self._propagator.model

    def load(self, path: str | Path) -> None:
        """Filter with a `model.yaml`; InputError for a bad file, and the old model stays."""
        model, _ = read_model(path)
        if model.propulsion != self.model.propulsion:
            raise InputError(
                path, f'expected propulsion: {self.model.propulsion}, as this estimator was '
                f'started with; found {model.propulsion}'
            )
        self.use(model)

    def use(self, model: Model) -> None:
        """Filter with another model from the next frame on; what is known of v and φ stays."""
        self._propagator = Propagator(model, self.settings.horizon)
        if self._shared is not None:
            self._shared.forget_model()

    def command(self, t: float, field: np.ndarray, frequency: float | None = None) -> None:
        """A command in force from `t` [s] on: field (2,) [T]; for rollers frequency [Hz]."""
        self._note(self._log.append(t, field, frequency))

    def update(
        self, t: float, ids: np.ndarray, position: np.ndarray, sigma: np.ndarray | None = None,
    ) -> Estimates:
        """A frame exposed at `t` [s]: identities (N,), positions (N, 2) and their σ (N,) [m].

        Readings that are not finite are left out and their particles coast. A frame that is not
        newer than the one before changes nothing. The camera's readings are made true ones by
        the model's observation stage.
        """
        if not (np.isfinite(t) and t > self._t):
            self._note(f'a frame is stamped {t:.6g} s, not later than the one before: ignored')
            return self._estimates(np.zeros(len(self._population.ids), bool))
        position = np.asarray(position, float).reshape(-1, 2)
        ids = np.asarray(ids, int)
        sigma = np.full(len(ids), np.nan) if sigma is None else np.asarray(sigma, float)
        usable = self._usable(ids, position)
        true = self.model.true_position(position[usable])
        frame = _Frame(t, ids[usable], true[:, 0] + 1j * true[:, 1], sigma[usable])
        shared = self._knowledge(frame.sigma)
        taken, changed = self._filter(frame, shared)
        self._report(taken.jump)
        shared.add(t, self._population.ids, taken, changed)
        shared.work(t, self.model, self._log, self._population.bank)
        self._settle(frame, shared)
        self._forget(t)
        return self._estimates(np.isin(self._population.ids, frame.ids))

    def _filter(self, frame: _Frame, shared: SharedKnowledge) -> tuple[Taken, np.ndarray]:
        """Predict and take one frame; its readings, and seconds since each c changed."""
        self._predict(frame.t, shared)
        taken = self._population.take(
            frame.t, frame.ids, frame.z, _reading(shared.noise, frame.sigma)
        )
        self._t = frame.t
        return taken, self._population.consider_changes(frame.t, self.settings.change_interval)

    def _settle(self, frame: _Frame, shared: SharedKnowledge) -> None:
        """Filter the first frames again as soon as the noise has been learned from them.

        Until then noise levels are assumed; frames weighed by wrong ones would never be forgotten.
        """
        if self._opening is None:
            return
        self._opening.append(frame)
        if shared.reviewed or len(self._opening) >= LONGEST_OPENING:
            self._population = Population(self.settings.fastest / 2)
            self._propagator = Propagator(self.model, self.settings.horizon)
            self._t = -np.inf
            for again in self._opening:
                self._filter(again, shared)
            self._opening = None

    def _usable(self, ids: np.ndarray, position: np.ndarray) -> np.ndarray:
        """Rows that are finite and the first of their identity."""
        finite = np.isfinite(position).all(axis=1)
        for name in ids[~finite]:
            self._note(f'particle {name} was reported at a place that is not a number')
        first = np.zeros(len(ids), bool)
        first[np.unique(np.where(finite, ids, np.iinfo(int).min), return_index=True)[1]] = True
        for name in np.unique(ids[finite & ~first]):
            self._note(f'particle {name} was reported twice in one frame: the first is used')
        return np.flatnonzero(finite & first)

    def _knowledge(self, sigma: np.ndarray) -> SharedKnowledge:
        """What is shared; assumed from the conditions and the tracker at the first reading."""
        if self._shared is None:
            radius, viscosity = self.conditions.radius, self.conditions.viscosity
            diffusion = 1e-13
            if radius and viscosity:
                fluid = Fluid(viscosity, self.conditions.temperature or 298.15)
                diffusion = translational_diffusion(fluid, radius)
            typical = np.median(sigma[sigma > 0]) if (sigma > 0).any() else 1e-7
            assumed = Noise(diffusion, float(typical), self.settings.exposure)
            if not len(sigma):
                return SharedKnowledge(assumed)
            self._shared = SharedKnowledge(assumed)
        return self._shared

    def _predict(self, t: float, shared: SharedKnowledge) -> None:
        bank = self._population.bank
        start = self._t if np.isfinite(self._t) else t - 1e-3
        step = self._propagator.step(self._log, shared.delay.value, start, t, bank.p[0])
        if bank.count:
            speed = np.abs(bank.c[0])
            bank.predict(step.drive, step.drift, 2 * shared.noise.diffusion * step.span,
                         (self.settings.wander * speed) ** 2 * step.span)

    def _forget(self, t: float) -> None:
        self._population.forget(t - self.settings.forget_after)
        self._log.forget_before(t - 70.0)
        self._notes = {text: at for text, at in self._notes.items() if t - at < 5.0}

    def _report(self, jump: np.ndarray) -> None:
        for row in np.flatnonzero(jump):
            self._note(
                f'particle {self._population.ids[row]} jumped by {abs(jump[row]) * 1e6:.1f} µm: '
                f'is it still the same one?'
            )

    def _note(self, text: str) -> None:
        """Keep a sentence for the diagnosis of the next seconds."""
        if text:
            self._notes[text] = self._t

    def _estimates(self, seen: np.ndarray) -> Estimates:
        shared = self._shared or self._knowledge(np.empty(0))
        state = self._population.bank.combined()
        ahead = self._propagator.ahead
        std = np.sqrt(state['c_var'])
        known = std < self.settings.fastest / 20
        swims = self._widened(polar(state['c'], std), shared)
        force, force_std = self._force(swims)
        spread = (
            state['p_var'] + 2 * np.real(ahead.drive * np.conj(state['cross']))
            + np.abs(ahead.drive) ** 2 * state['c_var'] + 2 * shared.noise.diffusion * ahead.span
        )
        def shown(value: np.ndarray) -> np.ndarray:
            return np.where(known, value, np.nan)

        return Estimates(
            t=self._t, id=self._population.ids, seen=seen, known=known,
            position=_vectors(state['p']), position_std=np.sqrt(state['p_var']),
            speed=shown(swims.speed), speed_std=shown(swims.speed_std),
            phi=shown(swims.phi), phi_std=shown(swims.phi_std),
            force=shown(force), force_std=shown(force_std),
            prediction=_vectors(state['p'] + state['c'] * ahead.drive + ahead.drift),
            prediction_std=np.sqrt(spread),
            delay=shared.delay.value, delay_std=shared.delay.std, noise=shared.noise,
            diagnosis=(*self._notes, *shared.sentences),
        )

    @staticmethod
    def _widened(swims: Polar, shared: SharedKnowledge) -> Polar:
        """Speed and φ with what the delay's spread does to them."""
        late = shared.delay.std if shared.delay.determined else 0.0
        return replace(
            swims,
            speed_std=np.hypot(swims.speed_std, swims.speed * abs(shared.turn.real) * late),
            phi_std=np.hypot(swims.phi_std, abs(shared.turn.imag) * late),
        )

    def _force(self, swims: Polar) -> tuple[np.ndarray, np.ndarray]:
        """F = 6πηr v [N] and its spread, that of η and r included; NaN without η or r."""
        radius, viscosity = self.conditions.radius, self.conditions.viscosity
        drag = np.nan
        if radius and viscosity and self.model.propulsion == 'catalytic':
            drag = stokes_drag(Fluid(viscosity), radius)
        relative = np.hypot(
            self.settings.viscosity_relative_std, self.settings.radius_relative_std
        )
        force = drag * swims.speed
        return force, np.hypot(drag * swims.speed_std, relative * force)


def _reading(noise: Noise, sigma: np.ndarray) -> np.ndarray:
    """Variance of each reading: the learned level, shared out as the tracker says."""
    stated = sigma > 0
    relative = np.ones(len(sigma))
    if stated.any():
        relative[stated] = sigma[stated] ** 2 / np.mean(sigma[stated] ** 2)
    blur = noise.diffusion * noise.exposure / 3
    return np.maximum(noise.localisation**2 * relative - blur, 1e-20)


def _vectors(z: np.ndarray) -> np.ndarray:
    return np.stack([z.real, z.imag], axis=-1)
