"""Estimates after every frame, and settings of the online estimator."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from microbot_ros.common.compiled import numba
from microbot_ros.common.records import Conditions
from microbot_ros.estimation.likelihood.noise import Noise
from microbot_ros.estimation.likelihood.phasor import polar
from microbot_ros.estimation.online.propagation import Step
from microbot_ros.estimation.online.shared import SharedKnowledge
from microbot_ros.model.physics.vectors import as_vectors

FASTEST = 20e-6
"""Largest plausible speed [m/s], or gain [m/s/Hz]: two standard deviations of the prior.

Choice: above reported catalytic swimmers; a larger value knows new particles later.
"""


@dataclass(frozen=True)
class Settings:
    """Settings of the estimator that a user may change, SI."""

    horizon: float = 0.5
    """Prediction horizon [s]. Choice: a usual reaction time of a controller."""
    forget_after: float = 5.0
    """Time [s] without a sighting after which a particle is dropped. Choice."""
    exposure: float = 0.0
    """Exposure of a frame [s]."""


@dataclass(frozen=True)
class Estimates:
    """Estimates after a frame, with one row per living particle, ordered by `id`; SI.

    Attributes
    ----------
    t : float
        Time of the frame [s].
    id : ndarray, shape (N,)
        Particles.
    seen : ndarray of bool, shape (N,)
        Whether the particle was seen in this frame.
    known : ndarray of bool, shape (N,)
        Whether the commands have determined v and φ.
    position, position_std : ndarray, shape (N, 2) and (N,)
        Position and standard deviation per axis [m].
    speed, speed_std : ndarray, shape (N,)
        Speed [m/s], or gain of rollers [m/s/Hz]. Speed, φ and force are those of now if the model
        has exhausted fuel or slip of φ; they are NaN if not `known`.
    phi, phi_std : ndarray, shape (N,)
        Angle of travel from the field [rad].
    force, force_std : ndarray, shape (N,)
        Force [N]; also NaN if radius or viscosity are unknown, and for rollers.
    prediction, prediction_std : ndarray, shape (N, 2) and (N,)
        Position `horizon` ahead under the present command, and standard deviation per axis [m].
    delay, delay_std : float
        Delay in use [s]; standard deviation NaN while undetermined.
    noise : Noise
        Learned D and σ.
    diagnosis : tuple of str
        Sentences on what makes numbers doubtful, and what to do.
    begun_anew : tuple of str
        Those on particles that were restarted in this frame because their predictions had failed.
    unknown_because : mapping of int to str
        Why v and φ of a particle are withheld, by its number: only of particles whose motion the
        field does not explain.
    """

    t: float
    id: np.ndarray
    seen: np.ndarray
    known: np.ndarray
    position: np.ndarray
    position_std: np.ndarray
    speed: np.ndarray
    speed_std: np.ndarray
    phi: np.ndarray
    phi_std: np.ndarray
    force: np.ndarray
    force_std: np.ndarray
    prediction: np.ndarray
    prediction_std: np.ndarray
    delay: float
    delay_std: float
    noise: Noise
    diagnosis: tuple[str, ...] = ()
    begun_anew: tuple[str, ...] = ()
    unknown_because: Mapping[int, str] = field(default_factory=dict)


@dataclass(frozen=True)
class State:
    """State of the filter for N living particles; SI.

    Attributes
    ----------
    t : float
        Time [s].
    ids : ndarray, shape (N,)
        Particles.
    seen : ndarray of bool, shape (N,)
        Whether the particle was seen in this frame.
    p, velocity_phasor : ndarray of complex, shape (N,)
        Position [m] and c = v e^{iφ}.
    p_var, phasor_var : ndarray, shape (N,)
        Their variances per axis.
    cross : ndarray of complex, shape (N,)
        Half the mean of p̃ c̃*.
    """

    t: float
    ids: np.ndarray
    seen: np.ndarray
    p: np.ndarray
    velocity_phasor: np.ndarray
    p_var: np.ndarray
    phasor_var: np.ndarray
    cross: np.ndarray


def answer(
    state: State, ahead: Step, shared: SharedKnowledge, conditions: Conditions,
    diagnosis: tuple[str, ...], begun_anew: tuple[str, ...], aging: complex,
    unknown_because: Mapping[int, str],
) -> Estimates:
    """Convert the state of the filter to speed, φ, force and a prediction.

    Parameters
    ----------
    state : State
        State of the filter.
    ahead : Step
        Step over the prediction horizon.
    shared : SharedKnowledge
        Noise and delay.
    conditions : Conditions
        Conditions of the rig.
    diagnosis : tuple of str
        Sentences on what makes numbers doubtful.
    begun_anew : tuple of str
        Sentences on restarted particles.
    aging : complex
        Factor by which the model has changed every v e^{iφ} since its start.
    unknown_because : mapping of int to str
        Why v and φ of a particle are withheld, by its number.

    Returns
    -------
    Estimates
        The estimates.
    """
    std = np.sqrt(state.phasor_var)
    speeds = polar(state.velocity_phasor * aging, std * abs(aging)).widened(
        shared.delay.felt(shared.log_phasor_slope))
    told = (speeds.speed, speeds.speed_std, speeds.phi, speeds.phi_std, *speeds.force(conditions))
    known, prediction, prediction_std = _look_ahead(
        std, *told, state.p, state.velocity_phasor, state.p_var, state.phasor_var, state.cross,
        ahead.path, ahead.drift, 2 * shared.noise.diffusion * ahead.span)
    speed, speed_std, phi, phi_std, force, force_std = told
    return Estimates(
        t=state.t, id=state.ids, seen=state.seen, known=known,
        position=as_vectors(state.p), position_std=np.sqrt(state.p_var),
        speed=speed, speed_std=speed_std, phi=phi, phi_std=phi_std,
        force=force, force_std=force_std,
        prediction=as_vectors(prediction), prediction_std=prediction_std,
        delay=shared.delay.value, delay_std=shared.delay.std, noise=shared.noise,
        diagnosis=diagnosis, begun_anew=begun_anew, unknown_because=unknown_because,
    )


@numba.njit(cache=True)
def _look_ahead(std, speed, speed_std, phi, phi_std, force, force_std, p, c, p_var, phasor_var,  # type: ignore[no-untyped-def]
                cross, path, drift, diffused):
    """Return what is known (N,), and predictions with their spread; make the rest NaN."""
    known, prediction, spread = np.empty(len(p), np.bool_), np.empty_like(p), np.empty(len(p))
    for n in range(len(p)):
        way, carried = path[min(n, len(path) - 1)], drift[min(n, len(drift) - 1)]
        known[n] = std[n] < FASTEST / 20
        if not known[n]:
            speed[n] = speed_std[n] = phi[n] = phi_std[n] = force[n] = force_std[n] = np.nan
        prediction[n] = p[n] + c[n] * way + carried
        spread[n] = math.sqrt(p_var[n] + 2 * (way * cross[n].conjugate()).real
                              + (way.real**2 + way.imag**2) * phasor_var[n] + diffused)
    return known, prediction, spread
