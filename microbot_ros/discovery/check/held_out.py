"""Proof on data that a fit did not see: the gap in prediction.

Recordings are cut: neither a displacement across hidden frames nor a place in them is used, and
every fit begins anew from the frames that it may see.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import stdtrit

from microbot_ros.discovery.hypotheses import add_effects, fit_first_order
from microbot_ros.discovery.processes import Run, serially
from microbot_ros.discovery.result import HORIZON, UNKNOWN, WORTH, Estimate, Gap
from microbot_ros.estimation.likelihood.expected_displacement import ExpectedDisplacement
from microbot_ros.estimation.likelihood.joint import SessionFit
from microbot_ros.estimation.likelihood.model_fit import (
    ModelFit,
    evaluate,
    fit_noise,
    whitening_on,
)
from microbot_ros.estimation.likelihood.prepared_session import FEWEST, PreparedSession
from microbot_ros.model.model import Model

BLOCKS = 5
"""Blocks of time that are predicted in turn, each from all others."""

TURN = 2.4
"""Horizons, or times of the fewest frames that are of use, in a block where blocks take turns."""

STRETCHES = 20
"""Stretches of time, at most, by which the errors of two models are compared: a choice. With half
as many the interval is wider by 8 % (Student's t); with twice as many, stretches of what changes
slowly are less independent of each other.
"""



@dataclass(frozen=True)
class HeldOut:
    """Squared errors (R,) [m²] of open-loop predictions over a `horizon` [s], of one axis.

    `squares`: of each model, over the same displacements; `stretch` (R,): the stretch of time of
    each.
    """

    horizon: float
    squares: dict[str, np.ndarray]
    stretch: np.ndarray

    def gap(self, fit: ModelFit) -> Gap:
        """Return the gap over the noise of a `fit`."""
        floor = _floor(fit, self.horizon)
        excess = {name: _excess(square, floor) for name, square in self.squares.items()}
        return Gap(self.horizon, excess['before'], excess['after'], floor,
                   excess.get('truth', np.nan), excess.get('learned', np.nan),
                   self.closed('before', 'after'), self.closed('before', 'learned'))

    def closed(self, one: str, other: str) -> Estimate:
        """Return the squared error of `one` model less that of an `other`."""
        if other not in self.squares:
            return UNKNOWN
        return mean_by_stretch(self.squares[one] - self.squares[other], self.stretch)

    def worth_explaining(self, fit: ModelFit) -> bool:
        """Return whether something beside the effects of a `fit` is foretold, or could be.

        A term that was learned has to lower the squared error; without one, predictions have to
        err by more than the noise of the fit. Each by WORTH of the noise floor. Also where nothing
        could be held out.
        """
        floor = _floor(fit, self.horizon)
        squares = self.squares
        better = squares['after'] - squares.get('learned', floor**2)
        return not better.size or bool(better.mean() > (WORTH * floor) ** 2)


def hold_out(fit: ModelFit, sessions: Sequence[PreparedSession], names: Collection[str],
             truth: Model | None = None, run: Run = serially,
             relearn: Callable[[ModelFit], ModelFit] | None = None) -> HeldOut:
    """Predict each block of `sessions` open loop over a horizon, from a fit to all other blocks.

    Before: by the first-order model. After: by the search, made anew on the other blocks of
    prepared `sessions`. Effects are selected there, too, among `names`: those that are worth a
    look on all rows. The part of the sessions that is judged is that of `fit`, the result of the
    search on all rows: no model foretells a heading that chance has scattered. The effects of
    `truth`, where it is known, are not fitted. What depends on position is taken where the
    particles were. `relearn` adds terms to a fit, which are selected and learned from what that
    leaves, beside the first-order model where `fit` has no effects. Blocks are short: no fit tells
    of a frequency, or of a time, at which nothing was seen. `run` shares the blocks. All models
    are judged on the same rows, those whose particles every one of them knows.
    """
    shortest = min(float(np.ptp(session.times)) for session in sessions)
    horizon = min(HORIZON, shortest / (2 * BLOCKS))
    judged = [_explicable(session, p.session)
              for session, p in zip(sessions, fit.session_fits, strict=True)]

    def errors_in(block: int) -> tuple[list[str], np.ndarray]:
        inside = [_turns(s, horizon) == block for s in sessions]
        rest = [s.only(~hidden) for s, hidden in zip(sessions, inside, strict=True)]
        before = fit_first_order(rest)
        learned = {'before': before, 'after': add_effects(before, rest, names)}
        if relearn:
            learned['learned'] = relearn(learned['after'] if fit.model.effects else before)
        if truth:
            known = [p.whitening for p in before.session_fits]
            learned['truth'] = fit_noise(evaluate(truth, rest, known))
        return list(learned), np.concatenate([
            _errors(list(learned.values()), k, session, hidden, horizon)
            for k, (session, hidden) in enumerate(zip(judged, inside, strict=True))])

    blocks = list(run(errors_in, range(BLOCKS)))
    stretch, *squares = np.concatenate([rows for _, rows in blocks]).T
    return HeldOut(horizon, dict(zip(blocks[0][0], squares, strict=True)), stretch)


def _carried_over(model: Model, known: SessionFit, session: PreparedSession) -> SessionFit:
    """A `model` on another `session` of the particles and the noise of a `known` one."""
    session = replace(session, phi=np.angle(known.velocity_phasor))
    expected = ExpectedDisplacement.of(model, session.timeline)
    located = session.with_filtered_positions(
        expected.at(known.velocity_phasor), known.whitening.noise_ratio)
    return SessionFit.of(located, whitening_on(model, known, located),
                         ExpectedDisplacement.of(model, located.timeline))


def _turns(session: PreparedSession, horizon: float) -> np.ndarray:
    """Which of BLOCKS every frame (T,) belongs to, where short blocks take turns."""
    length = max(TURN * horizon, TURN * FEWEST * session.interval)
    return ((session.times - session.times[0]) / length).astype(int) % BLOCKS


def _explicable(session: PreparedSession, part: PreparedSession) -> PreparedSession:
    """A `session` with the rows of the `part` of it that the model found can explain."""
    pieces = np.zeros_like(session.pieces)
    pieces[np.isin(session.times, part.times)] = part.pieces
    return replace(session, pieces=pieces)


def _excess(squares: np.ndarray, floor: float) -> float:
    return float(np.sqrt(max(squares.mean() - floor**2, 0.0))) if squares.size else float('nan')


def mean_by_stretch(values: np.ndarray, stretch: np.ndarray) -> Estimate:
    """Return the mean of `values` (R,), with its interval by how stretches of time differ.

    Displacements that overlap share their noise, and particles of one moment share what acts on
    all: a `stretch` (R,) of time counts as one observation. What the fits do not know of their
    parameters is not in the interval.
    """
    _, which = np.unique(stretch, return_inverse=True)
    count = np.bincount(which)
    if len(count) < 2:
        return UNKNOWN
    mean = float(values.mean())
    apart = np.bincount(which, values) - mean * count
    std = float(np.sqrt(len(count) / (len(count) - 1) * (apart**2).sum()) / count.sum())
    half = float(stdtrit(len(count) - 1, 0.975)) * std
    return Estimate(mean, std, mean - half, mean + half)


def _errors(fits: Sequence[ModelFit], k: int, whole: PreparedSession, frames: np.ndarray,
            horizon: float) -> np.ndarray:
    """Return the squared errors (R, 1 + M) of M `fits` within some `frames` (T,) of session `k`.

    R displacements over the horizon, of one axis [m²], the mean of both. The first column is the
    number of the stretch of time in which a displacement begins.
    """
    ahead = max(round(horizon / whole.interval), 1)
    use = whole.joined(ahead) & (frames[ahead:] & frames[:-ahead])[:, None]
    squares = []
    for fit in fits:
        learned = fit.session_fits[k]
        here = _carried_over(fit.model, learned, whole)
        left = whole.z - here.expected.at(learned.velocity_phasor)
        squares.append(np.abs(left[ahead:] - left[:-ahead] - _by_headings(here, left, ahead)) ** 2
                       / 2)
        use &= _known(learned, here, horizon)
    elapsed = whole.times[:-ahead] - whole.times[0]
    length = max(TURN * horizon, float(np.ptp(whole.times)) / STRETCHES)
    stretch = k * (STRETCHES + 1) + (elapsed / length).astype(int)
    return np.stack([np.broadcast_to(stretch[:, None], use.shape)[use],
                     *(square[use] for square in squares)], axis=1)


def _by_headings(here: SessionFit, left: np.ndarray, ahead: int) -> np.ndarray | float:
    """Return how much further (T − ahead, N) [m] particles get as their headings deviate.

    Under a lag, which way a heading deviates from the model at the beginning of a prediction is
    known from the positions until then, of which a model leaves `left` (T, N) [m].
    """
    noise = here.whitening
    if noise.sensitivity is None or noise.retention is None or noise.fluctuation is not None:
        return 0.0
    from microbot_ros.estimation.likelihood.kernels import filter_headings

    session = here.session
    deviation = filter_headings(session.times, session.pieces, left, noise.noise_ratio,
                                noise.diffusion_ratio, noise.sensitivity, noise.retention)
    deviation, further = deviation[:-ahead], np.zeros_like(left[ahead:])
    for k in range(ahead):
        rows = slice(k, k + len(further))
        further += noise.sensitivity[rows] * deviation
        deviation = deviation * noise.retention[rows]
    return further


def _known(learned: SessionFit, here: SessionFit, horizon: float) -> np.ndarray:
    """Particles (N,) that were seen enough elsewhere for their v and φ to be of use."""
    std = np.minimum(learned.phasor_std, 1.0)
    step = np.diff(here.session.times)[:, None]
    own = np.abs(np.diff(here.expected.along, axis=0)) / step
    travelled = horizon * np.sqrt((own**2).mean(axis=0))
    floor = np.sqrt(2 * learned.diffusion * horizon + learned.unsteady_motion(horizon))
    known: np.ndarray = std * travelled < 0.5 * floor
    return known


def _floor(fit: ModelFit, horizon: float) -> float:
    """√(2D·horizon + 2σ²), averaged over sessions, with what speeds that fluctuate add."""
    values = [
        2 * p.diffusion * (max(round(horizon / p.session.interval), 1) * p.session.interval)
        + 2 * max(p.whitening.noise_ratio, 0.0) * p.diffusion + p.unsteady_motion(horizon)
        for p in fit.session_fits
    ]
    return float(np.sqrt(np.average(values, weights=[p.count for p in fit.session_fits])))
