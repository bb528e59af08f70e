"""Plan of the field over the next seconds, and its effect on every particle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ros.model.effect_context import EffectContext, Places
from microbot_ros.model.effects.heading.alignment_lag import AlignmentLag
from microbot_ros.model.heading import heading_course
from microbot_ros.model.model import Model

QUICKEST = 0.02
"""Choice: alignment time [s] if the model has none, so that plans are smooth in B."""


@dataclass(frozen=True)
class Plan:
    """`field` (K, 2) [T], each row held for its `duration` (K,) [s]."""

    duration: np.ndarray
    field: np.ndarray

    @property
    def length(self) -> float:
        """Duration of the plan [s]."""
        return float(self.duration.sum())

    def after(self, dt: float) -> Plan:
        """Return the remaining plan `dt` [s] later.

        Parameters
        ----------
        dt : float
            Time that has passed [s].

        Returns
        -------
        Plan
            The remaining plan.
        """
        ends = np.cumsum(self.duration) - dt
        left = ends > 1e-6
        return Plan(np.minimum(self.duration, ends)[left], self.field[left])


@dataclass(frozen=True)
class Swarm:
    """State of N particles at the start of a plan.

    Attributes
    ----------
    ids : (N,) int array
    position : (N,) complex array [m]
    velocity : (N,) complex array
        Velocity phasor v e^{iφ} [m/s].
    heading : (N,) complex array
        e^{i(θ − φ)}.
    models : tuple of N Model
        Models of the particles, which differ in the alignment lag.
    t : float [s]
    """

    ids: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    heading: np.ndarray
    models: tuple[Model, ...]
    t: float

    @property
    def slowest(self) -> float:
        """Longest alignment time [s] at the reference field."""
        return max(model.alignment_time for model in self.models)

    def paths(self, duration: np.ndarray, field: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Integrate headings through K spans of `duration` (K,) [s] under V variants of `field`.

        `field` is (K, V, 2) [T]. Returns ∫e^{i(θ − φ)} dt (K, N, V) [s] and the headings at the
        edges of the spans (K + 1, N, V).

        Parameters
        ----------
        duration : ndarray, shape (K,)
            Durations [s].
        field : ndarray, shape (K, V, 2)
            Fields [T].

        Returns
        -------
        tuple[ndarray, ndarray]
            Integrals (K, N, V) [s] and headings (K + 1, N, V).
        """
        paths, headings = [], []
        # The models differ in their lag only, which is not part of the context.
        context = self._context(self.models[0], duration, self.models[0].field(field))
        for model, start in zip(self.models, self.heading, strict=True):
            course = heading_course(model, context, np.full(field.shape[1], start))
            paths.append(course.path)
            headings.append(course.heading)
        return np.stack(paths, 1), np.stack(headings, 1)

    def surroundings(self, duration: np.ndarray, field: np.ndarray,
                     position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return speed factors and drift (complex) [m/s], both (K, ..., N).

        `field` (K, ..., 2) [T] in spans of `duration` (K,) [s]; `position` (K, ..., N) complex
        [m].

        Parameters
        ----------
        duration : ndarray, shape (K,)
            Durations [s].
        field : ndarray, shape (K, ..., 2)
            Fields [T].
        position : ndarray, shape (K, ..., N)
            Positions, complex [m].

        Returns
        -------
        tuple[ndarray, ndarray]
            Factors and drift [m/s], (K, ..., N) each.
        """
        model = self.models[0]
        places = Places(np.stack([position.real, position.imag], -1), self.ids,
                        np.angle(self.velocity))
        context = self._context(model, duration, model.field(field)[..., None, :], places)
        factor = np.broadcast_to(model.speed_factor(context), position.shape)
        drift = model.drift(context)
        if drift is None:
            return factor, np.zeros(position.shape, complex)
        return factor, np.broadcast_to(drift[..., 0] + 1j * drift[..., 1], position.shape)

    def _context(self, model: Model, duration: np.ndarray, field: np.ndarray,
               places: Places | None = None) -> EffectContext:
        shape = (len(duration), *(1,) * (field.ndim - 2))
        span = duration.reshape(shape)
        middle = self.t + np.cumsum(duration).reshape(shape) - span / 2
        # The command changes at the start of a span.
        return EffectContext(
            middle, span, field, np.ones(shape), model.reference_field, places, span / 2)


def with_lags(model: Model, lags: list[float | None]) -> tuple[Model, ...]:
    """Return the `model` of particles with alignment times `lags` [s]; None: that of the model.

    Parameters
    ----------
    model : Model
        The model.
    lags : list of float or None
        Alignment times [s]; None for that of the model.

    Returns
    -------
    tuple of Model
        One model per particle.
    """
    common = max(model.alignment_time, QUICKEST)
    return tuple(model.with_effect(AlignmentLag(tau=lag or common)) for lag in lags)


@dataclass(frozen=True)
class Rollout:
    """Predicted result of a plan.

    `position` (K, N) complex [m] at the end of each span; `response` (K, N, 2K) complex,
    ∂position/∂field [m] per unit of the field's limit, x and y of the first span first.
    """

    position: np.ndarray
    response: np.ndarray


def roll_out(swarm: Swarm, plan: Plan, limit: float) -> Rollout:
    """Predict the result of a `plan` for a `swarm`, and its derivative by the field.

    The derivative is a difference over a thousandth of `limit` [T]; it has no noise, since
    headings are integrated exactly. Speed factors and drift are those at the positions of the plan
    itself.

    Parameters
    ----------
    swarm : Swarm
        The swarm.
    plan : Plan
        The plan.
    limit : float
        Largest field [T].

    Returns
    -------
    Rollout
        The prediction.
    """
    count = len(plan.duration)
    step = 1e-3
    field = np.repeat(plan.field[:, None, :], 2 * count + 1, axis=1)
    for k in range(count):
        for axis in (0, 1):
            field[k, 1 + 2 * k + axis, axis] += step * limit
    paths, _ = swarm.paths(plan.duration, field)
    nominal = swarm.position + np.cumsum(swarm.velocity * paths[..., 0], axis=0)
    factor, drift = swarm.surroundings(plan.duration, plan.field, nominal)
    moved = (swarm.velocity * factor)[..., None] * paths
    carried = (drift * plan.duration[:, None])[..., None]
    position = swarm.position[:, None] + np.cumsum(moved + carried, axis=0)
    return Rollout(position[..., 0], (position[..., 1:] - position[..., :1]) / step)
