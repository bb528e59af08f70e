"""Imperfections of real recordings that can be laid over any simulated session.

Three are in the world (particles that stick, speeds that wander, sizes that differ) and need the
session to be filmed again; the others change the recording. None of them shares code with the
likelihood of `estimation` or with an effect of the library. Sizes are typical of a laboratory
microscope; with half of each value the imperfection is near or below the localisation error, with
twice it is what an operator would notice in the overlay.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from microbot_ros.common.records import Session
from microbot_ros.model.physics.particle import Fluid, rotational_drag, stokes_drag
from microbot_ros.virtual_rig.world import FieldHistory, World

OUTLIERS = 0.01
"""Probability that a detection is that of something else nearby."""
OUTLIER_M = (1e-6, 5e-6)
JITTER_S = 3e-3
"""Mean delay of a frame between exposure and software stamp; the delays are exponential."""
FOCUS_DEPTH_M = 4e-6
"""Distance from the plane of focus at which `FOCUS_NOISE_M` is added to the localisation error."""
FOCUS_NOISE_M = 0.15e-6
HEIGHT_M, HEIGHT_S = 3e-6, 5.0
"""Standard deviation and correlation time of a particle's height."""
BROKEN_S, HIDDEN_S = 10.0, 0.3
"""Length of a track, and the gap before its particle gets a new identity."""
WANDER, WANDER_S = 0.15, 3.0
"""Relative standard deviation and correlation time of a speed."""
EVENTS_S = 20.0
"""Mean time between two encounters of one particle with the floor or with debris."""
HELD_S, KNOCK_M, KNOCK_S = (0.5, 3.0), (2e-6, 6e-6), 0.2
SIZES = 0.2
"""Standard deviation of the logarithm of the radius."""
BURSTS_S, BURST_S = 10.0, (0.3, 2.0)
"""Mean time between two bursts of lost frames, and how long a burst lasts."""
LOG_GAP_S = 2.0
PIXEL_M = 0.3e-6
STAGE_M, STAGE_S = 0.5e-6, 20.0
"""Standard deviation and correlation time of the stage's place; it has no mean velocity."""
STEP_S = 4e-3
"""Time between two changes of a disturbed world."""


def smooth_noise(rng: np.random.Generator, t: np.ndarray, shape: tuple[int, ...],
                 correlation_s: float) -> np.ndarray:
    """Return Ornstein-Uhlenbeck noise of variance 1 at the times `t` (T,) [s]: (T, *shape)."""
    noise = rng.standard_normal((len(t), *shape))
    kept = np.exp(-np.diff(t) / correlation_s)
    for k, keep in enumerate(kept.tolist(), start=1):
        noise[k] = keep * noise[k - 1] + math.sqrt(1 - keep**2) * noise[k]
    return noise


# In the world -----------------------------------------------------------------------------------

class WanderingSpeeds(World):
    """World in which the speed of each particle fluctuates about its mean."""

    def __init__(self, bodies: np.ndarray, rng: np.random.Generator) -> None:
        super().__init__(bodies, rng)
        self._chance = np.random.default_rng(rng.integers(2**63))
        self._state = self._chance.standard_normal(len(bodies))

    def advance(self, until: float, history: FieldHistory) -> np.ndarray:
        return _in_steps(self, until, history, self._step)

    def _step(self, end: float, history: FieldHistory) -> np.ndarray:
        keep = math.exp(-(end - self.t) / WANDER_S)
        self._state = keep * self._state + math.sqrt(1 - keep**2) * self._chance.standard_normal(
            len(self._state))
        own = {name: self.bodies[name].copy() for name in ('speed', 'gain')}
        for name, values in own.items():
            self.bodies[name] = values * np.maximum(1 + WANDER * self._state, 0.0)
        mean = super().advance(end, history)
        for name, values in own.items():
            self.bodies[name] = values
        return mean


