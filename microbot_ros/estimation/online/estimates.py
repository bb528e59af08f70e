"""What the online estimator answers after every frame, and what a user may set."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from microbot_ros.common.compiled import numba
from microbot_ros.common.records import Conditions
from microbot_ros.estimation.likelihood.noise import Noise
from microbot_ros.estimation.likelihood.phasor import polar
from microbot_ros.estimation.online.propagation import Step
from microbot_ros.estimation.online.shared import SharedKnowledge
from microbot_ros.model.physics.vectors import as_vectors

FASTEST = 20e-6
"""Largest plausible speed [m/s], or gain [m/s/Hz]: two standard deviations of the prior."""


@dataclass(frozen=True)
class Settings:
    """What a user may want different; SI."""

    horizon: float = 0.5
    """How far ahead to predict [s]."""
    forget_after: float = 5.0
    """Seconds without a sighting after which a particle is dropped."""
    exposure: float = 0.0
    """Exposure time of a frame [s]."""


@dataclass(frozen=True)
class Estimates:
    """What is known after a frame at `t` [s]; one row per living particle, ordered by `id`.

    SI; `position_std`, `prediction_std` per axis, `speed_std`, `phi_std`, `force_std` are
    standard deviations. `noise` is what was learned of D and σ. `seen`: in this frame. `speed`
    [m/s] (rollers: gain [m/s/Hz]), `phi` [rad] and `force` [N] are those of now where the model
    has fuel run out or φ slip; they are NaN, and `known` False, until the command has excited
    them enough. `force` is NaN where radius or viscosity are not known,
    and for rollers. `prediction` (N, 2) is the position `horizon` ahead under the present
    command. `delay` [s] is the one in use; `delay_std` NaN while undetermined. `diagnosis`:
    sentences on what makes numbers doubtful, and what to do; `begun_anew`: those on particles
    whose predictions had failed and that were begun anew in this very frame.
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


@dataclass(frozen=True)
class State:
    """The filter's state of the living particles at a time `t` [s]; arrays (N,), SI.

    `ids`; `seen` in this frame; `p` complex position, `velocity_phasor` v e^{iφ} = c, and their
    variances per axis `p_var`, `phasor_var`; `cross` is half the mean of p̃ c̃*.
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
) -> Estimates:
    """A filter's `state` in terms of speed, φ and force, and as after the step `ahead`.

    With what is `shared` by all, the `conditions` of the rig and the sentences of a
    `diagnosis` and on whom was `begun_anew`; `aging` is the factor by which the model has
    changed every v e^{iφ} since its start.
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
        diagnosis=diagnosis, begun_anew=begun_anew,
    )


@numba.njit(cache=True)
def _look_ahead(std, speed, speed_std, phi, phi_std, force, force_std, p, c, p_var, phasor_var,  # type: ignore[no-untyped-def]
                cross, path, drift, diffused):
    """What is known (N,), and where particles will be, with its spread; the rest is made NaN."""
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
