"""Prediction of held-out data: the gap.

Recordings are cut: no displacement across hidden frames and no place in them is used, and every
fit starts anew from the frames that it may use.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import stdtrit

from microbot_ros.discovery.check.score_tests import squared_floor
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
"""Number of folds, each predicted from all others. Choice: the usual five."""

TURN = 2.4
"""Length of an interleaved block, in horizons or times of the fewest usable frames.

Choice: with less, few displacements over a horizon fit into a block; with more, what changes in
time is not seen near a block.
"""

STRETCHES = 20
"""Maximum number of stretches of time by which the errors of two models are compared.

Choice: with half as many the interval is wider by 8 % (Student's t); with twice as many, stretches
of what changes slowly are less independent of each other.
"""



@dataclass(frozen=True)
class HeldOut:
    """Squared errors of open-loop predictions on R held-out displacements.

    Attributes
    ----------
    horizon : float
        Prediction horizon [s].
    squares : dict of str to ndarray, shape (R,)
        Squared error of one axis [m²] by model, for the same displacements.
    stretch : ndarray, shape (R,)
        Number of the stretch of time of each displacement.
    """

    horizon: float
    squares: dict[str, np.ndarray]
    stretch: np.ndarray

    def gap(self, fit: ModelFit) -> Gap:
        """Return the errors in excess of the noise of a fit.

        Parameters
        ----------
        fit : ModelFit
            Fit whose noise makes the floor.

        Returns
        -------
        Gap
            Errors [m], and the decrease of the squared error [m²].
        """
        floor = _floor(fit, self.horizon)
        excess = {name: _excess(square, floor) for name, square in self.squares.items()}
        return Gap(self.horizon, excess['before'], excess['after'], floor,
                   excess.get('truth', np.nan), excess.get('learned', np.nan),
                   self.closed('before', 'after'), self.closed('before', 'learned'))

    def closed(self, one: str, other: str) -> Estimate:
        """Return the mean squared error of one model less that of another.

        Parameters
        ----------
        one, other : str
            Names of the models.

        Returns
        -------
        Estimate
            Difference [m²]; unknown without the other model.
        """
        if other not in self.squares:
            return UNKNOWN
        return mean_by_stretch(self.squares[one] - self.squares[other], self.stretch)

    def worth_explaining(self, fit: ModelFit, beyond: str = 'after') -> bool:
        """Return whether something beside the effects of a fit is predictable, or could be.

        A learned term has to lower the squared error. Without a term, the prediction error has to
        exceed the noise. Both are compared with WORTH times the noise floor.

        Parameters
        ----------
        fit : ModelFit
            Fit whose noise makes the floor.
        beyond : str
            Model whose error is to be lowered: 'before' where the effects of the fit themselves
            may stand in for another cause.

        Returns
        -------
        bool
            True also if nothing could be held out.
        """
        floor = _floor(fit, self.horizon)
        squares = self.squares
        better = squares[beyond] - squares.get('learned', floor**2)
        return not better.size or bool(better.mean() > (WORTH * floor) ** 2)


def hold_out(fit: ModelFit, sessions: Sequence[PreparedSession], names: Collection[str],
             truth: Model | None = None, run: Run = serially,
             relearn: Callable[[ModelFit], ModelFit] | None = None) -> HeldOut:
    """Predict each block of the sessions open loop, from fits to all other blocks.

    `before` is the first-order model. `after` is the search, repeated on the other blocks. Blocks
    are short, so no fit has to predict at a frequency or a time without data. All models are
    judged on the same rows: those whose particles every one of them knows.

    Parameters
    ----------
    fit : ModelFit
        Result of the search on all rows. Only rows that it uses are judged, since no model
        predicts a heading that chance has scattered.
    sessions : sequence of PreparedSession
        All rows of the sessions.
    names : collection of str
        Effects that the repeated search may add: the credible ones on all rows.
    truth : Model, optional
        True model of a simulation; its effects are not fitted.
    run : Run, optional
        Distributes the blocks.
    relearn : callable, optional
        Adds learned terms to a fit: selected and learned from its residual, or from that of the
        first-order model where `fit` has no effects.

    Returns
    -------
    HeldOut
        Squared errors of `before`, `after`, and of `learned` and `truth` where given.

    Notes
    -----
    Effects that depend on position are evaluated where the particles were.
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
    """Return the fit of a `model` on another `session`, with particles and noise of `known`."""
    session = replace(session, phi=np.angle(known.velocity_phasor))
    expected = ExpectedDisplacement.of(model, session.timeline)
    located = session.with_filtered_positions(
        expected.at(known.velocity_phasor), known.whitening.noise_ratio)
    return SessionFit.of(located, whitening_on(model, known, located),
                         ExpectedDisplacement.of(model, located.timeline))


def _turns(session: PreparedSession, horizon: float) -> np.ndarray:
    """Return which of BLOCKS every frame (T,) belongs to; short blocks are interleaved."""
    length = max(TURN * horizon, TURN * FEWEST * session.interval)
    return ((session.times - session.times[0]) / length).astype(int) % BLOCKS


def _explicable(session: PreparedSession, part: PreparedSession) -> PreparedSession:
    """Return a `session` with only the rows of that `part` of it that the fit used."""
    pieces = np.zeros_like(session.pieces)
    pieces[np.isin(session.times, part.times)] = part.pieces
    return replace(session, pieces=pieces)


def _excess(squares: np.ndarray, floor: float) -> float:
    return float(np.sqrt(max(squares.mean() - floor**2, 0.0))) if squares.size else float('nan')


def mean_by_stretch(values: np.ndarray, stretch: np.ndarray) -> Estimate:
    """Return the mean of values, with an interval from the differences between stretches of time.

    Overlapping displacements share their noise, and particles of one moment share what acts on
    all. A stretch of time therefore counts as one observation. The uncertainty of the fitted
    parameters is not part of the interval.

    Parameters
    ----------
    values : ndarray, shape (R,)
        The values.
    stretch : ndarray, shape (R,)
        Number of the stretch of each.

    Returns
    -------
    Estimate
        Mean with 95 % interval (Student's t); unknown for fewer than 2 stretches.
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
    """Return the squared errors (R, 1 + M) of M `fits` in some `frames` (T,) of session `k`.

    Of R displacements over the horizon, one axis [m²], the mean of both. The first column is the
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
    """Return the displacements (T − ahead, N) [m] due to known deviations of headings.

    With a lag, positions before a prediction determine how its initial heading deviates from the
    model. `left` (T, N) [m] are the residuals of these positions.
    """
    noise = here.whitening
    if noise.sensitivity is None or noise.retention is None or noise.fluctuation is not None:
        return 0.0
    from microbot_ros.estimation.likelihood.kernels import whiten_with_heading

    session = here.session
    *_, factors = whiten_with_heading(
        session.times, session.pieces, np.ascontiguousarray(left)[..., None], noise.noise_ratio,
        noise.noise_ratio, noise.diffusion_ratio, noise.sensitivity, noise.retention,
        np.zeros_like(left), 0.0, np.zeros_like(noise.retention),
        np.zeros_like(noise.sensitivity))
    deviation, further = factors[:-ahead, :, 3], np.zeros_like(left[ahead:])
    for k in range(ahead):
        rows = slice(k, k + len(further))
        further += noise.sensitivity[rows] * deviation
        deviation = deviation * noise.retention[rows]
    return further


def _known(learned: SessionFit, here: SessionFit, horizon: float) -> np.ndarray:
    """Return which particles (N,) were seen enough elsewhere for their v and φ to be used."""
    std = np.minimum(learned.phasor_std, 1.0)
    step = np.diff(here.session.times)[:, None]
    own = np.abs(np.diff(here.expected.along, axis=0)) / step
    travelled = horizon * np.sqrt((own**2).mean(axis=0))
    floor = np.sqrt(2 * learned.diffusion * horizon + learned.unsteady_motion(horizon))
    known: np.ndarray = std * travelled < 0.5 * floor
    return known


def _floor(fit: ModelFit, horizon: float) -> float:
    """Return the root mean square of `squared_floor` over the sessions."""
    return float(np.sqrt(np.average([squared_floor(p, horizon) for p in fit.session_fits],
                                    weights=[p.count for p in fit.session_fits])))
