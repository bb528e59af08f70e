"""Worlds with an effect that is in no library: forces and speeds written as physics, not as terms.

Nothing here shares code with what is learned. What a law does is put into the simulated world
every few milliseconds, and noted, so that what was learned can be held against it. Some laws are
of a kind that the grammar of formulas has (`formula`: part of the text that must be found), most
are not.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from bench._hidden_suite import FIELD, FLUID, Experiment, Yardstick
from microbot_ros.common.records import Commands, Conditions, Session
from microbot_ros.virtual_rig.commands import steps
from microbot_ros.virtual_rig.record_session import Camera, draw_swarm, record_session
from microbot_ros.virtual_rig.world import FieldHistory, World

ASKED = 4e-3
"""Seconds between two looks at a law."""


@dataclass
class Now:
    """What a law may look at: time [s], places (N,) complex [m], headings (N,) [rad], the angle of
    the command [rad] and the time since it changed [s], its strength [T]; `memory` is its own."""

    t: float
    z: np.ndarray
    heading: np.ndarray
    command: float
    since: float
    strength: float
    step: float
    memory: dict[str, np.ndarray]


@dataclass(frozen=True)
class Push:
    """What a law does: a drift (N,) complex [m/s], a factor on speeds, an angle on headings."""

    drift: np.ndarray | complex = 0j
    factor: np.ndarray | float = 1.0
    turn: np.ndarray | float = 0.0


Law = Callable[[Now, float], Push]
"""From what is now and a strength about 1."""


@dataclass(frozen=True)
class Kind:
    """One kind of effect, drawn by `make(rng, extent, duration)`; what it truly depends on."""

    against: tuple[str, ...]
    frame: str
    acts_on: str
    make: Callable[[np.random.Generator, float, float], Law]
    formula: str | None = None
    pairs: bool = False


class HiddenWorld(World):
    """A world in which a `law` acts at a `strength`, and notes what it did in `log`."""

    def __init__(self, bodies: np.ndarray, rng: np.random.Generator, law: Law,
                 strength: float) -> None:
        super().__init__(bodies, rng)
        self._law, self._strength = law, strength
        self._memory: dict[str, np.ndarray] = {}
        self.log: list[tuple[float, float, np.ndarray]] = []

    def advance(self, until: float, history: FieldHistory) -> np.ndarray:
        if until <= self.t:
            return self.position
        count = max(math.ceil((until - self.t) / ASKED - 1e-9), 1)
        begin, mean = self.t, np.zeros((len(self.bodies), 2))
        for k in range(count):
            end = until if k == count - 1 else begin + (until - begin) * (k + 1) / count
            mean += self._step(end, history) / count
        return mean

    def _step(self, end: float, history: FieldHistory) -> np.ndarray:
        bodies = self.bodies
        now = self._now(end - self.t, history)
        push = self._law(now, self._strength)
        kept = {name: bodies[name].copy() for name in ('drift_x', 'drift_y', 'speed')}
        drift = np.broadcast_to(np.asarray(push.drift, complex), now.z.shape)
        way = bodies['speed'] * np.exp(1j * now.heading)
        done = drift + way * (push.factor * np.exp(1j * np.asarray(push.turn)) - 1)
        self.log.append((self.t, end, done))
        bodies['drift_x'] += drift.real
        bodies['drift_y'] += drift.imag
        bodies['speed'] *= push.factor
        bodies['phi'] += push.turn
        moved = super().advance(end, history)
        bodies['phi'] -= push.turn
        for name, values in kept.items():
            bodies[name] = values
        return moved

    def _now(self, step: float, history: FieldHistory) -> Now:
        row = max(int(history.t.searchsorted(self.t, side='right')) - 1, 0)
        b = history.field[row, 0]
        command = math.atan2(b[1], b[0])
        place = self.position
        aim = command + self.bodies['phi']
        return Now(self.t, place[:, 0] + 1j * place[:, 1], aim, command,
                   self.t - float(history.t[row]), math.hypot(*b), step, self._memory)


# Laws -------------------------------------------------------------------------------------------

SPEED = 4e-6


def _channel(rng: np.random.Generator, extent: float, _: float) -> Law:
    turn, width = np.exp(1j * rng.uniform(-np.pi, np.pi)), rng.uniform(1.3, 1.8) * extent
    return lambda now, s: Push(
        s * 1e-6 * turn * (1 - ((now.z * np.conj(turn)).imag / width) ** 2))


def _vortex(rng: np.random.Generator, extent: float, _: float) -> Law:
    at = extent * complex(*rng.uniform(-0.5, 0.5, 2))
    core = rng.uniform(0.25, 0.5) * extent
    return lambda now, s: Push(
        s * 1e-6 * 1j * (now.z - at) * core / (np.abs(now.z - at) ** 2 + core**2))


def _settling(rng: np.random.Generator, _: float, duration: float) -> Law:
    way, tau = np.exp(1j * rng.uniform(-np.pi, np.pi)), rng.uniform(0.12, 0.3) * duration
    return lambda now, s: Push(s * 1e-6 * way * math.exp(-now.t / tau))


def _pulse(rng: np.random.Generator, _: float, duration: float) -> Law:
    f, phase = math.exp(rng.uniform(math.log(3 / duration), math.log(0.5))), rng.uniform(0, 6.28)
    return lambda now, s: Push(
        factor=1 + min(0.25 * s, 0.95) * math.sin(2 * math.pi * f * now.t + phase))


def _facing(rng: np.random.Generator, _e: float, _d: float) -> Law:
    n, phase = int(rng.integers(2, 5)), rng.uniform(0, 6.28)
    return lambda now, s: Push(factor=1 + min(0.25 * s, 0.95) * np.cos(n * now.heading + phase))


def _lamp(rng: np.random.Generator, _: float, duration: float) -> Law:
    when, sign = rng.uniform(0.3, 0.7) * duration, rng.choice((-1, 1))
    return lambda now, s: Push(factor=1 + sign * min(0.25 * s, 0.9) * (now.t >= when))


def _repulsion(rng: np.random.Generator, _e: float, _d: float) -> Law:
    n = int(rng.integers(1, 4))

    def law(now: Now, s: float) -> Push:
        apart = now.z[:, None] - now.z[None, :]
        r = np.abs(apart) + np.eye(len(apart)) * 1e9
        return Push((s * 1e-6 * apart / r * (25e-6 / r) ** n).sum(axis=1))
    return law


def _recovery(rng: np.random.Generator, _e: float, _d: float) -> Law:
    tau = rng.uniform(0.4, 1.2)
    return lambda now, s: Push(factor=1 - min(0.3 * s, 0.95) * math.exp(-now.since / tau))


def _lenses(rng: np.random.Generator, extent: float, _: float) -> Law:
    at = extent * (rng.uniform(-0.8, 0.8, 2) + 1j * rng.uniform(-0.8, 0.8, 2))
    size = rng.uniform(0.3, 0.6, 2) * extent

    def law(now: Now, s: float) -> Push:
        bumps = [np.exp(-np.abs(now.z - a) ** 2 / (2 * w**2))
                 for a, w in zip(at, size, strict=True)]
        return Push(factor=np.maximum(1 + 0.3 * s * (bumps[0] - bumps[1]), 0.0))
    return law


def _glide(rng: np.random.Generator, extent: float, _: float) -> Law:
    way = np.exp(1j * rng.uniform(-np.pi, np.pi))
    depth = rng.uniform(0.3, 0.6) * extent
    return lambda now, s: Push(s * 1e-6 * way * 1j / (1 + (np.maximum(
        (now.z * np.conj(way)).real + 1.3 * extent, 0.0) / depth) ** 3))


def _pair(rng: np.random.Generator, extent: float, _: float) -> Law:
    at, core = extent * 0.5 * np.exp(1j * rng.uniform(-np.pi, np.pi)), 0.35 * extent

    def law(now: Now, s: float) -> Push:
        flow = 0j
        for sign in (1, -1):
            w = now.z - sign * at
            flow = flow + sign * 1j * w * core / (np.abs(w) ** 2 + core**2)
        return Push(s * 1e-6 * flow)
    return law


def _cells(rng: np.random.Generator, extent: float, _: float) -> Law:
    k = rng.uniform(1.6, 2.6) / extent
    px, py = rng.uniform(-np.pi, np.pi, 2)

    def law(now: Now, s: float) -> Push:
        x, y = k * now.z.real + px, k * now.z.imag + py
        return Push(s * 1e-6 * (np.sin(x) * np.cos(y) - 1j * np.cos(x) * np.sin(y)))
    return law


def _fatigue(rng: np.random.Generator, _e: float, _d: float) -> Law:
    """Each turn of the command tires it in proportion to its angle, and it recovers."""
    tau = rng.uniform(0.5, 1.5)

    def law(now: Now, s: float) -> Push:
        known = now.memory.setdefault('tired', np.zeros(2))
        turned = abs(math.remainder(now.command - known[1], 2 * math.pi))
        known[0] = known[0] * math.exp(-now.step / tau) + turned / math.pi
        known[1] = now.command
        return Push(factor=max(1 - 0.4 * s * known[0] / (1 + known[0]), 0.0))
    return law


def _lopsided(rng: np.random.Generator, _e: float, _d: float) -> Law:
    best, sharp = rng.uniform(-np.pi, np.pi), rng.uniform(2.0, 4.0)
    return lambda now, s: Push(factor=1 + 0.4 * s * np.exp(
        sharp * (np.cos(now.heading - best) - 1)))


def _sociable(rng: np.random.Generator, _e: float, _d: float) -> Law:
    """They push each other when near and pull when farther."""
    reach = rng.uniform(14e-6, 22e-6)

    def law(now: Now, s: float) -> Push:
        apart = now.z[:, None] - now.z[None, :]
        r = np.abs(apart) + np.eye(len(apart)) * 1e9
        force = np.exp(-r / reach) * np.cos(np.pi * r / (2 * reach))
        return Push((3 * s * 1e-6 * apart / r * force).sum(axis=1))
    return law


def _turncoat(rng: np.random.Generator, _: float, duration: float) -> Law:
    """A drift that turns about midway."""
    when, width = rng.uniform(0.35, 0.65) * duration, 0.06 * duration
    start, by = rng.uniform(-np.pi, np.pi), rng.choice((-1, 1)) * rng.uniform(1.5, 3.0)
    return lambda now, s: Push(s * 0.5e-6 * np.exp(1j * (start + by / (1 + math.exp(
        -(now.t - when) / width)))))


def _chirp(rng: np.random.Generator, _: float, duration: float) -> Law:
    f, way = rng.uniform(1.5, 3.0) / duration, np.exp(1j * rng.uniform(-np.pi, np.pi))
    return lambda now, s: Push(
        s * 0.7e-6 * way * math.cos(2 * math.pi * f * now.t * (1 + now.t / duration)))


def _ramp(rng: np.random.Generator, extent: float, _: float) -> Law:
    way, width = np.exp(1j * rng.uniform(-np.pi, np.pi)), rng.uniform(0.2, 0.5) * extent
    return lambda now, s: Push(factor=1 + min(0.25 * s, 0.9) * np.tanh(
        (now.z * np.conj(way)).real / width))


def _sector(rng: np.random.Generator, _e: float, _d: float) -> Law:
    """Headings are off by a triangle wave of the command's angle."""
    phase, n = rng.uniform(-np.pi, np.pi), int(rng.integers(2, 4))
    return lambda now, s: Push(turn=0.25 * s * 2 / math.pi * math.asin(
        math.sin(n * now.command + phase)))


