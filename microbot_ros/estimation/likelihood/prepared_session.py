"""A session prepared for fits: what was seen, what was commanded, where particles were.

Every fit starts from this preparation. Times count from the first frame, frames before the first
field are left out, and tracks are split where particles touch. At a step too large for any motion
the stage moved, or two particles were confused. The track after it is another particle, with its
own v and φ, so that no confusion can mimic an effect.
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
"""Alignment times after which a heading does not depend on its start.

Choice: e⁻⁵ = 0.7 % remains.
"""

SPREAD, GATHERED = 0.25, 0.12
"""Standard deviation of headings [rad] above which they are lost, and below which (`GATHERED`)
they are known again.

Choice: up to 0.25 rad a filter that is linear in the heading errs by 1 % of a displacement across
the path (θ²/6) and 3 % along it (θ²/2); less loses more rows. The second is lower, so that rows
are not lost and found in turns."""

USUAL = 1.5
"""Ratio to the usual variance of headings up to which they count as known.

Choice: where the variance is large at all times, rows are lost only at turns.
"""

ROTATIONAL_DIFFUSION = 0.01
"""Initial rotational diffusion [rad²/s] where radius or viscosity are unknown: that of a sphere of
2.4 µm in water."""

CONTACT, BLUR = 1.05, 3.0
"""Distance up to which spheres may touch between frames: factor on the distance of contact, and
usual steps (`BLUR`) added to it.

Choice: larger values lose rows, smaller ones keep pushes between spheres."""

JUMP = 6.0
"""Ratio to the 99th percentile above which a step is no motion.

Choice: 18 standard deviations of a Gaussian step; a smaller value splits tracks of uneven motion.
"""

NEAR, AROUND = 5, 51
"""Frames on either side of a step whose median velocity is the motion there, and frames (`AROUND`)
around it that make the usual distance of steps from the motion.

Choice: short enough to follow commands, long enough for a median."""

STANDS_OUT = 8.0
"""Ratio to the usual (median) distance from the motion above which a step is an outlier.

Choice: 9.4 standard deviations, which chance does not reach. At half of it 1 Gaussian step in
60,000 is an outlier; at twice of it a slip of 1 µm is missed where positions scatter by 0.05 µm.
"""

SLIPS, TOUCHES = 0.05, 0.005
"""Fraction of the steps of a track that may be outliers where it slips, two for each slip, and
where it is cut (`TOUCHES`).

Choice: beyond them the motion itself is uneven, as of a dimer that leaps with every half turn.
More than one step in 200 frames is not a stage that was touched."""

HELD = 0.1
"""Time [s] for which a command must be held before its change counts as a switch.

Choice: the shortest over which something may relax. Commands that change all the time, as a ramp
of angles or a closed loop, have no switch.
"""

LARGEST_CONTACT = 15e-6
"""Distance [m] of centres above which particles did not touch. Choice: above usual diameters."""

PAIRS = 2**22
"""Pairs of particles whose distances are held at once. Choice: 64 MB."""

FEWEST = 20
"""Fewest rows of a piece of a split track that is kept.

