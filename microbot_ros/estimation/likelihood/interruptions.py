"""Stretches of time in which particles do not move as commanded: an interruption, not an effect.

A particle sticks to the floor or is knocked, or commands are missing in the log. For a while one
particle, or all of a recording, then have another velocity than the model predicts. The evidence
for such a stretch is the Bayes factor of a velocity (1 + β) times the model's, for a complex β
with a normal prior of standard deviation 1 per axis, less the logarithm of the number of stretches
that were tried. The noise is that of the rows outside interruptions.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from microbot_ros.estimation.likelihood.joint import SessionFit
from microbot_ros.estimation.likelihood.model_fit import BY_CHANCE, ModelFit, evaluate, fit_noise
from microbot_ros.estimation.likelihood.prepared_session import Interruption, PreparedSession
from microbot_ros.model.model import Model

SHORTEST, LONGEST, FINER = 0.2, 5.0, 1.25
"""Shortest and longest stretch [s], and the ratio of one length to the next.

Choice: tracks are cut at single steps already; a longer stretch is found in parts. A length that
is off by half of the ratio loses a tenth of the evidence.
"""

RARE = 0.2
"""Largest fraction of the rows of a session that interruptions may take.

Choice: what acts for more of the time is an effect. With half of it, two lost commands of some
seconds in a minute are not recognised; with twice of it, effects that come and go are cut.
"""

PASSES = 3
"""Maximum number of searches, each with the noise outside the interruptions of the one before.