def _jet(rng: np.random.Generator, extent: float, _: float) -> Law:
    way = np.exp(1j * rng.uniform(-np.pi, np.pi))
    middle, width = rng.uniform(-0.4, 0.4) * extent, rng.uniform(0.2, 0.4) * extent
    return lambda now, s: Push(1.5 * s * 1e-6 * way * np.exp(
        -((now.z * np.conj(way)).imag - middle) ** 2 / (2 * width**2)))


def _weariness(rng: np.random.Generator, _: float, duration: float) -> Law:
    tau = rng.uniform(0.02, 0.1) * duration
    return lambda now, s: Push(factor=max(1 - 0.12 * s * math.log1p(now.t / tau), 0.0))


def _tide(rng: np.random.Generator, _: float, duration: float) -> Law:
    """A drift that rises and is reset, like the teeth of a saw."""
    period, phase = rng.uniform(0.2, 0.4) * duration, rng.uniform(0, 1)
    way = np.exp(1j * rng.uniform(-np.pi, np.pi))
    return lambda now, s: Push(s * 0.7e-6 * way * (2 * ((now.t / period + phase) % 1) - 1))


def _swerve(rng: np.random.Generator, _e: float, _d: float) -> Law:
    """Headings overshoot after a switch and swing back."""
    tau, f = rng.uniform(0.5, 1.0), rng.uniform(0.3, 0.6)
    return lambda now, s: Push(turn=0.5 * s * math.exp(-now.since / tau) * math.cos(
        2 * math.pi * f * now.since))


