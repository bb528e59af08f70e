"""A session prepared for fits: what was seen, what was commanded, where particles were.

The one preparation that every fit starts from: times count from the first frame, frames before
the first field are left out, and tracks are split where particles touch. At a step too large for
any motion the stage moved, or two particles were confused: what comes after it is taken for
another particle, with v and φ of its own, so that no confusion can stand in for an effect.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from microbot_ros.common.records import Commands, Conditions, Session
from microbot_ros.estimation.likelihood.noise import stokes_einstein
from microbot_ros.model.increments import as_vectors, heading_response
from microbot_ros.model.model import Model, ParticleParameters
from microbot_ros.model.timeline import Timeline

FORGOTTEN = 5.0
"""Alignment times after which the heading has forgotten where it began."""

SPREAD, GATHERED = 0.25, 0.12
"""Standard deviation of headings [rad] at which they are lost, and found again."""

USUAL = 1.5
"""Times the usual variance of headings, up to which they count as gathered."""

ROTATIONAL_DIFFUSION = 0.01
"""[rad²/s], to begin with where radius and viscosity are not known: of a sphere of 2.4 µm in
water."""

CONTACT, BLUR = 1.05, 3.0
"""How near spheres may touch between frames: in distances of contact, and in usual steps more."""

JUMP = 6.0
"""Steps longer than this many times the 99th percentile are no motion."""

NEAR, AROUND = 5, 51
"""Frames on either side of a step whose median velocity is the motion there, and frames around it
in which the distance of steps from the motion is usual."""

STANDS_OUT = 8.0
"""Times the usual distance from the motion, a median, from which a step stands out: 9.4 standard
deviations, which chance does not reach. At half of it 1 Gaussian step in 60,000 stands out; at
twice of it a slip of 1 µm is missed where positions scatter by 0.05 µm."""

SLIPS, TOUCHES = 0.05, 0.005
"""Parts of the steps of a track that may stand out where it slips, two for each, and where it is
cut: beyond them the motion itself is uneven, as of a dimer that leaps with every half turn. More
than one step in 200 frames is no stage that was touched."""

HELD = 0.1
"""Seconds for which a command has to be held before a change of it is a switch: the shortest over
which something may relax. What changes all the time, as a ramp of angles or a closed loop, has no
switch."""

LARGEST_CONTACT = 15e-6
"""Particles that never came closer than this [m] did not touch."""

FEWEST = 20
"""Rows that make a piece of a split track worth keeping."""


def first_field(commands: Commands) -> float:
    """When the first field of `commands` that is not zero begins [s]; infinity if none does."""
    driven = commands.t[np.hypot(*commands.field.T) > 0]
    return float(driven[0]) if driven.size else np.inf


@dataclass(frozen=True)
class PreparedSession:
    """One session as arrays of T frames and N tracks of P ≤ N particles.

    `name` of the session; `ids` (N,): the particle of each track, ascending, again for what comes
    after a step too large for any motion; `times` (T,) [s] from the first frame of the session;
    `z` (T, N) complex positions [m], 0 where not finite; `pieces` (T, N): which piece of its track
    a row belongs to, a number of its own for each, 0 where the row is not used; nothing is learned
    from the displacement between two pieces; `causal_positions` (T, N, 2) [m]: positions as known
    from earlier and present frames only, for terms that depend on position (raw ones would bias
    them), NaN while a particle is not in view; `commands` on the same clock; `conditions` of the
    rig; `jumps` (P,): how many slips and steps too large for any motion each particle made;
    `phi` (N,) [rad], where some fit has told it already, for terms that depend on the heading;
    `speeds_fluctuate`: whether the noise of every fit includes speeds that fluctuate.
    """

    name: str
    ids: np.ndarray
    times: np.ndarray
    z: np.ndarray
    pieces: np.ndarray
    causal_positions: np.ndarray
    commands: Commands
    conditions: Conditions
    jumps: np.ndarray
    phi: np.ndarray | None = None
    speeds_fluctuate: bool = False

    @classmethod
    def of(cls, session: Session) -> PreparedSession:
        """The frames of `session` from the first field on: before it, headings are unknown.

        All frames where there is no field at all. Tracks are whole, but for the session's breaks.
        """
        times, positions = session.tracks.grid()
        first = times[0] if len(times) else 0.0
        times, commands = times - first, replace(session.commands, t=session.commands.t - first)
        start = first_field(commands)
        keep = times >= (start if np.isfinite(start) else -np.inf)
        times, positions = times[keep], positions[keep]
        z = positions[..., 0] + 1j * positions[..., 1]
        part = 1 + np.searchsorted(session.breaks - first, times, side='right')
        return cls(
            session.name, session.tracks.particles, times, np.nan_to_num(z),
            np.where(np.isfinite(z), part[:, None], 0),
            positions, commands, session.conditions, np.zeros(z.shape[1], int))

    @cached_property
    def seen(self) -> np.ndarray:
        """Which rows (T, N) are used."""
        seen: np.ndarray = self.pieces > 0
        return seen

    @cached_property
    def main(self) -> np.ndarray:
        """The longest track (P,) of every particle."""
        rows = self.seen.sum(axis=0)
        return np.array([max(np.flatnonzero(self.ids == name), key=rows.__getitem__)
                         for name in np.unique(self.ids)], dtype=int)

    def joined(self, ahead: int = 1) -> np.ndarray:
        """Whether each row (T − ahead, N) and the one `ahead` of it lie in one piece."""
        joined: np.ndarray = self.seen[ahead:] & (self.pieces[ahead:] == self.pieces[:-ahead])
        return joined

    @cached_property
    def timeline(self) -> Timeline:
        """Commands and frames, ready to evaluate models on; ValueError with fewer than two."""
        return Timeline(self.commands, self.times, self.causal_positions, self.ids, self.phi)

    @cached_property
    def switches(self) -> np.ndarray:
        """Rows (K,) of the commands that change one which was held for HELD."""
        commands = self.commands
        told = np.column_stack([commands.field, commands.frequency_at(commands.t)])
        change = np.append(0, 1 + np.flatnonzero((told[1:] != told[:-1]).any(axis=1)))
        began = commands.t[change]
        inside = (began[1:] > self.times[0]) & (began[1:] < self.times[-1])
        return change[1:][(np.diff(began) >= HELD) & inside]

    @cached_property
    def interval(self) -> float:
        """The usual time between frames [s]."""
        return float(np.median(np.diff(self.times)))

    @cached_property
    def rotational_diffusion(self) -> float | None:
        """Rotational diffusion [rad²/s] by Stokes–Einstein–Debye; None where not known."""
        known = stokes_einstein(self.conditions)
        return known and known[1]

    def after_first_field(self, seconds: float) -> PreparedSession:
        """Return the session without the first `seconds` [s] after the field came on."""
        return self.from_frame(int(self.times.searchsorted(first_field(self.commands) + seconds)))

    def from_frame(self, first: int) -> PreparedSession:
        """Return the session without the frames before the frame of index `first`."""
        return replace(
            self, times=self.times[first:], z=self.z[first:], pieces=self.pieces[first:],
            causal_positions=self.causal_positions[first:])

    def only(self, frames: np.ndarray) -> PreparedSession:
        """The session as if nothing had been recorded but `frames` (T,) bool, commands apart.

        Tracks are cut there: nothing is learned from a displacement across other frames, nor from
        any place in them.
        """
        places = np.where(frames[:, None, None], self.causal_positions, np.nan)
        hidden = np.broadcast_to(~frames[:, None], self.seen.shape)
        return replace(self, causal_positions=places).split_tracks(hidden)

    def split_at_jumps(self) -> PreparedSession:
        """With another track after every step beyond any motion, if it has FEWEST rows."""
        both = self.joined()
        steps = np.where(both, np.abs(np.diff(self.z, axis=0)), 0.0)
        usual = np.quantile(steps[both], 0.99) if both.any() else 0.0
        jumped = np.concatenate([np.zeros((1, self.z.shape[1]), bool), steps > JUMP * usual])
        if not jumped.any():
            return self
        number = np.cumsum(jumped, axis=0)
        columns, inside = [], []
        for n, own in enumerate(number.T):
            parts = [(own == k) & ~jumped[:, n] for k in range(own[-1] + 1)]
            rows = [int((part & self.seen[:, n]).sum()) for part in parts]
            for part, count in zip(parts, rows, strict=True):
                if count >= min(FEWEST, max(rows)):
                    columns.append(n)
                    inside.append(part)
        within = np.stack(inside, axis=1)
        return replace(
            self, ids=self.ids[columns], z=self.z[:, columns],
            pieces=np.where(within, self.pieces[:, columns], 0),
            causal_positions=np.where(
                within[..., None], self.causal_positions[:, columns], np.nan),
            jumps=self.jumps + jumped.sum(axis=0))

    def without_slips(self) -> PreparedSession:
        """Without rows that a track jumps to and back from, as where a tracker slips for a frame.
        """
        odd = self._odd_steps(SLIPS)
        out = np.zeros_like(self.seen)
        out[1:-1] = odd[:-1] & odd[1:]
        return self if not out.any() else replace(
            self, pieces=np.where(out, 0, self.pieces), jumps=self.jumps + self._of_particles(out),
            causal_positions=np.where(out[..., None], np.nan, self.causal_positions))

    def cut_at_steps(self) -> PreparedSession:
        """Tracks in pieces between steps that the motion around them does not explain.

        A track that was seeded anew or a stage that was touched. The particle stays the same one.
        """
        return self._cut(np.concatenate(
            [np.zeros((1, self.z.shape[1]), bool), self._odd_steps(TOUCHES)]))

    def cut_at(self, rows: np.ndarray) -> PreparedSession:
        """Tracks in pieces that begin at `rows` (T, N) bool, where these are rare in a track.

        Or no more than the switches of the command: bodies turn over before they follow.
        """
        few = np.maximum(TOUCHES * self.seen.sum(axis=0), max(2, len(self.switches)))
        return self._cut(rows & (rows.sum(axis=0) <= few))

    def _cut(self, cut: np.ndarray) -> PreparedSession:
        if not cut.any():
            return self
        number = np.cumsum(cut, axis=0)
        pieces = np.where(self.seen, self.pieces * (number.max() + 1) + number, 0)
        return replace(self, pieces=pieces, jumps=self.jumps + self._of_particles(cut))

    def _odd_steps(self, rare: float) -> np.ndarray:
        """Steps (T − 1, N) bool that stand out of the motion around them.

        Where more than `rare` of the steps of a track do, that is how it moves, and none is odd.
        """
        steps = np.where(self.joined(), np.diff(self.z, axis=0), np.nan)
        odd = np.stack([_stands_out(track, np.diff(self.times)) for track in steps.T], axis=1)
        odd[:, odd.sum(axis=0) > np.maximum(rare * np.isfinite(steps).sum(axis=0), 2)] = False
        return odd

    def _of_particles(self, rows: np.ndarray) -> np.ndarray:
        """How many of some `rows` (T, N) bool each particle has: (P,)."""
        return np.bincount(np.unique(self.ids, return_inverse=True)[1],
                           rows.sum(axis=0)).astype(int)

    def split_at_contacts(self) -> PreparedSession:
        """Tracks split where spheres may touch: there they push each other.

        Without a known radius, contact is as near as two ever came.
        """
        z = np.where(self.seen, self.z, np.nan)
        apart = distances(z)
        radius = self.conditions.radius
        steps = np.abs(np.diff(z, axis=0))
        blur = BLUR * float(np.nanmedian(steps)) if np.isfinite(steps).any() else 0.0
        contact = 2 * radius if radius else float(apart.min(initial=np.inf)) + blur
        if contact > LARGEST_CONTACT:
            return self
        touching = apart.min(axis=2, initial=np.inf) < contact * CONTACT + blur
        touching[1:] |= touching[:-1].copy()
        touching[:-1] |= touching[1:].copy()
        return self.split_tracks(touching)

    def split_tracks(self, out: np.ndarray) -> PreparedSession:
        """Each track in pieces between the rows `out` (T, N) bool, which are not used.

        Of a track that is split, pieces of fewer than FEWEST rows are not used either, but for
        its longest.
        """
        if not out.any():
            return self
        number = np.cumsum(np.diff(out, axis=0, prepend=False) & out, axis=0)
        pieces = np.where(self.seen & ~out, self.pieces * (number.max() + 1) + number, 0)
        for piece in pieces.T:
            names, counts = np.unique(piece[piece > 0], return_counts=True)
            small = counts < min(FEWEST, counts.max(initial=0))
            piece[np.isin(piece, names[small])] = 0
        return replace(self, pieces=pieces)

    def with_filtered_positions(
        self, displacement: np.ndarray, noise_ratio: float,
    ) -> PreparedSession:
        """With `causal_positions` filtered about the `displacement` (T, N) complex [m] of a model.

        `noise_ratio` [s] is that of the likelihood's `Whitening`. Outside a piece they stay as
        they are: no model knows what happens in a contact, nor where one is that is lost then.
        """
        from microbot_ros.estimation.likelihood.kernels import filter_positions

        left = filter_positions(self.times, self.pieces, self.z - displacement, noise_ratio)
        inside = self._inside_a_piece[..., None]
        return replace(self, causal_positions=np.where(
            inside, as_vectors(left + displacement), self.causal_positions))

    @property
    def _inside_a_piece(self) -> np.ndarray:
        """Which rows (T, N) are used, or lie between two of one piece that are."""
        row = np.arange(len(self.times))[:, None]
        before = np.maximum.accumulate(np.where(self.seen, row, 0), axis=0)
        after = np.minimum.accumulate(np.where(self.seen, row, row[-1])[::-1], axis=0)[::-1]
        first, last = (np.take_along_axis(self.pieces, one, axis=0) for one in (before, after))
        return (first > 0) & (first == last)


def distances(z: np.ndarray) -> np.ndarray:
    """Between every two particles at places `z` (T, N) complex [m]: (T, N, N) [m].

    Infinite to itself, and where either place is not finite.
    """
    apart = np.abs(z[:, :, None] - z[:, None, :])
    apart[~np.isfinite(apart)] = np.inf
    apart[:, range(z.shape[1]), range(z.shape[1])] = np.inf
    return apart


def _stands_out(steps: np.ndarray, intervals: np.ndarray) -> np.ndarray:
    """Which of the `steps` (T,) complex [m], NaN where not seen, no motion around them explains.

    That is all between the steps before and after, and all between the median velocities of NEAR
    frames before and after, since commands switch between frames; `intervals` (T,) [s].
    """
    result = np.zeros(len(steps), bool)
    seen = np.flatnonzero(np.isfinite(steps))
    if len(seen) < AROUND:
        return result
    velocity = steps[seen] / intervals[seen]
    padded = np.pad(velocity, NEAR, mode='reflect')
    windows = np.lib.stride_tricks.sliding_window_view(padded, NEAR)
    medians = np.median(windows.real, axis=1) + 1j * np.median(windows.imag, axis=1)
    count = len(velocity)
    away = intervals[seen] * np.minimum(
        _distance(velocity, medians[:count], medians[NEAR + 1:NEAR + 1 + count]),
        _distance(velocity, padded[NEAR - 1:NEAR - 1 + count], padded[NEAR + 1:][:count]))
    half = AROUND // 2
    usual = np.median(np.lib.stride_tricks.sliding_window_view(
        np.pad(away, half, mode='reflect'), AROUND), axis=1)
    result[seen] = away > STANDS_OUT * np.maximum(usual, np.median(away))
    return result


def _distance(z: np.ndarray, one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Of points `z` from the segments between `one` and an `other`, all complex (T,)."""
    way = other - one
    length = np.maximum(np.abs(way) ** 2, 1e-300)
    along = np.clip(((z - one) * way.conj()).real / length, 0.0, 1.0)
    distance: np.ndarray = np.abs(z - one - along * way)
    return distance


