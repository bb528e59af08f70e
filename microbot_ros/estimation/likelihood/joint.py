"""The likelihood of a model on sessions, and its maximum, on which all fits rest.

Positions are a random walk (D) read with an error (σ): the n coordinates of all increments are
Gaussian with covariance D·V, where V depends on σ²/D only (see `noise`). A model is linear in v
e^{iφ} of every particle, with columns X. These and D follow in closed form, and only σ²/D and the
parameters of effects are searched (variable projection: Golub and Pereyra 1973; the Jacobian is
Kaufman's, 1975).

Effects are compared by the profile likelihood with D corrected for degrees of freedom. With p
numbers v cos φ, v sin φ and f = n − p,

    ℓ = −(f/2) (log 2πD + 1) − ½ log|V|,    D = RSS/f.

σ²/D, for which X is constant, maximises the restricted likelihood (REML: Patterson and Thompson
1971; Harville 1974),

    ℓ_R = ℓ − ½ log|XᵀV⁻¹X|.

On many short tracks ℓ alone overestimates D by a factor of 1.1 to 2.2. Effects cannot be compared
by ℓ_R, whose last term depends on the scale of X: an effect that shrinks X would gain by it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from microbot_ros.estimation.likelihood.expected_displacement import ExpectedDisplacement
from microbot_ros.estimation.likelihood.noise import Noise
from microbot_ros.estimation.likelihood.phasor import Polar, polar
from microbot_ros.estimation.likelihood.prepared_session import PreparedSession

SMALLEST, LARGEST = 0.05, 1e5
"""Smallest and largest (`LARGEST`) value of (σ²/D + h/3)/h in the search.

Choice: beyond them σ or D does not show at all.
"""

ENOUGH = 0.01
"""Gain in −2 log likelihood at which a search ends: 0.1 standard deviations remain.

Choice: far below any threshold of evidence; a smaller value costs steps.
"""

VANISHING = 1e-200
"""Power of a parameter's column, in units of the noise, below which its inverse would overflow.

Also the least determinant of the information on v and φ, of which a logarithm is taken.
"""

REMEMBERED = 12
"""Number of whitened columns of a session that are cached.

Choice: more than a model has strengths; each takes 16 bytes per row.
"""

_GOLDEN, _BRACKET = (math.sqrt(5) - 1) / 2, 0.1
"""Golden section of the search, and the width (`_BRACKET`) below which a parabola does the rest.