Choice: v and φ of fewer rows are hardly known; a larger value loses data.
"""


def first_field(commands: Commands) -> float:
    """Return when the first field begins.

    Parameters
    ----------
    commands : Commands
        Commands of a session.

    Returns
    -------
    float
        Time of the first field that is not zero [s]; infinity if there is none.
    """
    driven = commands.t[np.hypot(*commands.field.T) > 0]
    return float(driven[0]) if driven.size else np.inf


@dataclass(frozen=True)
class Interruption:
    """Stretch of time from `begin` to `end` [s] in which a particle does not move as commanded.

    `particle` is its id, or None for all particles.
    """

    begin: float
    end: float
    particle: int | None


@dataclass(frozen=True)
class PreparedSession:
    """One session as arrays of T frames and N tracks of P ≤ N particles.

    Attributes
    ----------
    name : str
        Name of the session.
    ids : ndarray, shape (N,)
        Particle of each track, ascending. A particle has another track after a step too large for
        any motion.
    times : ndarray, shape (T,)
        Times [s] from the first frame of the session.
    z : ndarray of complex, shape (T, N)
        Positions [m]; 0 where not finite.
    pieces : ndarray of int, shape (T, N)
        Piece of its track that each row belongs to, numbered from 1; 0 for unused rows. Nothing is
        learned from the displacement between two pieces.
    causal_positions : ndarray, shape (T, N, 2)
        Positions [m] as known from earlier and present frames only, for effects that depend on
        position (raw ones would bias them); NaN while a particle is out of view.
    commands : Commands
        Commands on the same clock.
    conditions : Conditions
        Conditions of the rig.
    jumps : ndarray of int, shape (P,)
        Slips and steps too large for any motion of each particle.
    phi : ndarray, shape (N,), or None
        φ [rad] from an earlier fit, for terms that depend on the heading.
    speeds_fluctuate : bool
        Whether the noise of every fit includes fluctuating speeds.
    interruptions : tuple of Interruption
        Stretches of time that were left out, since particles did not move as commanded.
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
    interruptions: tuple[Interruption, ...] = ()

    @classmethod
    def of(cls, session: Session) -> PreparedSession:
        """Prepare the frames of a session from the first field on.

        Headings are unknown before. Without any field, all frames are kept. Tracks are whole,
        except at the breaks of the session.

        Parameters
        ----------
        session : Session
            The recording.

        Returns
        -------
        PreparedSession
            The frames, without any split.
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
        """Index of the longest track (P,) of every particle."""
        rows = self.seen.sum(axis=0)
        return np.array([max(np.flatnonzero(self.ids == name), key=rows.__getitem__)
                         for name in np.unique(self.ids)], dtype=int)

    def joined(self, ahead: int = 1) -> np.ndarray:
        """Return whether each row and a later one lie in one piece.

        Parameters
        ----------
        ahead : int, optional
            Distance of the rows in frames.

        Returns
        -------
        ndarray of bool, shape (T − ahead, N)
            By the earlier row.
        """
        joined: np.ndarray = self.seen[ahead:] & (self.pieces[ahead:] == self.pieces[:-ahead])
        return joined

    @cached_property
    def timeline(self) -> Timeline:
        """Commands and frames, ready to evaluate models on; ValueError with fewer than two."""
        return Timeline(self.commands, self.times, self.causal_positions, self.ids, self.phi)

    @cached_property
    def switches(self) -> np.ndarray:
        """Rows (K,) of the commands that change a command held for HELD."""
        commands = self.commands
        told = np.column_stack([commands.field, commands.frequency_at(commands.t)])
        change = np.append(0, 1 + np.flatnonzero((told[1:] != told[:-1]).any(axis=1)))
        began = commands.t[change]
        inside = (began[1:] > self.times[0]) & (began[1:] < self.times[-1])
        return change[1:][(np.diff(began) >= HELD) & inside]

    @cached_property
    def interval(self) -> float:
        """Median time between frames [s]."""
        return float(np.median(np.diff(self.times)))

    @cached_property
    def rotational_diffusion(self) -> float | None:
        """Rotational diffusion [rad²/s] by Stokes–Einstein–Debye; None where unknown."""
        known = stokes_einstein(self.conditions)
        return known and known[1]

    def after_first_field(self, seconds: float) -> PreparedSession:
        """Remove the first frames after the field came on.

        Parameters
        ----------
        seconds : float
            Time since the first field [s].

        Returns
        -------
        PreparedSession
            The later frames.
        """
        return self.from_frame(int(self.times.searchsorted(first_field(self.commands) + seconds)))

    def from_frame(self, first: int) -> PreparedSession:
        """Remove the frames before a frame.

        Parameters
        ----------
        first : int
            Index of the first frame that is kept.

        Returns
        -------
        PreparedSession
            The later frames.
        """
        return replace(
            self, times=self.times[first:], z=self.z[first:], pieces=self.pieces[first:],
            causal_positions=self.causal_positions[first:])

    def only(self, frames: np.ndarray) -> PreparedSession:
        """Return the session as if only some frames had been recorded, with all commands.

        Tracks are cut there: no displacement across other frames and no place in them is used.

        Parameters
        ----------
        frames : ndarray of bool, shape (T,)
            Frames that are kept.

        Returns
        -------
        PreparedSession
            With the same times.
        """
        places = np.where(frames[:, None, None], self.causal_positions, np.nan)
        hidden = np.broadcast_to(~frames[:, None], self.seen.shape)
        return replace(self, causal_positions=places).split_tracks(hidden)

    def split_at_jumps(self) -> PreparedSession:
        """Start another track after every step too large for any motion.

        Returns
        -------
        PreparedSession
            Tracks of fewer than FEWEST rows are left out, except for the longest.
        """
        both = self.joined()
        steps = np.where(both, np.abs(np.diff(self.z, axis=0)), 0.0)
        usual = np.quantile(steps[both], 0.99) if both.any() else 0.0
        # In the frames that are lost it goes on as before.
        lost = np.maximum(np.diff(self.times) / self.interval - 1, 0.0)[:, None]
        jumped = np.concatenate([
            np.zeros((1, self.z.shape[1]), bool), steps > (JUMP + lost) * usual])
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
        """Remove rows that a track jumps to and back from, as if the tracker slipped for a frame.

        Returns
        -------
        PreparedSession
            Without these rows.
        """
        odd = self._odd_steps(SLIPS)
        out = np.zeros_like(self.seen)
        out[1:-1] = odd[:-1] & odd[1:]
        return self if not out.any() else replace(
            self, pieces=np.where(out, 0, self.pieces), jumps=self.jumps + self._of_particles(out),
            causal_positions=np.where(out[..., None], np.nan, self.causal_positions))

    def cut_at_steps(self) -> PreparedSession:
        """Cut tracks at steps that the motion around them does not explain.

        The tracker was restarted or the stage was touched. The particle stays the same.

        Returns
        -------
        PreparedSession
            With more pieces.
        """
        return self._cut(np.concatenate(
            [np.zeros((1, self.z.shape[1]), bool), self._odd_steps(TOUCHES)]))

    def cut_at(self, rows: np.ndarray) -> PreparedSession:
        """Cut tracks at given rows, where these are few.

        Few are TOUCHES of a track, or no more than the switches of the command: bodies turn over
        before they follow.

        Parameters
        ----------
        rows : ndarray of bool, shape (T, N)
            First rows of new pieces.

        Returns
        -------
        PreparedSession
            With more pieces.
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
        """Return which steps (T − 1, N) are outliers of the motion around them.

        If more than the fraction `rare` of a track are, that is how it moves, and none is an
        outlier.
        """
        steps = np.where(self.joined(), np.diff(self.z, axis=0), np.nan)
        odd = np.stack([_stands_out(track, np.diff(self.times)) for track in steps.T], axis=1)
        odd[:, odd.sum(axis=0) > np.maximum(rare * np.isfinite(steps).sum(axis=0), 2)] = False
        return odd

    def _of_particles(self, rows: np.ndarray) -> np.ndarray:
        """Return how many of `rows` (T, N) each particle has: (P,)."""
        return np.bincount(np.unique(self.ids, return_inverse=True)[1],
                           rows.sum(axis=0)).astype(int)

    def split_at_contacts(self) -> PreparedSession:
        """Split tracks where spheres may touch, since they push each other there.

        Without a known radius, the distance of contact is the smallest that ever occurred.

        Returns
        -------
        PreparedSession
            With more pieces.
        """
        z = np.where(self.seen, self.z, np.nan)
        apart = nearest(z)
        radius = self.conditions.radius
        steps = np.abs(np.diff(z, axis=0))
        blur = BLUR * float(np.nanmedian(steps)) if np.isfinite(steps).any() else 0.0
        contact = 2 * radius if radius else float(apart.min(initial=np.inf)) + blur
        if contact > LARGEST_CONTACT:
            return self
        touching = apart < contact * CONTACT + blur
        touching[1:] |= touching[:-1].copy()
        touching[:-1] |= touching[1:].copy()
        return self.split_tracks(touching)

    def split_tracks(self, out: np.ndarray) -> PreparedSession:
        """Split each track at rows that are not used.

        Pieces of a split track with fewer than FEWEST rows are not used either, except for its
        longest.

        Parameters
        ----------
        out : ndarray of bool, shape (T, N)
            Rows that are not used.

        Returns
        -------
        PreparedSession
            With more pieces.
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
        """Filter `causal_positions` about the displacement by a model.

        Outside pieces they stay as they are: no model predicts what happens in a contact, or where
        a particle is while its heading is lost.

        Parameters
        ----------
        displacement : ndarray of complex, shape (T, N)
            Displacement since the first frame [m].
        noise_ratio : float
            σ²/D less a third of the exposure [s].

        Returns
        -------
        PreparedSession
            With filtered positions.
        """
        from microbot_ros.estimation.likelihood.kernels import filter_positions

        left = filter_positions(self.times, self.pieces, self.z - displacement, noise_ratio)
        inside = self._inside_a_piece[..., None]
        return replace(self, causal_positions=np.where(
            inside, as_vectors(left + displacement), self.causal_positions))

    @property
    def _inside_a_piece(self) -> np.ndarray:
        """Which rows (T, N) are used, or lie between two used rows of one piece."""
        row = np.arange(len(self.times))[:, None]
        before = np.maximum.accumulate(np.where(self.seen, row, 0), axis=0)
        after = np.minimum.accumulate(np.where(self.seen, row, row[-1])[::-1], axis=0)[::-1]
        first, last = (np.take_along_axis(self.pieces, one, axis=0) for one in (before, after))
        return (first > 0) & (first == last)


def nearest(z: np.ndarray) -> np.ndarray:
    """Return the distance of each particle from the nearest other one.

    Parameters
    ----------
    z : ndarray of complex, shape (T, N)
        Positions [m].

    Returns
    -------
    ndarray, shape (T, N)
        Distances [m]; infinite where there is no other one, or a position is not finite.
    """
    z = np.where(np.isfinite(z), z, np.nan)
    result = np.full(z.shape, np.inf)
    frames = max(PAIRS // max(z.shape[1] ** 2, 1), 1)
    for first in range(0, len(z), frames):
        part = z[first:first + frames]
        there = np.flatnonzero(np.isfinite(part).any(axis=0))
        apart = np.abs(part[:, there, None] - part[:, None, there])
        apart[np.isnan(apart)] = np.inf
        apart[:, range(len(there)), range(len(there))] = np.inf
        result[first:first + frames, there] = apart.min(axis=2, initial=np.inf)
    return result


def _stands_out(steps: np.ndarray, intervals: np.ndarray) -> np.ndarray:
    """Return which `steps` (T,) [m] no motion around them explains; NaN is not seen.

    Explained are all steps between those before and after, and all between the median velocities
    of NEAR frames before and after, since commands switch between frames; `intervals` (T,) [s].
    While more than NEAR frames are lost, commands may turn at will: there all steps are explained
    that are no faster than before or after.
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
    before, after = medians[:count], medians[NEAR + 1:NEAR + 1 + count]
    away = intervals[seen] * np.minimum(
        _distance(velocity, before, after),
        _distance(velocity, padded[NEAR - 1:NEAR - 1 + count], padded[NEAR + 1:][:count]))
    lost = intervals[seen] > NEAR * np.median(intervals)
    faster = np.abs(velocity) - np.maximum(np.abs(before), np.abs(after))
    away[lost] = np.minimum(away, intervals[seen] * np.maximum(faster, 0.0))[lost]
    half = AROUND // 2
    usual = np.median(np.lib.stride_tricks.sliding_window_view(
        np.pad(away, half, mode='reflect'), AROUND), axis=1)
    result[seen] = away > STANDS_OUT * np.maximum(usual, np.median(away))
    return result