def prepare(session: Session) -> PreparedSession:
    """A `session` as every fit takes it: from the first field on, without slips, cut at steps.

    Split where tracks jump and where spheres touch.
    """
    whole = PreparedSession.of(session).without_slips()
    return whole.split_at_jumps().cut_at_steps().split_at_contacts()


def predictable_part(
    session: PreparedSession, model: Model, assumed: float = ROTATIONAL_DIFFUSION,
) -> PreparedSession:
    """The part of a `session` that a `model` without chance in its headings can explain.

    `assumed` is the rotational diffusion [rad²/s] where radius and viscosity don't tell it.
    Headings are unknown until the first field has come and aligned them, and again after a turn
    so near 180° that Brownian motion chooses the way round. Never less than half the time.
    """
    tau = model.alignment_time
    if tau == 0:
        return session.after_first_field(model.delay) if model.delay > 0 else session
    began = first_field(session.commands)
    start = model.delay + _aligned(session.commands, tau * model.reference_field)
    lost = _lost(session, model, assumed) | (session.times < began + start)
    if lost.mean() > 0.5:
        return session.after_first_field(min(start, float(np.ptp(session.times)) / 2))
    first = int(np.argmin(lost))
    kept = session.from_frame(first)
    return kept.split_tracks(np.broadcast_to(lost[first:, None], kept.seen.shape))