Choice: over 10 % of σ²/D the likelihood is a parabola.
"""


@dataclass(frozen=True)
class Whitening:
    """Covariance V of a session's positions up to a factor D, as the filter that whitens them.

    Attributes
    ----------
    noise_ratio : float
        σ²/D less a third of the exposure [s]; it may be negative.
    diffusion_ratio : float
        D_r/D [rad²/m²], where headings keep what noise did to them from frame to frame.
    sensitivity, retention : ndarray, shape (T − 1, N)
        Arguments of `kernels.whiten_with_heading`.
    stretch : (float, float)
        Factors by which lengths along x and y appear larger than they are.
    fluctuation : float or None
        Correlation time of velocities [s]. `diffusion_ratio`, `sensitivity` and `retention` then
        describe the relative deviation of each speed. None: velocities are steady.
    swing_ratio : float
        Variance, over D [s], of positions of rollers along their path: they swing forth and back
        with every turn.
    way : ndarray of complex, shape (T, N)
        Direction of each particle's path, of length 1 or 0.
    wander : float
        Variance of the deviation of a velocity's direction [rad²], with the same correlation time,
        over that of its relative speed.
    jitter_ratio : float
        Variance of the time by which commands act early or late, over 2D [s³/m²]; also of bodies
        that turn over before they follow.
    change : ndarray, shape (T − 1, N)
        Squared change of the velocity around each interval [m²/s²].
    uneven_ratio : float
        Variance of a distance along the path, over D, per metre of it [s/m]: steps are uneven.
    stride : ndarray of complex, shape (T − 1, N)
        Square root of each step [√m], in its direction.
    """

    noise_ratio: float
    diffusion_ratio: float = 0.0
    sensitivity: np.ndarray | None = None
    retention: np.ndarray | None = None
    stretch: tuple[float, float] = (1.0, 1.0)
    fluctuation: float | None = None
    swing_ratio: float = 0.0
    way: np.ndarray | None = None
    wander: float = 0.0
    jitter_ratio: float = 0.0
    change: np.ndarray | None = None
    uneven_ratio: float = 0.0
    stride: np.ndarray | None = None

    @cached_property
    def known_columns(self) -> dict[Hashable, tuple[PreparedSession, np.ndarray]]:
        """Latest columns that were whitened, by session and key (`SessionFit.white_columns`)."""
        return {}

    @property
    def is_plain(self) -> bool:
        """Whether both axes are alike and headings have no noise."""
        return self.sensitivity is None and self.stretch == (1.0, 1.0)

    def apply(self, session: PreparedSession,
              columns: np.ndarray) -> tuple[np.ndarray, float, int]:
        """Whiten columns of a session.

        Parameters
        ----------
        session : PreparedSession
            Frames and pieces of tracks.
        columns : ndarray of complex, shape (T, N, M)
            Positions or displacements [m].

        Returns
        -------
        white : ndarray of complex, shape (T, N, M)
            Independent increments of variance D per axis; 0 in unused rows.
        log_det : float
            ½ log|V| over both axes.
        count : int
            Rows used.
        """
        from microbot_ros.estimation.likelihood.kernels import whiten_columns

        if self.sensitivity is not None:
            return self.apply_with_factors(session, columns)[:3]
        rows = session.times, session.pieces
        if self.is_plain:
            return whiten_columns(*rows, columns, self.noise_ratio)
        columns = self._unstretched(columns)
        (x, log_x, count), (y, log_y, _) = (
            whiten_columns(*rows, np.ascontiguousarray(part), ratio)
            for part, ratio in zip((columns.real, columns.imag), self._ratios, strict=True))
        return x + 1j * y, (log_x + log_y) / 2 + self._log_stretch(count), count

    def apply_with_factors(self, session: PreparedSession, columns: np.ndarray,
                           ) -> tuple[np.ndarray, float, int, np.ndarray]:
        """Whiten columns where headings or velocities have noise.

        Parameters
        ----------
        session, columns
            As for `apply`.

        Returns
        -------
        white, log_det, count
            As by `apply`.
        factors : ndarray, shape (T, N, 4)
            As by `kernels.whiten_with_heading`.
        """
        from microbot_ros.estimation.likelihood.kernels import whiten_with_heading

        assert self.sensitivity is not None
        white, log_det, count, factors = whiten_with_heading(
            session.times, session.pieces, self._unstretched(columns), *self._ratios,
            self.diffusion_ratio,
            self._unstretched(self.sensitivity), self.retention,
            self._unstretched(self._swing(session)), self.wander,
            self._kick(self.retention), self._unstretched(self._stride(self.sensitivity)))
        return white, log_det + self._log_stretch(count), count, factors

    @property
    def _ratios(self) -> list[float]:
        """Noise ratio [s] of each axis where lengths are as they are.

        Errors of positions shrink with lengths that appear too large. Blur does not. A ratio below
        0 comes from blur; scaled, it could be lower than any exposure explains.
        """
        return [self.noise_ratio / stretch**2 if self.noise_ratio > 0 else self.noise_ratio
                for stretch in self.stretch]

    def _log_stretch(self, count: int) -> float:
        """Return the share of `stretch` in ½ log|V| of `count` rows."""
        return count * math.log(math.prod(self.stretch))

    def products(self, session: PreparedSession,
                 expected: ExpectedDisplacement) -> tuple[np.ndarray, float, int]:
        """Return inner products of the whitened data and columns, which are not stored.

        For isotropic displacements without stretch only.

        Parameters
        ----------
        session : PreparedSession
            The data.
        expected : ExpectedDisplacement
            Displacements by the model.

        Returns
        -------
        gram : ndarray, shape (N, 3, 3)
            Real inner products of data less offset, along and across.
        log_det : float
            ½ log|V| over both axes.
        count : int
            Rows used.
        """
        from microbot_ros.estimation.likelihood.kernels import (
            whitened_products,
            whitened_products_with_heading,
        )

        columns = session.times, session.pieces, session.z, expected.offset, expected.along
        if self.sensitivity is None:
            return whitened_products(*columns, self.noise_ratio)
        return whitened_products_with_heading(
            *columns, self.noise_ratio, self.diffusion_ratio, self.sensitivity, self.retention,
            self._swing(session), self.wander, self._kick(self.retention),
            self._stride(self.sensitivity))

    def _swing(self, session: PreparedSession) -> np.ndarray:
        """Return how readings scatter along the path of each particle (T, N)."""
        if self.way is None:
            return np.zeros(session.pieces.shape, complex)
        return math.sqrt(self.swing_ratio) * self.way

    def _kick(self, like: np.ndarray | None) -> np.ndarray:
        """Return the variance (T − 1, N) [s] by changes of the command, over D."""
        return np.zeros_like(like) if self.change is None else self.jitter_ratio * self.change

    def _stride(self, like: np.ndarray) -> np.ndarray:
        """Return how uneven the step of each particle is along its path (T − 1, N)."""
        if self.stride is None:
            return np.zeros_like(like)
        return math.sqrt(self.uneven_ratio) * self.stride

    def _unstretched(self, vectors: np.ndarray) -> np.ndarray:
        """Return complex `vectors` as they are, from how they appear."""
        return vectors if self.stretch == (1.0, 1.0) else (
            vectors.real / self.stretch[0] + 1j * vectors.imag / self.stretch[1])


@dataclass(frozen=True)
class SessionFit:
    """Fit of one session for given effects and noise: all that follows in closed form.

    Attributes
    ----------
    session : PreparedSession
        The data.
    whitening : Whitening
        The noise.
    expected : ExpectedDisplacement
        Displacements by the model.
    gram : ndarray, shape (N, 3, 3)
        Real inner products of `white` by track.
    log_det : float
        ½ log|V| over both axes.
    count : int
        Increments used, of two numbers each.
    whitened : ndarray of complex, shape (T, N, 3), optional
        `white`, where it is known already.
    phasor : ndarray of complex, shape (N,), optional
        v e^{iφ} of every track [m/s, rollers m/s/Hz], in place of the most likely one.
    """

    session: PreparedSession
    whitening: Whitening
    expected: ExpectedDisplacement
    gram: np.ndarray
    log_det: float
    count: int
    whitened: np.ndarray | None = None
    phasor: np.ndarray | None = None

    @classmethod
    def of(cls, session: PreparedSession, whitening: Whitening,
           expected: ExpectedDisplacement) -> SessionFit:
        """Fit v e^{iφ} and D of a session.

        Parameters
        ----------
        session : PreparedSession
            The data.
        whitening : Whitening
            The noise.
        expected : ExpectedDisplacement
            Displacements by the model.

        Returns
        -------
        SessionFit
            The fit.
        """
        if expected.isotropic and whitening.stretch == (1.0, 1.0):
            return cls(session, whitening, expected, *whitening.products(session, expected))
        white, log_det, count = whitening.apply(session, columns_of(session, expected))
        return cls(session, whitening, expected, inner(white), log_det, count, white)

    @cached_property
    def white(self) -> np.ndarray:
        """Whitened data less offset, and columns along and across (T, N, 3), of variance D."""
        if self.whitened is not None:
            return self.whitened
        return self.whitening.apply(self.session, columns_of(self.session, self.expected))[0]

    @cached_property
    def velocity_phasor(self) -> np.ndarray:
        """Phasor v e^{iφ} (N,) of every track [m/s, rollers m/s/Hz]; 0 if nothing drove it."""
        if self.phasor is not None:
            return self.phasor
        solved = solve(self.gram[:, 1:, 1:], self.gram[:, 1:, :1])[..., 0]
        own: np.ndarray = solved[:, 0] + 1j * solved[:, 1]
        return own

    @cached_property
    def power(self) -> np.ndarray:
        """Information (N,) on each axis of v e^{iφ}, times D; 0 where nothing drove it."""
        power: np.ndarray = (self.gram[:, 1, 1] + self.gram[:, 2, 2]) / 2
        return power

    @property
    def phasor_std(self) -> np.ndarray:
        """Standard deviation (N,) of v e^{iφ} per axis; infinite where nothing drove it."""
        driven = self.power > 0
        return np.sqrt(np.where(
            driven, self.diffusion / np.where(driven, self.power, 1), np.inf))

    def polar(self) -> Polar:
        """Return speed and φ of every track.

        Returns
        -------
        Polar
            Arrays (N,) with standard deviations; NaN where nothing drove it.
        """
        std = self.phasor_std
        return polar(self.velocity_phasor, np.where(np.isfinite(std), std, np.nan))

    @cached_property
    def residual_sum_of_squares(self) -> float:
        """RSS [m²/s]: D times χ²."""
        own, along, across = self.gram[:, 0].T
        phasor = self.velocity_phasor
        return float((own - along * phasor.real - across * phasor.imag).sum())

    @cached_property
    def degrees_of_freedom(self) -> int:
        """Degrees of freedom f = n − p, at least 1."""
        return max(2 * (self.count - int((self.power > 0).sum())), 1)

    @property
    def fluctuation(self) -> float:
        """Relative standard deviation of each speed about its mean; 0 for steady speeds."""
        time = self.whitening.fluctuation
        return 0.0 if time is None else math.sqrt(
            self.whitening.diffusion_ratio * self.diffusion * time)

    @property
    def wander(self) -> float:
        """Standard deviation [rad] of the direction of each velocity about its mean."""
        return self.fluctuation * math.sqrt(self.whitening.wander)

    @property
    def jitter(self) -> float:
        """RMS displacement by a change of the command, over the change of velocity [s]."""
        return math.sqrt(2 * self.whitening.jitter_ratio * self.diffusion)

    @property
    def localisation(self) -> float:
        """Localisation error σ [m] per axis, less blur."""
        return math.sqrt(max(self.whitening.noise_ratio, 0.0) * self.diffusion)

    def unevenness(self, distance: float) -> float:
        """Return the standard deviation of a distance along the path by uneven steps.

        Parameters
        ----------
        distance : float
            Distance [m].

        Returns
        -------
        float
            Standard deviation [m].
        """
        return math.sqrt(self.whitening.uneven_ratio * self.diffusion * distance)

    @property
    def moved(self) -> np.ndarray:
        """Displacements (T − 1, N) [m] between frames by v, complex."""
        return np.diff(self.expected.along * self.velocity_phasor.real
                       + self.expected.across * self.velocity_phasor.imag, axis=0)

    def unsteady_motion(self, seconds: float) -> float:
        """Return the mean square displacement that fluctuating speeds and swings add.

        Parameters
        ----------
        seconds : float
            Time [s].

        Returns
        -------
        float
            Mean square per axis [m²].
        """
        time = self.whitening.fluctuation
        if time is None:
            return 0.0
        speed = np.abs(self.moved) / np.diff(self.session.times)[:, None]
        memory = 2 * time * (seconds - time * (1 - math.exp(-seconds / time)))
        walked = (self.fluctuation**2 + self.wander**2) * float((speed**2).mean()) * memory
        frames = max(round(seconds / self.session.interval), 1)
        return walked / 2 + self.swing**2 + frames * self._steps()

    def _steps(self) -> float:
        """Return the mean square [m²] per axis by uneven steps and late commands per interval."""
        noise = self.whitening
        if noise.change is None or noise.stride is None:
            return 0.0
        return self.diffusion * float(
            noise.jitter_ratio * noise.change.mean()
            + noise.uneven_ratio * (np.abs(noise.stride) ** 2).mean() / 2)

    @property
    def swing(self) -> float:
        """Standard deviation [m] of each position along the path, as rollers turn."""
        return math.sqrt(self.whitening.swing_ratio * self.diffusion)

    @property
    def diffusion(self) -> float:
        """D [m²/s] at its maximum."""
        return max(self.residual_sum_of_squares / self.degrees_of_freedom, 1e-30)

    @cached_property
    def log_likelihood(self) -> float:
        """ℓ, with v, φ and D at their maximum, by which effects are compared."""
        return (-0.5 * self.degrees_of_freedom * (np.log(2 * np.pi * self.diffusion) + 1)
                - self.log_det)

    @cached_property
    def restricted_log_likelihood(self) -> float:
        """ℓ_R, by which noise levels for the same columns are compared."""
        (_, _, _), (_, a, b), (_, c, d) = self.gram[self.power > 0].transpose(1, 2, 0)
        determinant = np.maximum(a * d - b * c, VANISHING)
        return self.log_likelihood - 0.5 * float(np.log(determinant).sum())

    @cached_property
    def residual(self) -> np.ndarray:
        """Whitened residual (T, N), complex, of unit variance per axis; 0 in unused rows."""
        c = self.velocity_phasor
        fitted = self.white[..., 1] * c.real + self.white[..., 2] * c.imag
        residual: np.ndarray = (self.white[..., 0] - fitted) / np.sqrt(self.diffusion)
        return residual

    def whiten(self, columns: np.ndarray) -> np.ndarray:
        """Whiten other displacements.

        Parameters
        ----------
        columns : ndarray of complex, shape (T, N, M)
            Displacements [m].

        Returns
        -------
        ndarray of complex, shape (T, N, M)
            In units of the noise.
        """
        white = self.whitening.apply(self.session, np.ascontiguousarray(columns, complex))[0]
        white /= np.sqrt(self.diffusion)
        return white

    def white_columns(
            self, columns: Sequence[tuple[Hashable, Callable[[], np.ndarray]]]) -> np.ndarray:
        """Whiten other displacements, with a cache.

        All columns that are not cached are whitened together, since most of the work is the same.

        Parameters
        ----------
        columns : sequence of (hashable, callable)
            Key and function that returns displacements (T, N) [m]. The latest columns whose key is
            not None are cached under it, for this session and noise.

        Returns
        -------
        ndarray of complex, shape (T, N, P)
            Increments of variance D per axis.
        """
        # The session is kept as well, since ids of deleted objects are reused.
        known = self.whitening.known_columns
        shape = self.session.z.shape
        white = np.empty((*shape, len(columns)), complex)
        new = []
        for k, (key, _) in enumerate(columns):
            if (id(self.session), key) in known:
                white[..., k] = known[id(self.session), key][1]
            else:
                new.append(k)
        if not new:
            return white
        moved = np.empty((*shape, len(new)), complex)
        for place, k in enumerate(new):
            moved[..., place] = columns[k][1]()
        found = self.whitening.apply(self.session, moved)[0]
        if len(new) == len(columns):
            white = found
        else:
            white[..., new] = found
        for k in new:
            key = columns[k][0]
            if key is not None:
                if len(known) >= REMEMBERED:
                    del known[next(iter(known))]
                known[id(self.session), key] = self.session, white[..., k].copy()
        return white

    def with_noise_ratio(self, ratio: float) -> SessionFit:
        """Fit the same session with another noise ratio.

        Parameters
        ----------
        ratio : float
            σ²/D less a third of the exposure [s].

        Returns
        -------
        SessionFit
            The fit.
        """
        return SessionFit.of(
            self.session, replace(self.whitening, noise_ratio=ratio), self.expected)

    def noise(self, exposure: float = 0.0) -> Noise:
        """Return D and σ of a fit whose noise ratio is at its maximum.

        Standard deviations follow from the curvature of ℓ_R in log(σ²/D + h/3), by differences.

        Parameters
        ----------
        exposure : float, optional
            Exposure per frame [s].

        Returns
        -------
        Noise
            With standard deviations.
        """
        step, total = 0.05, self.whitening.noise_ratio + self.session.interval / 3
        lower, upper = (
            self.with_noise_ratio(total * math.exp(k * step) - self.session.interval / 3)
            for k in (-1, 1))
        curvature = 2 * self.restricted_log_likelihood - (
            lower.restricted_log_likelihood + upper.restricted_log_likelihood)
        variance = step**2 / max(curvature, 1e-9 * step**2)
        slope = math.log(upper.diffusion / lower.diffusion) / (2 * step)
        known, left = 2 / self.degrees_of_freedom, self.whitening.noise_ratio + exposure / 3
        reading = max(left, 0.0) * self.diffusion
        # d σ²/d log D = σ² and d σ²/d log(σ²/D + h/3) = D (σ²/D + h/3).
        reading_std = math.sqrt(
            reading**2 * known + variance * (reading * slope + total * self.diffusion) ** 2)
        localisation = math.sqrt(reading)
        return Noise(
            self.diffusion, localisation, exposure,
            self.diffusion * math.sqrt(known + slope**2 * variance),
            # σ/2 times the relative spread of σ² if small; its root if σ² is not significant.
            math.sqrt(reading + reading_std) - localisation)


def search_noise_ratio(fit: SessionFit, near: bool = False) -> Iterator[SessionFit | None]:
    """Maximise ℓ_R over the noise ratio, in log(σ²/D + h/3), one evaluation at a time.

    Parameters
    ----------
    fit : SessionFit
        Fit with any noise ratio.
    near : bool, optional
        Whether the maximum is near the ratio of `fit`, from which the search then climbs.

    Yields
    ------
    SessionFit or None
        None after every evaluation, so that a caller with frames to serve can distribute the work;
        the fit at last.
    """
    h = fit.session.interval

    def at(log_total: float) -> SessionFit:
        return fit.with_noise_ratio(math.exp(log_total) - h / 3)

    # No blur lasts longer than the shortest interval.
    shortest = (1 / 3 - SMALLEST) * float(np.diff(fit.session.times).min())
    return climb(at, math.log(h / 3 - shortest), math.log(LARGEST * h),
                 math.log(fit.whitening.noise_ratio + h / 3) if near else None)


def climb(at: Callable[[float], SessionFit], low: float, high: float,
          near: float | None = None) -> Iterator[SessionFit | None]:
    """Maximise ℓ_R over one coordinate, by golden section and then a parabola.

    Parameters
    ----------
    at : callable
        Fit at a coordinate.
    low, high : float
        Bounds of the coordinate.
    near : float, optional
        Coordinate near the maximum, which is then bracketed first, in steps that triple.

    Yields
    ------
    SessionFit or None
        None after every evaluation; the fit at the maximum at last.
    """
    known: dict[float, float] = {}

    def look(u: float) -> None:
        known[u] = at(u).restricted_log_likelihood

    if near is not None:
        step = _BRACKET / 2
        middle = min(max(near, low + step), high - step)
        look(middle)
        yield None
        edges = [middle - step, middle + step]
        for edge in edges:
            look(edge)
            yield None
        for side, bound in ((0, low), (1, high)):
            while edges[side] != bound and known[edges[side]] == max(known.values()):
                step *= 3
                edges[1 - side] = middle
                middle = edges[side]
                edges[side] = min(max(middle + (2 * side - 1) * step, low), high)
                look(edges[side])
                yield None
        low, high = edges
    left, right = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
    while high - low > 1.001 * _BRACKET:
        for u in (left, right):
            if u not in known:
                look(u)
                yield None
        if known[left] > known[right]:
            high, right = right, left
            left = high - _GOLDEN * (high - low)
        else:
            low, left = left, right
            right = low + _GOLDEN * (high - low)
    best = max(known, key=known.__getitem__)
    around = np.array(sorted(known, key=known.__getitem__)[-3:])
    bend, slope, _ = np.polyfit(around - best, [known[u] - known[best] for u in around], 2)
    vertex = best - slope / (2 * bend) if bend < 0 else best
    yield at(float(np.clip(vertex, low, high)))


def columns_of(session: PreparedSession, expected: ExpectedDisplacement) -> np.ndarray:
    """Return what a fit whitens: data less offset, and the columns along and across.

    Parameters
    ----------
    session : PreparedSession
        The data.
    expected : ExpectedDisplacement
        Displacements by the model.

    Returns
    -------
    ndarray of complex, shape (T, N, 3)
        Positions [m], and displacements per unit v [s, rollers 1].
    """
    return np.stack([session.z - expected.offset, *(
        np.broadcast_to(column, session.z.shape) for column in (expected.along, expected.across))],
        axis=-1)


def inner(columns: np.ndarray) -> np.ndarray:
    """Return real inner products of complex columns, by track.

    Parameters
    ----------
    columns : ndarray of complex, shape (T, N, M)
        The columns.

    Returns
    -------
    ndarray, shape (N, M, M)
        Inner products.
    """
    real = np.ascontiguousarray(columns.transpose(1, 2, 0)).view(float)
    product: np.ndarray = real @ real.transpose(0, 2, 1)
    return product


def eliminate(gram: np.ndarray) -> np.ndarray:
    """Project columns 1 and 2 off the others.

    Parameters
    ----------
    gram : ndarray, shape (P, M, M)
        Inner products, by track.

    Returns
    -------
    ndarray, shape (P, M − 2, M − 2)
        Inner products of the rest of columns 0, 3, 4, ….
    """
    rest = [0, *range(3, gram.shape[-1])]
    mixed = gram[:, 1:3, rest]
    left: np.ndarray = gram[:, rest][:, :, rest] - np.swapaxes(mixed, 1, 2) @ solve(
        gram[:, 1:3, 1:3], mixed)
    return left


def eliminate_shared(gram: np.ndarray, count: int) -> np.ndarray:
    """Project columns 1 to `count`, of parameters shared by all tracks, off the others.

    A parameter without effect, as of a spot that no particle came near, is ignored.

    Parameters
    ----------
    gram : ndarray, shape (M, M)
        Inner products.
    count : int
        Number of shared parameters.

    Returns
    -------
    ndarray, shape (M − count, M − count)
        Inner products of the rest of column 0 and of those after `count`.
    """
    own = 1 + np.flatnonzero(np.diagonal(gram)[1:1 + count] > VANISHING)
    rest = [0, *range(1 + count, len(gram))]
    left: np.ndarray = gram[np.ix_(rest, rest)]
    if own.size:
        mixed = gram[np.ix_(own, rest)]
        left -= mixed.T @ np.linalg.pinv(
            gram[np.ix_(own, own)], rcond=1e-10, hermitian=True) @ mixed
    return left


def solve(square: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve 2 × 2 systems.

    Parameters
    ----------
    square : ndarray, shape (N, 2, 2)
        Matrices.
    right : ndarray, shape (N, 2, M)
        Right-hand sides.

    Returns
    -------
    ndarray, shape (N, 2, M)
        Solutions; 0 for a matrix of zeros.
    """
    power = np.trace(square, axis1=1, axis2=2)[:, None, None]
    safe = square + np.where(power > 0, 1e-12 * power, 1.0) * np.eye(2)
    # Not by Cramer's rule, a third of the time: where a fit of the noise ends depends on rounding.
    solved: np.ndarray = np.linalg.solve(safe, right)
    return solved
