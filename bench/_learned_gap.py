"""The gap that something learned leaves, on blocks it was not learned from, ours or a peer's."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from bench._unlisted_worlds import Filmed
from microbot_ros.discovery.check import held_out
from microbot_ros.discovery.check.input_checks import check_sessions
from microbot_ros.discovery.hypotheses import fit_first_order
from microbot_ros.estimation.likelihood.model_fit import ModelFit
from microbot_ros.estimation.likelihood.prepared_session import PreparedSession

Foretold = tuple[ModelFit, np.ndarray | float]
"""A fit to the rows that were shown, and displacements (T, N) [m] that are added to its own."""


def only_session(filmed: Filmed) -> PreparedSession:
    """What was filmed, as it is fitted."""
    (session,), _ = check_sessions([filmed.session])
    return session


def gaps(filmed: Filmed, session: PreparedSession,
         ways: Sequence[Callable[[np.ndarray], Foretold]]) -> list[float]:
    """Held-out gap [m] of one axis a second ahead, by each of the `ways` to foretell a `session`.

    A way is told which rows (T,) are shown. As `hold_out`, blocks learned from the others, but
    against the displacement that the world really asked for, since the noise of a minute hides
    what is less than a quarter of its floor; beyond what is missed where all that was hidden is
    known, and v and φ are not.
    """
    own, pushed = (part[session.ids] if part.ndim == 1 else part[:, session.ids]
                   for part in (_swum(filmed), pushes(filmed, session)))
    fit = fit_first_order([session])
    true = fit.session_fits[0].expected.at(own) + pushed
    clean = replace(session, z=session.z - pushed)

    def told(shown: np.ndarray) -> Foretold:
        return fit_first_order([clean.only(shown)]), pushed

    errors: list[list[np.ndarray]] = [[] for _ in range(len(ways) + 1)]
    ahead = max(round(1.0 / session.interval), 1)
    for block in range(held_out.BLOCKS):
        hidden = held_out._turns(session, 1.0) == block
        both = session.joined(ahead) & (hidden[ahead:] & hidden[:-ahead])[:, None]
        for way, kept in zip((*ways, told), errors, strict=True):
            one, added = way(~hidden)
            (known,) = one.session_fits
            here = held_out._carried_over(one.model, known, session)
            left = true - here.expected.at(known.velocity_phasor) - added
            kept.append(np.abs((left[ahead:] - left[:-ahead])[both]) / np.sqrt(2))
    *squares, least = (float(np.mean(np.concatenate(kept) ** 2)) for kept in errors)
    return [float(np.sqrt(max(square - least, 0.0))) for square in squares]


def pushes(filmed: Filmed, session: PreparedSession) -> np.ndarray:
    """How far (T, particles) [m] what was hidden has pushed each particle since the start."""
    done = filmed.velocities(session.times + filmed.session.tracks.t.min())
    return np.concatenate([np.zeros((1, done.shape[1]), complex), np.cumsum(
        done * np.diff(session.times)[:, None], axis=0)])


def _swum(filmed: Filmed) -> np.ndarray:
    return np.asarray(filmed.swarm['speed'] * np.exp(1j * filmed.swarm['phi']))