Choice: strong interruptions hide weak ones; the third search rarely finds more.
"""


@dataclass(frozen=True)
class _Stretch:
    """Stretch of rows `first` to `last` of one track or all (None), its gain and Bayes factor.

    `gain` is that of 2 log likelihood; `price` is the part of it that is paid for.
    """

    gain: float
    price: float
    first: int
    last: int
    track: int | None

    @property
    def worth(self) -> float:
        """Log Bayes factor."""
        return self.gain / 2 - self.price

    def within(self, session: PreparedSession) -> np.ndarray:
        """Return which rows (T, N) of a session it takes."""
        rows = np.zeros_like(session.seen)
        rows[self.first:self.last, self._tracks(session)] = True
        return rows

    def _tracks(self, session: PreparedSession) -> np.ndarray | slice:
        return slice(None) if self.track is None else session.ids == session.ids[self.track]

    def told(self, session: PreparedSession) -> Interruption:
        """Return the interruption."""
        name = None if self.track is None else int(session.ids[self.track])
        return Interruption(
            float(session.times[self.first]), float(session.times[self.last - 1]), name)


def interrupted(sessions: Sequence[PreparedSession],
                fit: ModelFit) -> tuple[list[PreparedSession], float] | None:
    """Return the sessions without interruptions, where the data show some and they are rare.

    Parameters
    ----------
    sessions : sequence of PreparedSession
        The sessions.
    fit : ModelFit
        Fit of these sessions.

    Returns
    -------
    (list of PreparedSession, float) or None
        The sessions, and the log evidence for the interruptions; None if there are none, or if
        they take more than RARE of a session.
    """
    rest, evidence = [], 0.0
    for session, p in zip(sessions, fit.session_fits, strict=True):
        found, worth = _interruptions(fit.model, p)
        out = np.zeros_like(session.seen)
        out[np.isin(session.times, p.session.times)] = _rows(found, p.session)
        if (out & session.seen).sum() > RARE * session.seen.sum():
            return None
        evidence += worth
        told = sorted((one.told(p.session) for one in found), key=lambda one: one.begin)
        rest.append(replace(session.split_tracks(out),
                            interruptions=(*session.interruptions, *told)))
    return (rest, evidence) if evidence > 0 else None


def _interruptions(model: Model, p: SessionFit) -> tuple[list[_Stretch], float]:
    """Return the interruptions of a session, and the log evidence for all of them."""
    found: list[_Stretch] = []
    evidence, usual = 0.0, p
    for _ in range(PASSES):
        whole = SessionFit.of(p.session, usual.whitening, p.expected)
        before, (found, left) = len(found), _stretches(whole, usual)
        if not found:
            return [], 0.0
        freedom = whole.degrees_of_freedom
        evidence = -0.5 * freedom * (math.log(2 * math.pi * left / freedom) + 1) - (
            whole.log_det + p.log_likelihood + sum(one.price for one in found))
        out = _rows(found, p.session)
        if len(found) == before or (out & p.session.seen).sum() > RARE * p.session.seen.sum():
            break
        usual = fit_noise(evaluate(
            model, [p.session.split_tracks(out)], [p.whitening])).session_fits[0]
    return found, evidence


def _rows(found: Sequence[_Stretch], session: PreparedSession) -> np.ndarray:
    """Return the rows (T, N) of all stretches."""
    return np.any([one.within(session) for one in found], axis=0) if found else (
        np.zeros_like(session.seen))


def _stretches(whole: SessionFit, usual: SessionFit) -> tuple[list[_Stretch], float]:
    """Return interruptions of a session, and the residual sum of squares [m²/s] beside them.

    `whole` has all rows, whitened by the noise of the `usual` ones, whose v, φ and D hold.
    """
    session, phasor = whole.session, usual.velocity_phasor
    data, along, across = np.moveaxis(whole.white, -1, 0)
    ways = np.stack([along * phasor.real + across * phasor.imag,
                     across * phasor.real - along * phasor.imag]) / math.sqrt(usual.diffusion)
    left = data / math.sqrt(usual.diffusion) - ways[0]
    slope, power = (ways.conj() * left).real, np.abs(ways) ** 2
    lengths = _lengths(session)
    alone = [None, *range(len(session.ids))] if len(np.unique(session.ids)) > 1 else [None]
    trials = math.log(max(len(session.times) * len(lengths) * len(alone), 1))
    found = []
    while (best := max((_best(slope, power, track, lengths, trials) for track in alone),
                       key=lambda one: one.worth)).worth > -math.log(BY_CHANCE):
        rows = best.within(session)
        slope[:, rows] = power[:, rows] = 0.0
        found.append(best)
    gained = sum(one.gain for one in found)
    return found, (float((np.abs(left) ** 2).sum()) - gained) * usual.diffusion


def _lengths(session: PreparedSession) -> np.ndarray:
    """Return the lengths of stretches that are tried, in frames."""
    least, most = SHORTEST / session.interval, LONGEST / session.interval
    count = 1 + round(math.log(most / least) / math.log(FINER))
    lengths = np.unique(np.rint(np.geomspace(least, most, count)).astype(int))
    kept: np.ndarray = lengths[(lengths > 0) & (lengths < len(session.times))]
    return kept


def _best(slope: np.ndarray, power: np.ndarray, track: int | None, lengths: np.ndarray,
          trials: float) -> _Stretch:
    """Return the best stretch of one track, or of all (None).

    `slope` and `power` (2, T, N) are the products of the velocity's two axes with the residual and
    with themselves; `trials` is the log of the number of stretches.
    """
    chosen = slice(None) if track is None else slice(track, track + 1)
    total = np.zeros((2, 2, slope.shape[1] + 1))
    np.cumsum([part[..., chosen].sum(axis=-1) for part in (slope, power)], axis=-1,
              out=total[..., 1:])
    best = _Stretch(0.0, np.inf, 0, 1, track)
    for length in lengths.tolist():
        a, wide = total[..., length:] - total[..., :-length]
        gain = (a**2 / (1 + wide)).sum(axis=0)
        price = np.log1p(wide).sum(axis=0) / 2 + trials
        k = int((gain / 2 - price).argmax())
        best = max(best, _Stretch(float(gain[k]), float(price[k]), k, k + length, track),
                   key=lambda one: one.worth)
    return best