class Encounters(World):
    """World in which each particle now and then sticks to the floor or is knocked aside.

    `touched_at` has a (begin, end, particle) [s] for each encounter.
    """

    def __init__(self, bodies: np.ndarray, rng: np.random.Generator) -> None:
        super().__init__(bodies, rng)
        self._chance = np.random.default_rng(rng.integers(2**63))
        self._until = np.zeros(len(bodies))
        self._push = np.zeros((len(bodies), 2))
        self.touched_at: list[tuple[float, float, int]] = []

    def advance(self, until: float, history: FieldHistory) -> np.ndarray:
        return _in_steps(self, until, history, self._step)

    def _step(self, end: float, history: FieldHistory) -> np.ndarray:
        span, before = end - self.t, self.position
        free = self._until <= self.t
        for k in np.nonzero(free & (self._chance.random(len(free)) < span / EVENTS_S))[0]:
            self._begin(int(k))
        busy = self._until > self.t
        held = busy & ~self._push.any(axis=1)
        mean = super().advance(end, history)
        pushed = np.where(busy[:, None], self._push, 0.0) * span
        self.bodies['x'] += pushed[:, 0]
        self.bodies['y'] += pushed[:, 1]
        self.bodies['x'][held], self.bodies['y'][held] = before[held].T
        return np.where(held[:, None], before, mean + pushed / 2)

    def _begin(self, particle: int) -> None:
        self._push[particle] = 0.0
        lasts = self._chance.uniform(*HELD_S)
        if self._chance.random() < 0.5:
            lasts, angle = KNOCK_S, self._chance.uniform(-math.pi, math.pi)
            speed = self._chance.uniform(*KNOCK_M) / KNOCK_S
            self._push[particle] = speed * math.cos(angle), speed * math.sin(angle)
        self._until[particle] = self.t + lasts
        self.touched_at.append((self.t, self.t + lasts, particle))


def _in_steps(world: World, until: float, history: FieldHistory,
              step: Callable[[float, FieldHistory], np.ndarray]) -> np.ndarray:
    """Advance in steps of at most `STEP_S`; the mean position (N, 2) [m] on the way."""
    if until <= world.t:
        return world.position
    ends = np.linspace(world.t, until, max(math.ceil((until - world.t) / STEP_S), 1) + 1)[1:]
    means = [step(end, history) for end in ends.tolist()]
    return np.asarray(np.mean(means, axis=0))


def differing_sizes(rng: np.random.Generator, swarm: np.ndarray, fluid: Fluid) -> np.ndarray:
    """Return a `swarm` whose radii differ, and with them drag, diffusion and moment.

    Moments grow with the volume, as the drag of rotation does; speeds stay.
    """
    made = swarm.copy()
    ratio = np.exp(SIZES * rng.standard_normal(len(swarm)))
    made['radius'] *= ratio
    for name, power in (('diffusion', -1), ('rotational_diffusion', -3), ('moment', 3)):
        made[name] *= ratio**power
    made['drag'] = stokes_drag(fluid, made['radius'])
    made['turn_drag'] = rotational_drag(fluid, made['radius'])
    return made


# In the recording -------------------------------------------------------------------------------

Overlay = Callable[[np.random.Generator, Session], Session]


def outliers(rng: np.random.Generator, session: Session) -> Session:
    """Move one detection in a hundred by micrometres."""
    count = len(session.tracks.t)
    away = rng.uniform(*OUTLIER_M, count) * (rng.random(count) < OUTLIERS)
    return _moved(session, _polar(away, rng.uniform(-math.pi, math.pi, count)))


def software_stamps(rng: np.random.Generator, session: Session) -> Session:
    """Stamp frames when the program gets them: delays are random, their mean is removed.

    Stamps keep the order of frames and are at least 0.1 ms apart.
    """
    times, frame = np.unique(session.tracks.t, return_inverse=True)
    late = times + rng.exponential(JITTER_S, len(times)) - JITTER_S
    apart = 1e-4 * np.arange(len(times))
    return _with(session, t=(np.maximum.accumulate(late - apart) + apart)[frame])


def changing_focus(rng: np.random.Generator, session: Session) -> Session:
    """Add localisation error that grows with the square of each particle's defocus."""
    times, frame = np.unique(session.tracks.t, return_inverse=True)
    ids, column = np.unique(session.tracks.particle, return_inverse=True)
    focus = HEIGHT_M * rng.standard_normal(len(ids))
    height = focus + HEIGHT_M * smooth_noise(rng, times, (len(ids),), HEIGHT_S)
    blur = FOCUS_NOISE_M * (height[frame, column] / FOCUS_DEPTH_M) ** 2
    return _moved(session, blur[:, None] * rng.standard_normal((len(frame), 2)))


def broken_tracks(rng: np.random.Generator, session: Session) -> Session:
    """End each track about every 10 s; after a gap its particle has a new identity."""
    tracks = session.tracks
    column = np.unique(tracks.particle, return_inverse=True)[1]
    age = tracks.t + rng.uniform(0.0, BROKEN_S, column.max() + 1)[column]
    part = np.floor(age / BROKEN_S).astype(int)
    seen = (age - part * BROKEN_S >= HIDDEN_S) | (part == 0)
    identity = np.unique(part * (column.max() + 1) + column, return_inverse=True)[1]
    return _kept(_with(session, particle=identity), seen)