def _distance(z: np.ndarray, one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return distances of points `z` from segments `one` to `other`, all complex (T,)."""
    way = other - one
    length = np.maximum(np.abs(way) ** 2, 1e-300)
    along = np.clip(((z - one) * way.conj()).real / length, 0.0, 1.0)
    distance: np.ndarray = np.abs(z - one - along * way)
    return distance


def prepare(session: Session) -> PreparedSession:
    """Prepare a session as every fit takes it.

    From the first field on, without slips, cut at outlying steps, and split at jumps and contacts.

    Parameters
    ----------
    session : Session
        The recording.

    Returns
    -------
    PreparedSession
        The prepared session.
    """
    whole = PreparedSession.of(session).without_slips()
    return whole.split_at_jumps().cut_at_steps().split_at_contacts()


def predictable_part(
    session: PreparedSession, model: Model, assumed: float = ROTATIONAL_DIFFUSION,
) -> PreparedSession:
    """Return the part of a session that a model without random headings can explain.

    Headings are unknown until the first field has aligned them, and again after a turn so close to
    180° that Brownian motion chooses its sense.

    Parameters
    ----------
    session : PreparedSession
        The session.
    model : Model
        The model.
    assumed : float, optional
        Rotational diffusion [rad²/s] where radius or viscosity are unknown.

    Returns
    -------
    PreparedSession
        Never less than half of the time.
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
    """Return seconds from the first field until it has lasted FORGOTTEN alignment times.

    Each is `slowness` [T s] over the strength; infinity where the field never lasts so long.
    """
    strength = np.hypot(*commands.field.T)
    lasted = np.append(0.0, np.cumsum(np.diff(commands.t) * strength[:-1] / slowness))
    k = int(np.searchsorted(lasted, FORGOTTEN)) - 1  # the command under which it has
    if strength[k] == 0:
        return np.inf
    missing = (FORGOTTEN - lasted[k]) * slowness / strength[k]
    return float(commands.t[k] + missing) - first_field(commands)


def _lost(session: PreparedSession, model: Model, assumed: float) -> np.ndarray:
    """Return frames (T,) in which headings may be far from those of the model.

    From the beginning, and from when Brownian rotation, amplified by every turn of nearly 180°,
    spreads them wider than a linear filter can follow, until the field has aligned them again.
    """
    nobody = ParticleParameters.from_velocity_phasor(np.zeros(1, int), np.ones(1, complex))
    response = heading_response(model, nobody, session.timeline)
    retention = response.heading_retention[:, 0]
    kick = 2 * (session.rotational_diffusion or assumed) * np.diff(session.times)
    variance = np.full(len(session.times), np.pi**2)
    for k in range(len(retention)):
        variance[k + 1] = min(retention[k] ** 2 * variance[k] + kick[k], np.pi**2)
    # If the variance is always large, rows are lost only at turns.
    usual = USUAL * float(np.median(variance))
    spread, gathered = max(SPREAD**2, 2 * usual), max(GATHERED**2, usual)
    lost = np.ones(len(variance), bool)
    for k in range(1, len(variance)):
        lost[k] = variance[k] > (gathered if lost[k - 1] else spread)
    return lost
