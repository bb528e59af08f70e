"""A common error of the time stamps: commands seem to act a part of a frame too early or late.

A program that reads a clock after each frame, or that applies commands from one frame to the next,
shifts all commands against all frames. That is the instrument's, and no missing effect.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from microbot_ros.estimation.likelihood.expected_displacement import ExpectedDisplacement
from microbot_ros.estimation.likelihood.joint import (
    SessionFit,
    eliminate,
    eliminate_shared,
    inner,
)
from microbot_ros.estimation.likelihood.model_fit import COLLINEAR, ModelFit
from microbot_ros.model.model import Model
from microbot_ros.model.parameter import STAMPS

STEP = 0.5
"""Shift for the difference quotient, in frame intervals. Choice: the shift that is looked for; at
a tenth of it the same shifts are found within their errors."""

CERTAIN = 3.0
"""Standard deviations above which a shift is reported. Choice: one session of 400 has such a shift
by chance."""


@dataclass(frozen=True)
class TimeShift:
    """How much later than told the commands of a session act, beside all that was fitted.

    Attributes
    ----------
    column : ndarray of complex, shape (T, N, 1)
        Whitened displacement per second of shift, in units of the noise.
    shift : float
        Shift [s]; negative if commands act earlier.
    std : float
        Standard deviation [s].
    interval : float
        Frame interval [s].
    """

    column: np.ndarray
    shift: float
    std: float
    interval: float

    @classmethod
    def of(cls, p: SessionFit, model: Model, jacobian: np.ndarray) -> TimeShift | None:
        """Measure the shift of a session.

        Parameters
        ----------
        p : SessionFit
            Fit of the session.
        model : Model
            Model of the fit.
        jacobian : ndarray, shape (T, N, P)
            Whitened derivatives by the parameters of the model.

        Returns
        -------
        TimeShift or None
            None if the commands do not show it, or the model has a delay of its own.
        """
        if model.delay:
            return None
        step = STEP * p.session.interval
        later, earlier = (_displacement(p, model, by) for by in (step, -step))
        column = p.whiten(((later - earlier) / (2 * step))[..., None])
        gram = inner(np.concatenate([p.white / np.sqrt(p.diffusion), jacobian, column], axis=-1))
        alone = float(gram[:, -1, -1].sum())
        rest = eliminate_shared(eliminate(gram).sum(axis=0), jacobian.shape[-1])
        if not rest[1, 1] > COLLINEAR * alone:
            return None
        return cls(column, float(rest[0, 1] / rest[1, 1]), float(rest[1, 1] ** -0.5),
                   p.session.interval)

    @property
    def is_of_clock(self) -> bool:
        """Whether the shift is less than a frame interval, as an error of a clock may be."""
        return abs(self.shift) < self.interval

    @property
    def is_noted(self) -> bool:
        """Whether it is an error of the clock that is certain and above the floor of a time."""
        return self.is_of_clock and abs(self.shift) > max(STAMPS, CERTAIN * self.std)


def time_shifts(fit: ModelFit) -> list[TimeShift | None]:
    """Measure the shift of each session of a fit.

    Parameters
    ----------
    fit : ModelFit
        Any fit.

    Returns
    -------
    list of TimeShift or None
        One for each session.
    """
    return [TimeShift.of(p, fit.model, jacobian)
            for p, jacobian in zip(fit.session_fits, fit.jacobian, strict=True)]


def _displacement(p: SessionFit, model: Model, by: float) -> np.ndarray:
    """Return the expected displacements (T, N) [m] if all commands came so much later [s]."""
    commands = p.session.commands
    moved = replace(p.session, commands=replace(commands, t=commands.t + by))
    return ExpectedDisplacement.of(model, moved.timeline).at(p.velocity_phasor)