def _terrace(rng: np.random.Generator, extent: float, _: float) -> Law:
    """Two steps of speed across the field of view."""
    way, edges = np.exp(1j * rng.uniform(-np.pi, np.pi)), np.sort(
        rng.uniform(-0.6, 0.6, 2)) * extent
    return lambda now, s: Push(factor=1 + min(0.25 * s, 0.9) * (
        ((now.z * np.conj(way)).real > edges[0]) & ((now.z * np.conj(way)).real < edges[1])))


def _shyness(rng: np.random.Generator, _e: float, _d: float) -> Law:
    """They slow down where the nearest other one is near."""
    reach = rng.uniform(10e-6, 20e-6)

    def law(now: Now, s: float) -> Push:
        r = np.abs(now.z[:, None] - now.z[None, :]) + np.eye(len(now.z))
        return Push(factor=1 - min(0.5 * s, 0.95) * np.exp(-(r.min(axis=1) / reach) ** 2))
    return law


KINDS: dict[str, Kind] = {
    'channel': Kind(('position',), 'laboratory', 'velocity', _channel, 'c2 s²) along'),
    'vortex': Kind(('position',), 'laboratory', 'velocity', _vortex, '(−y, x)/(r² + a²)'),
    'settling': Kind(('time',), 'laboratory', 'velocity', _settling, 'exp(−(x − x₀)/a)'),
    'pulse': Kind(('time',), 'heading', 'speed', _pulse, 'cos 2πat'),
    'facing': Kind(('heading',), 'heading', 'speed', _facing, 'cos'),
    'lamp': Kind(('time',), 'heading', 'speed', _lamp, 'H(x − a)'),
    'repulsion': Kind(
        ('neighbour distance',), 'radial', 'velocity', _repulsion, 'c0 x', pairs=True),
    'recovery': Kind(('time since switch',), 'heading', 'speed', _recovery, 'exp(−(x − x₀)/a)'),
    'lenses': Kind(('position',), 'heading', 'speed', _lenses),
    'glide': Kind(('position',), 'laboratory', 'velocity', _glide),
    'pair': Kind(('position',), 'laboratory', 'velocity', _pair),
    'cells': Kind(('position',), 'laboratory', 'velocity', _cells),
    'fatigue': Kind(('time since switch',), 'heading', 'speed', _fatigue),
    'lopsided': Kind(('heading',), 'heading', 'speed', _lopsided),
    'sociable': Kind(('neighbour distance',), 'radial', 'velocity', _sociable, pairs=True),
    'turncoat': Kind(('time',), 'laboratory', 'velocity', _turncoat),
    'chirp': Kind(('time',), 'laboratory', 'velocity', _chirp),
    'ramp': Kind(('position',), 'heading', 'speed', _ramp),
    'sector': Kind(('command angle',), 'heading', 'heading', _sector),
    'jet': Kind(('position',), 'laboratory', 'velocity', _jet),
}
"""Eight whose formula is in the grammar, twelve whose is not."""