def _aligned(commands: Commands, slowness: float) -> float:
    """Seconds from the first field until it has lasted FORGOTTEN alignment times, of which each is
    `slowness` [T s] over its strength; infinity where it never does.
    """
    strength = np.hypot(*commands.field.T)
    lasted = np.append(0.0, np.cumsum(np.diff(commands.t) * strength[:-1] / slowness))
    k = int(np.searchsorted(lasted, FORGOTTEN)) - 1  # the command under which it has
    if strength[k] == 0:
        return np.inf
    missing = (FORGOTTEN - lasted[k]) * slowness / strength[k]
    return float(commands.t[k] + missing) - first_field(commands)


def _lost(session: PreparedSession, model: Model, assumed: float) -> np.ndarray:
    """Frames (T,) in which headings may be far from where the model has them.

    From the beginning, and from when Brownian turning, amplified by every turn of nearly 180°,
    spreads them wider than a linear filter can follow, until the field has gathered them again.
    """
    nobody = ParticleParameters.from_velocity_phasor(np.zeros(1, int), np.ones(1, complex))
    response = heading_response(model, nobody, session.timeline)
    retention = response.heading_retention[:, 0]
    kick = 2 * (session.rotational_diffusion or assumed) * np.diff(session.times)
    variance = np.full(len(session.times), np.pi**2)
    for k in range(len(retention)):
        variance[k + 1] = min(retention[k] ** 2 * variance[k] + kick[k], np.pi**2)
    # Where it is large at all times, the filter does what it can with it.
    usual = USUAL * float(np.median(variance))
    spread, gathered = max(SPREAD**2, 2 * usual), max(GATHERED**2, usual)
    lost = np.ones(len(variance), bool)
    for k in range(1, len(variance)):
        lost[k] = variance[k] > (gathered if lost[k - 1] else spread)
    return lost
