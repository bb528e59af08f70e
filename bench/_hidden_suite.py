"""Blind sessions: fine Langevin physics with effects hidden at a wanted strength of evidence.

How plainly an effect shows is its expected evidence λ = Σ |W P m|²: m are the displacements it
causes, W whitens them under the diffusion and localisation error of the session, P projects off
what speeds and offsets absorb. It is the noncentrality of the likelihood ratio against the
baseline; for slow effects it is (1/2D) Σ ∫ |P δv|² dt. The library's equations serve to choose
strengths only: what is filmed is the physics of `virtual_rig`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bench._hidden_effects import KINDS, LISTED, Hideout, Parameters
from microbot_ros.common.records import Commands, Conditions, Session
from microbot_ros.common.units import to_si
from microbot_ros.estimation.likelihood.noise import Noise, whiten
from microbot_ros.estimation.likelihood.prepared_session import nearest
from microbot_ros.model.effects import EFFECTS
from microbot_ros.model.increments import respond
from microbot_ros.model.model import Model, ParticleParameters
from microbot_ros.model.physics.langevin import Path
from microbot_ros.model.physics.particle import Fluid
from microbot_ros.model.timeline import Timeline
from microbot_ros.virtual_rig.commands import Herding, steps
from microbot_ros.virtual_rig.dynamics import roll_frequency
from microbot_ros.virtual_rig.injected_effects import inject_effect
from microbot_ros.virtual_rig.record_session import Camera, Feedback, draw_swarm, record_session
from microbot_ros.virtual_rig.world import World

FIELD = 5e-3
FLUID = Fluid(1.245e-3)
ABOVE_FLOOR = 2.0
"""An effect that is smaller than this times the floor of the instrument must not be named: what a
fit finds errs either way."""

CLOSE = 0.15
"""How near to the wanted evidence a filmed session must come."""

_ROLLS_ALWAYS = {'cut_in_hz': 0.0, 'step_out_hz': 1e9}
COMMANDS = ('paper', 'fast', 'closed_loop', 'narrow')
"""Legs of 2 to 6 s; of 0.3 to 1 s; feedback from every frame; legs within ±20°."""


@dataclass(frozen=True)
class Blind:
    """A session, and what was hidden in it: parameters as people write them, and evidence λ.

    `path` is where the particles really were and headed, in the `experiment` that was filmed.
    """

    session: Session
    path: Path
    seed: int
    commands: str
    hidden: dict[str, Parameters]
    evidence: float
    experiment: Experiment

    @property
    def swarm(self) -> np.ndarray:
        """What the particles are without the effect (N,) of type BODY."""
        return self.experiment.swarm

    @property
    def camera(self) -> Camera:
        """What filmed them."""
        return self.experiment.camera

    @property
    def near_floor(self) -> bool:
        """Whether an effect is below ABOVE_FLOOR times the floor of the instrument."""
        return any(is_near_floor(*one) for one in self.hidden.items())

    def __str__(self) -> str:
        what = f'{" + ".join(self.hidden)} at λ {self.evidence:.0f}' if self.hidden else 'nothing'
        return f'seed {self.seed}, {self.commands}: {what}'


def is_near_floor(name: str, parameters: Parameters) -> bool:
    """Whether an effect is below ABOVE_FLOOR times the floor of the instrument."""
    floors = [p for p in EFFECTS[name].parameters() if p.floor and p.name in parameters
              ] if name in EFFECTS else []
    return bool(floors) and all(
        abs(to_si(p.name, parameters[p.name]) - p.null_value) < ABOVE_FLOOR * p.floor
        for p in floors)


@dataclass(frozen=True)
class Experiment:
    """Everything about an experiment but what is hidden in it. `control()` starts it anew."""

    swarm: np.ndarray
    control: Callable[[], Commands | Feedback]
    camera: Camera
    duration: float
    conditions: Conditions
    chance: int

    def film(
        self, effects: dict[str, Parameters], quiet: Commands | None = None,
        world: Callable[[np.ndarray, np.random.Generator], World] = World,
    ) -> tuple[Session, Path]:
        """The session and the true path with these effects, in the `world` that is made.

        `quiet`: without diffusion, camera errors or blur, under these commands.
        """
        swarm, camera = self.swarm.copy(), self.camera
        for effect, parameters in effects.items():
            inject_effect(swarm, effect, parameters, FIELD)
        if quiet is not None:
            swarm['diffusion'] = swarm['rotational_diffusion'] = 0.0
            camera = Camera(camera.frame_rate)
        rng = np.random.default_rng(self.chance)
        control = self.control() if quiet is None else quiet
        session, path = record_session(
            world(swarm, rng), control, camera, self.duration, rng, self.conditions)
        return session, path

    def apart(self, path: Path) -> bool:
        """Whether no two spheres came near touching."""
        z = path.position[..., 0] + 1j * path.position[..., 1]
        return bool(nearest(z).min() > 2.3 * self.swarm['radius'][0])


def blind(
    seed: int, commands: str, effects: tuple[str, ...] = (), evidence: float = 0.0,
    *, duration: float = 60.0, rolling: bool = False, count: int | None = None,
) -> Blind:
    """The session drawn by `seed`, with `effects` of expected `evidence` each hidden in it.

    Drawn are the particles (1 to 20, unless `count` says), their size and thereby diffusion in
    place and angle, frame rate, shutter, localisation error, gaps, and whether the rig knows its
    fluid. An experiment in which spheres touch is drawn again, since contact is an effect of its
    own; so is one in which the evidence can't be reached with an effect that a rig may have.
    """
    for attempt in range(200):
        rng = np.random.default_rng([seed, attempt])
        experiment, extent = _draw(rng, commands, effects, duration, rolling, count)
        session, path = experiment.film({})
        if not experiment.apart(path):
            continue
        place = Hideout(rng, extent * 1e6, duration)
        shaped = {effect: KINDS[effect].shaped(place) for effect in effects}
        filmed = _film(experiment, shaped, evidence, session.commands, path)
        if filmed is not None and experiment.apart(filmed[1]):
            session, path, hidden = filmed
            named = replace(session, name=f'blind-{seed}')
            return Blind(named, path, seed, commands, hidden, evidence, experiment)
    raise RuntimeError(f'seed {seed}: {effects} under {commands} commands always ends in contact')


def _film(
    experiment: Experiment, shaped: dict[str, Callable[[float], Parameters]], evidence: float,
    commands: Commands, path: Path,
) -> tuple[Session, Path, dict[str, Parameters]] | None:
    """Session, path and what was hidden, at evidence as wanted; None where there is no strength.

    An effect changes where particles go, and with feedback what is commanded: strengths are set
    on the path without it first, and then on the paths with it.
    """
    for _ in range(5):
        yardstick = Yardstick(experiment, commands, path)
        strengths = {e: yardstick.strength(e, shape, evidence) for e, shape in shaped.items()}
        hidden = {e: shaped[e](s) for e, s in strengths.items() if s is not None}
        if len(hidden) < len(shaped):
            return None
        session, path = experiment.film(hidden)
        commands = session.commands
        there = Yardstick(experiment, commands, path)
        if all(abs(there.evidence(e, hidden[e]) / evidence - 1) < CLOSE for e in hidden):
            return session, path, hidden
    return None


def _draw(
    rng: np.random.Generator, commands: str, effects: tuple[str, ...], duration: float,
    rolling: bool, count: int | None,
) -> tuple[Experiment, float]:
    """An experiment and the half side [m] of the square in which its particles start."""
    pairs = any(KINDS[effect].pairs for effect in effects)
    rolling = rolling or 'drive_response' in effects
    count = count or int(rng.choice((6, 8, 10) if pairs else (1, 2, 3, 4, 4, 4, 6, 20)))
    radius = float(rng.choice((2.5e-6, 4.6e-6) if pairs else (1.0e-6, 2.5e-6, 4.6e-6)))
    spacing = 7 * radius if pairs else 30e-6
    extent = (9 * radius if pairs else 50e-6) * math.sqrt(count)
    swarm = draw_swarm(
        rng, count, FLUID, FIELD, radius=radius, half_extent=extent, spacing=spacing,
        aligns_in=5e-5)
    if pairs:  # alike, so that they stay near each other without touching
        swarm['phi'] = swarm['phi'][0] + rng.uniform(-0.3, 0.3, count)
    if rolling:
        swarm['gain'], swarm['speed'] = swarm['speed'] / 8, 0.0
    several = any(KINDS[effect].levels for effect in effects) or bool(rng.random() < 0.5)
    levels = (0.2 * FIELD, 0.4 * FIELD, FIELD) if several else (FIELD,)
    camera = Camera(
        float(rng.choice((20.0, 30.0, 60.0))), float(rng.choice((0.0, 0.5, 1.0))),
        float(rng.choice((0.03e-6, 0.1e-6, 0.3e-6))),
        missed=float(rng.choice((0.0, 0.05, 0.1))), run=3.0,
        dropped=float(rng.choice((0.0, 0.02))))
    conditions = Conditions(propulsion='rolling' if rolling else 'catalytic')
    if rng.random() < 0.7:
        conditions = replace(
            conditions, radius=radius, viscosity=FLUID.viscosity, reference_field=FIELD)
    control = _control(rng, commands, swarm, levels, duration, rolling)
    return Experiment(
        swarm, control, camera, duration, conditions, int(rng.integers(2**31))), extent


def _control(
    rng: np.random.Generator, commands: str, swarm: np.ndarray, levels: tuple[float, ...],
    duration: float, rolling: bool,
) -> Callable[[], Commands | Feedback]:
    if commands == 'closed_loop':
        def herd() -> Feedback:
            guide = Herding(swarm['phi'].copy(), 1.0)
            return lambda t, seen: levels[int(t / 5) % len(levels)] * guide(t, seen)
        return herd
    dwell = (0.3, 1.0) if commands == 'fast' else (2.0, 6.0)
    spread = math.radians(20) if commands == 'narrow' else math.pi
    frequency = (1.0, 2.0, 5.0, 10.0, 20.0) if rolling else None
    legs = steps(rng, duration, levels, dwell, rng.uniform(-math.pi, math.pi), spread, frequency)
    return lambda: legs


@dataclass(frozen=True)
class Yardstick:
    """Measures evidence along the path (T, N, 2) of an experiment with nothing hidden in it."""

    experiment: Experiment
    commands: Commands
    path: Path

    def strength(
        self, effect: str, shaped: Callable[[float], Parameters], wanted: float,
    ) -> float | None:
        """The strength at which the evidence is as wanted within 3 %, None where no rig has it."""
        strength = KINDS[effect].guess
        for _ in range(20):
            if strength > KINDS[effect].most:
                return None
            reached = self.evidence(effect, shaped(strength))
            if not reached > 1e-4 * wanted:
                return None
            if abs(reached / wanted - 1) < 0.03:
                return strength
            strength *= min(max(math.sqrt(wanted / reached), 0.2), 5.0)
        return None

    def evidence(self, effect: str, parameters: Parameters) -> float:
        """λ of one effect.

        What is in no library is filmed without noise, with it and without, and counted beyond
        drift, linear flow, decay and slip, which would take most of it: the evidence that
        something else is there. What fine physics does besides is none of it.
        """
        if effect in LISTED:
            return self.left(self.path.t, self._caused(effect, parameters), beyond=False)
        times, moved = self._filmed({effect: parameters})
        return self.left(times, moved - self._bare, beyond=True, path=self._bare)

    @cached_property
    def _bare(self) -> np.ndarray:
        """Where particles are with nothing hidden and without noise (T, N, 2) [m]."""
        return self._filmed({})[1]

    def _filmed(self, effects: dict[str, Parameters]) -> tuple[np.ndarray, np.ndarray]:
        session, _ = self.experiment.film(effects, quiet=self.commands)
        return session.tracks.grid()

    def _caused(self, effect: str, parameters: Parameters) -> np.ndarray:
        """The displacement (T, N, 2) [m] that an effect adds up to along the path."""
        swarm, kind = self.experiment.swarm, EFFECTS[effect]
        speed = swarm['gain'] if self._baseline.propulsion == 'rolling' else swarm['speed']
        particles = ParticleParameters(np.arange(len(swarm)), speed, swarm['phi'])
        timeline = Timeline(self.commands, self.path.t, self.path.position)
        plain = respond(self._baseline, timeline).increments(particles)
        if effect == 'drive_response':  # filmed with the mechanics of rollers, not with curves
            roller = swarm[:1].copy()
            inject_effect(roller, effect, _ROLLS_ALWAYS | parameters, FIELD)
            turns = np.array([roll_frequency(roller[0], f) for f in self.commands.frequency])
            rolled = Timeline(replace(self.commands, frequency=turns), self.path.t)
            return _sum(respond(self._baseline, rolled).increments(particles) - plain)
        added = kind(**{p.field: to_si(p.name, parameters[p.name]) for p in kind.parameters()})
        more = respond(self._baseline.with_effect(added), timeline)
        return _sum(more.increments(particles) - plain)

    @property
    def _baseline(self) -> Model:
        conditions = replace(self.experiment.conditions, reference_field=FIELD)
        return Model.baseline(conditions, self.commands)

    def left(self, times: np.ndarray, moved: np.ndarray, beyond: bool,
             path: np.ndarray | None = None) -> float:
        """What of displacements `moved` (T, N, 2) the baseline can't absorb, whitened and squared.

        `beyond`: nor drift, decay, slip and the flow along the `path`, else along `moved`.
        """
        keep = times >= self.commands.t[0]
        along_path = moved if path is None else path
        times, z, place = times[keep], *(
            part[keep, :, 0] + 1j * part[keep, :, 1] for part in (moved, along_path))
        swum = respond(self._baseline, Timeline(self.commands, times)).propulsion
        columns = [z, np.broadcast_to(_sum(swum), z.shape)]
        if beyond:
            age = times[:-1, None]
            aging = _sum(swum * age) * np.exp(1j * self.experiment.swarm['phi'])
            x, y = (_sum(np.diff(times)[:, None] * part[:-1]) for part in (place.real, place.imag))
            clock = np.broadcast_to(times[:, None] - times[0], z.shape)
            columns += [clock, 1j * clock, x, 1j * x, y, 1j * y, aging, 1j * aging]
        camera, body = self.experiment.camera, self.experiment.swarm[0]
        noise = Noise(body['diffusion'], camera.noise, camera.exposure / camera.frame_rate)
        white = whiten(np.stack(columns, axis=-1).astype(complex), times, noise)
        along = white[..., 1]
        share = (along.conj()[..., None] * white).sum(0) / (np.abs(along) ** 2).sum(0)[:, None]
        white = white - along[..., None] * share
        real = np.concatenate([white.real, white.imag]).reshape(-1, white.shape[-1])
        weights = np.linalg.lstsq(real[:, 2:], real[:, 0], rcond=1e-9)[0]
        return float(((real[:, 0] - real[:, 2:] @ weights) ** 2).sum())


def _sum(increments: np.ndarray) -> np.ndarray:
    return np.concatenate([np.zeros((1, *increments.shape[1:])), np.cumsum(increments, axis=0)])