NEW: dict[str, Kind] = {
    'weariness': Kind(('time',), 'heading', 'speed', _weariness),
    'tide': Kind(('time',), 'laboratory', 'velocity', _tide),
    'swerve': Kind(('time since switch',), 'heading', 'heading', _swerve),
    'terrace': Kind(('position',), 'heading', 'speed', _terrace),
    'shyness': Kind(('neighbour distance',), 'radial', 'speed', _shyness, pairs=True),
}
"""Written when nothing was to be changed any more; nothing may be tuned on what they show."""


# Filming them -----------------------------------------------------------------------------------

@dataclass(frozen=True)
class Filmed:
    """A session in which a `kind` was hidden, with `evidence` λ beyond v, φ and what drift, flow,
    decay and slip absorb; `pushes`: (t0, t1, what was done (N,) [m/s]) as it was felt."""

    session: Session
    kind: Kind
    name: str
    evidence: float
    pushes: list[tuple[float, float, np.ndarray]] = field(repr=False)
    swarm: np.ndarray = field(repr=False)
    law: Law = field(repr=False)
    strength: float = 1.0

    def velocities(self, times: np.ndarray) -> np.ndarray:
        """What was done (T−1, N) [m/s], complex, averaged over the intervals between `times`."""
        ends = np.array([end for _, end, _ in self.pushes])
        spans = np.array([end - begin for begin, end, _ in self.pushes])
        moved = np.concatenate([np.zeros((1, len(self.swarm)), complex), np.cumsum(
            spans[:, None] * np.array([done for _, _, done in self.pushes]), axis=0)])
        edges = np.append(self.pushes[0][0], ends)
        at = np.stack([np.interp(times, edges, m.real) + 1j * np.interp(times, edges, m.imag)
                       for m in moved.T], axis=1)
        return np.asarray(np.diff(at, axis=0) / np.diff(times)[:, None])


