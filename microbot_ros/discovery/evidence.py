"""A session prepared for many fits: what was seen, what was commanded, where particles were."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from microbot_ros.model.effects.alignment_lag import AlignmentLag
from microbot_ros.model.increments import (
    Response,
    as_vectors,
    heading_response,
    respond,
)
from microbot_ros.model.model import Model, ParticleParameters
from microbot_ros.model.particle import Fluid, rotational_diffusion
from microbot_ros.model.timeline import Timeline
from microbot_ros.records import Commands, Conditions, Session

FORGOTTEN = 5.0
"""Alignment times after which the heading has forgotten where it began."""

SPREAD, GATHERED = 0.25, 0.12
"""Standard deviation of headings [rad] at which they are lost, and found again."""

USUAL = 1.5
"""Times the usual variance of headings, up to which they count as gathered."""

TURNING = 0.01
"""Rotational diffusion [rad²/s] to begin with where radius and viscosity are not known: of a
sphere of 2.4 µm in water."""

CONTACT, BLUR = 1.05, 3.0
"""How near spheres may touch between frames: in distances of contact, and in usual steps more."""

JUMP = 6.0
"""Steps longer than this many times the 99th percentile are no motion."""

LARGEST_CONTACT = 15e-6
"""Particles that never came closer than this [m] did not touch."""

FEWEST = 20
"""Rows that make a piece of a track worth keeping."""


@dataclass(frozen=True)
class Evidence:
    """One session as arrays.

    `ids` (N,) names the particle of each track, ascending; `times` (T,) [s]; `z` (T, N) complex
    positions [m], 0 where `seen` (T, N) is False; `places` (T, N, 2) [m]: positions as known from
    earlier and present frames only, for terms that depend on position (raw ones would bias them),
    NaN before and after a particle is in view; `jumps`: steps too large for any motion, at which
    tracks were cut.
    """

    name: str
    ids: np.ndarray
    times: np.ndarray
    z: np.ndarray
    seen: np.ndarray
    places: np.ndarray
    commands: Commands
    conditions: Conditions
    jumps: int = 0

    @classmethod
    def of(cls, session: Session) -> Evidence:
        """The frames from the first field on: before it, headings are unknown.

        Recordings stamped with the time of day are counted from their first frame.
        """
        times, positions = session.tracks.grid()
        commands = session.commands
        zero = times[0] if abs(times[0]) > 3600 else 0.0
        times, commands = times - zero, replace(commands, t=commands.t - zero)
        keep = times >= first_field(commands)
        times, positions = times[keep], positions[keep]
        z = positions[..., 0] + 1j * positions[..., 1]
        return cls(
            session.name, session.tracks.particles, times, np.nan_to_num(z), np.isfinite(z),
            positions, commands, session.conditions)

    @cached_property
    def owner(self) -> np.ndarray:
        """The particle (N,) that each track belongs to, counted from 0, ascending."""
        owner: np.ndarray = np.unique(self.ids, return_inverse=True)[1]
        return owner

    @cached_property
    def first_track(self) -> np.ndarray:
        """The first track of every particle."""
        return np.unique(self.ids, return_index=True)[1]

    @cached_property
    def timeline(self) -> Timeline:
        """Commands and frames, ready to evaluate models on."""
        return Timeline(self.commands, self.times, self.places)

    @cached_property
    def interval(self) -> float:
        """The usual time between frames [s]."""
        return float(np.median(np.diff(self.times)))

    @cached_property
    def turning(self) -> float | None:
        """Rotational diffusion [rad²/s] by Stokes–Einstein–Debye; None where not known."""
        known = self.conditions
        if not (known.radius and known.viscosity):
            return None
        fluid = Fluid(known.viscosity, known.temperature or 298.15)
        return rotational_diffusion(fluid, known.radius)

    def since(self, seconds: float) -> Evidence:
        """Without the frames in the first `seconds` after the field came on."""
        keep = self.times >= first_field(self.commands) + seconds
        return replace(
            self, times=self.times[keep], z=self.z[keep], seen=self.seen[keep],
            places=self.places[keep])

    def within(self, frames: np.ndarray) -> Evidence:
        """With only some frames (T,) bool used; the others still count as time that passes."""
        return replace(self, seen=self.seen & frames[:, None])

    def without_jumps(self) -> Evidence:
        """Tracks cut at steps beyond any motion: the stage moved, or two were confused."""
        both = self.seen[1:] & self.seen[:-1]
        steps = np.where(both, np.abs(np.diff(self.z, axis=0)), 0.0)
        usual = np.quantile(steps[both], 0.99) if both.any() else 0.0
        jumped = np.concatenate([np.zeros((1, self.z.shape[1]), bool), steps > JUMP * usual])
        return replace(self.cut(jumped), jumps=int(jumped.sum()))

    def without_contact(self) -> Evidence:
        """Tracks cut where spheres may touch: there they push each other.

        What follows a contact counts as another particle, since nobody saw how far it was pushed.
        Without a known radius, contact is as near as two ever came.
        """
        z = np.where(self.seen, self.z, np.nan)
        apart = np.abs(z[:, :, None] - z[:, None, :])
        apart[~np.isfinite(apart)] = np.inf
        apart[:, range(z.shape[1]), range(z.shape[1])] = np.inf
        radius = self.conditions.radius
        steps = np.abs(np.diff(z, axis=0))
        blur = BLUR * float(np.nanmedian(steps)) if np.isfinite(steps).any() else 0.0
        contact = 2 * radius if radius else float(apart.min()) + blur
        if contact > LARGEST_CONTACT:
            return self
        touching = (apart < contact * CONTACT + blur).any(axis=2)
        touching[1:] |= touching[:-1].copy()
        touching[:-1] |= touching[1:].copy()
        return self.cut(touching)

    def cut(self, out: np.ndarray) -> Evidence:
        """Without the rows `out` (T, N) bool; what comes after one is another track.

        Others still feel where the particle is meanwhile.
        """
        if not out.any():
            return self
        number = np.cumsum(np.diff(out, axis=0, prepend=False) & out, axis=0)
        used = self.seen & ~out
        row = np.arange(len(used))
        columns, seen, own = [], [], []
        for n in range(used.shape[1]):
            pieces = [used[:, n] & (number[:, n] == k) for k in range(number[-1, n] + 1)]
            pieces = [piece for piece in pieces if piece.sum() >= FEWEST]
            begins = [0, *(int(piece.argmax()) for piece in pieces[1:]), len(used)]
            for piece, begin, end in zip(pieces, begins, begins[1:], strict=False):
                columns.append(n)
                seen.append(piece)
                own.append((row >= begin) & (row < end))
        if not columns:
            return self
        kept, place = np.stack(seen, axis=1), np.stack(own, axis=1)
        return replace(
            self, ids=self.ids[columns], z=np.where(kept, self.z[:, columns], 0), seen=kept,
            places=np.where(place[..., None], self.places[:, columns], np.nan))

    def located(self, moved: np.ndarray, excess: float) -> Evidence:
        """With places filtered about the displacement (T, N) complex that a model expects."""
        from microbot_ros.discovery.kernels import filter_levels

        belief = filter_levels(self.times, self.seen, self.z - moved, excess) + moved
        last = len(self.times) - 1 - self.seen[::-1].argmax(axis=0)
        belief[np.arange(len(self.times))[:, None] > last] = np.nan
        known = np.isfinite(belief)[..., None]
        return replace(self, places=np.where(known, as_vectors(belief), self.places))


def first_field(commands: Commands) -> float:
    """When the first field that is not zero was commanded; infinity if never."""
    driven = commands.t[np.hypot(*commands.field.T) > 0]
    return float(driven[0]) if driven.size else np.inf


def explainable(evidence: Evidence, model: Model, turning: float = TURNING) -> Evidence:
    """What a model that knows no chance in headings can explain.

    `turning` is the rotational diffusion [rad²/s] where radius and viscosity don't tell it.

    Headings are unknown until the first field has come and aligned them, and again after a turn
    so near 180° that Brownian motion chooses the way round. Never less than half the time.
    """
    lag = model.effect('alignment_lag')
    tau = lag.tau if isinstance(lag, AlignmentLag) else 0.0
    start = model.delay + FORGOTTEN * tau
    half = float(np.ptp(evidence.times)) / 2
    kept = evidence.since(min(start, half)) if start > 0 else evidence
    if tau == 0:
        return kept
    lost = _lost(kept, model, turning)
    return kept if lost.mean() > 0.5 else kept.cut(lost[:, None] & np.ones_like(kept.seen))


def _lost(evidence: Evidence, model: Model, turning: float) -> np.ndarray:
    """Frames (T,) in which headings may be far from where the model has them.

    From when Brownian turning, amplified by every turn of nearly 180°, spreads them wider than a
    linear filter can follow, until the field has gathered them again.
    """
    nobody = ParticleParameters.from_velocity_phasor(np.zeros(1, int), np.ones(1, complex))
    kept = heading_response(model, nobody, evidence.timeline).heading_retention[:, 0]
    kick = 2 * (evidence.turning or turning) * np.diff(evidence.times)
    variance = np.zeros(len(evidence.times))
    for k in range(len(kept)):
        variance[k + 1] = min(kept[k] ** 2 * variance[k] + kick[k], np.pi**2)
    # Where it is large at all times, the filter does what it can with it.
    usual = USUAL * float(np.median(variance))
    spread, gathered = max(SPREAD**2, 2 * usual), max(GATHERED**2, usual)
    lost = np.zeros(len(variance), bool)
    for k in range(1, len(variance)):
        lost[k] = variance[k] > (gathered if lost[k - 1] else spread)
    return lost


@dataclass(frozen=True)
class Levels:
    """What a model says of all frames, as complex displacements accumulated since the first.

    A particle with a + ib = v e^{iφ} is at `offset` + a·`along` + b·`across`, each (T, 1 or N).
    `turned`: across is i·along, as it is where pixels are square.
    """

    offset: np.ndarray
    along: np.ndarray
    across: np.ndarray
    turned: bool

    def moved(self, swim: np.ndarray) -> np.ndarray:
        """Displacements (T, N) [m] of particles with v e^{iφ} = `swim` (N,)."""
        return self.offset + self.along * swim.real + self.across * swim.imag


def levels(model: Model, evidence: Evidence) -> Levels:
    """The levels of a model; where a particle was not in view it does not move."""
    response: Response = respond(model, evidence.timeline)
    square = not any(effect.stage == 'observation' for effect in model.effects)
    if square:
        along = _accumulate(response.propulsion)
        return Levels(_accumulate(_complex(response.drift)), along, 1j * along, True)
    columns = response.columns()
    along, across = (_accumulate(_complex(columns[..., k])) for k in (0, 1))
    return Levels(_accumulate(_complex(response.offset())), along, across, False)


def _complex(vectors: np.ndarray) -> np.ndarray:
    return vectors[..., 0] + 1j * vectors[..., 1]


def _accumulate(steps: np.ndarray) -> np.ndarray:
    """Sums (T, N) of steps (T−1, N); a particle that is not in view makes none."""
    sums = np.zeros((len(steps) + 1, steps.shape[1]), complex)
    known = steps if np.isfinite(steps).all() else np.nan_to_num(steps)
    np.cumsum(known, axis=0, out=sums[1:])
    return sums