def exchanged_identities(rng: np.random.Generator, session: Session) -> Session:
    """Exchange the identities of two particles where they are nearest, in each half of the time.

    Nothing changes where there is one particle. `rng` chooses the pair.
    """
    times, positions = session.tracks.grid()
    ids = session.tracks.particles
    if len(ids) < 2:
        return session
    particle = session.tracks.particle.copy()
    for half in np.array_split(np.arange(len(times)), 2):
        first, second = rng.choice(len(ids), 2, replace=False)
        apart = np.hypot(*(positions[half, first] - positions[half, second]).T)
        if np.isfinite(apart).any():
            later = session.tracks.t > times[half[np.nanargmin(apart)]]
            one, other = particle == ids[first], particle == ids[second]
            particle[later & one], particle[later & other] = ids[second], ids[first]
    return _with(session, particle=particle)


def lost_bursts(rng: np.random.Generator, session: Session) -> Session:
    """Lose all frames of 0.3 to 2 s, about every 10 s."""
    times = session.tracks.t
    count = max(rng.poisson((times[-1] - times[0]) / BURSTS_S), 1)
    begin = rng.uniform(times[0], times[-1], count)
    inside = _inside(times, begin, begin + rng.uniform(*BURST_S, count))
    return _kept(session, ~inside)


def command_gaps(rng: np.random.Generator, session: Session) -> Session:
    """Lose the commands of two seconds, in each half of the time; at least one row each.

    The first row stays: without it nothing would be commanded at the beginning.
    """
    commands = session.commands
    keep = np.ones(len(commands.t), bool)
    for half in np.array_split(np.arange(1, len(commands.t)), 2):
        if len(half):
            begin = commands.t[rng.choice(half)]
            keep &= ~_inside(commands.t, begin, begin + LOG_GAP_S)
    keep[0] = True
    rows = {name: getattr(commands, name) for name in ('t', 'field', 'frequency', 'tilt')}
    return replace(session, commands=replace(
        commands, **{name: v[keep] for name, v in rows.items() if v is not None}))


def half_pixels(_: np.random.Generator, session: Session) -> Session:
    """Round positions to half a pixel."""
    step = PIXEL_M / 2
    return _with(session, position=np.round(session.tracks.position / step) * step)


def stage_drift(rng: np.random.Generator, session: Session) -> Session:
    """Let the stage wander about its place."""
    times, frame = np.unique(session.tracks.t, return_inverse=True)
    return _moved(session, STAGE_M * smooth_noise(rng, times, (2,), STAGE_S)[frame])


def _polar(radius: np.ndarray, angle: np.ndarray) -> np.ndarray:
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)


def _inside(t: np.ndarray, begin: np.ndarray | float, end: np.ndarray | float) -> np.ndarray:
    """Whether times `t` (T,) lie in any of the intervals."""
    begin, end = np.atleast_1d(begin), np.atleast_1d(end)
    return np.asarray(((t[:, None] >= begin) & (t[:, None] < end)).any(axis=1))


def _with(session: Session, **columns: np.ndarray) -> Session:
    return replace(session, tracks=replace(session.tracks, **columns))


def _moved(session: Session, by: np.ndarray) -> Session:
    return _with(session, position=session.tracks.position + by)


def _kept(session: Session, rows: np.ndarray) -> Session:
    return replace(session, tracks=session.tracks.rows(rows))


@dataclass(frozen=True)
class Nuisance:
    """An imperfection: of the recording (`overlay`), of the `world`, or of the particles' sizes.
    """

    overlay: Overlay = lambda _, session: session
    world: Callable[[np.ndarray, np.random.Generator], World] = World
    sizes: bool = False


NUISANCES: dict[str, Nuisance] = {
    'outliers': Nuisance(outliers),
    'software stamps': Nuisance(software_stamps),
    'changing focus': Nuisance(changing_focus),
    'broken tracks': Nuisance(broken_tracks),
    'exchanged identities': Nuisance(exchanged_identities),
    'stuck or knocked': Nuisance(world=Encounters),
    'wandering speeds': Nuisance(world=WanderingSpeeds),
    'differing sizes': Nuisance(sizes=True),
    'lost bursts': Nuisance(lost_bursts),
    'command gaps': Nuisance(command_gaps),
    'half pixels': Nuisance(half_pixels),
    'stage drift': Nuisance(stage_drift),
}
"""The twelve kinds, under the names that the table prints."""