def film(name: str, seed: int, evidence: float = 100.0, duration: float = 60.0) -> Filmed:
    """The session of a kind by its `name`, drawn by `seed`, at the wanted `evidence`."""
    kind = (KINDS | NEW)[name]
    for attempt in range(60):
        rng = np.random.default_rng([seed, attempt, *name.encode()])
        experiment, extent = _experiment(rng, duration, kind.pairs)
        law = kind.make(rng, extent, duration)
        filmed = _at_evidence(experiment, law, kind, name, evidence)
        if filmed is not None:
            return filmed
    raise RuntimeError(f'{name}, seed {seed}: never at the wanted evidence')


def _experiment(rng: np.random.Generator, duration: float,
                pairs: bool) -> tuple[Experiment, float]:
    count, radius = (8 if pairs else int(rng.integers(4, 7))), 2.5e-6
    extent = (8 * radius if pairs else 45e-6) * math.sqrt(count)
    swarm = draw_swarm(rng, count, FLUID, FIELD, radius=radius, half_extent=extent,
                       spacing=6 * radius if pairs else 25e-6, aligns_in=5e-5)
    if pairs:
        swarm['phi'] = swarm['phi'][0] + rng.uniform(-0.3, 0.3, count)
    camera = Camera(30.0, float(rng.choice((0.0, 0.5))), 0.1e-6, missed=0.03, run=3.0)
    levels = (FIELD,) if rng.random() < 0.5 else (0.4 * FIELD, FIELD)
    legs = steps(rng, duration, levels, (1.0, 4.0), rng.uniform(-math.pi, math.pi), math.pi, None)
    conditions = Conditions(radius=radius, viscosity=FLUID.viscosity, reference_field=FIELD)
    return Experiment(swarm, lambda: legs, camera, duration, conditions,
                      int(rng.integers(2**31))), extent


def _at_evidence(experiment: Experiment, law: Law, kind: Kind, name: str,
                 wanted: float) -> Filmed | None:
    strength = 1.0
    for _ in range(8):
        rng = np.random.default_rng(experiment.chance)
        world = HiddenWorld(experiment.swarm.copy(), rng, law, strength)
        legs = experiment.control()
        assert isinstance(legs, Commands)
        session, path = record_session(
            world, legs, experiment.camera, experiment.duration, rng, experiment.conditions)
        if not experiment.apart(path):
            return None
        made = Filmed(replace(session, name=f'{name}'), kind, name, 0.0, world.log,
                      experiment.swarm, law, strength)
        times = path.t
        moved = np.concatenate([np.zeros((1, len(world.bodies)), complex), np.cumsum(
            np.diff(times)[:, None] * made.velocities(times), axis=0)])
        left = Yardstick(experiment, session.commands, path).left(
            times, np.stack([moved.real, moved.imag], axis=-1), True, path.position)
        if abs(left / wanted - 1) < 0.2:
            return replace(made, evidence=left)
        strength *= min(max(math.sqrt(wanted / max(left, 1e-3)), 0.3), 3.0)
        if strength > 12:
            return None
    return None


