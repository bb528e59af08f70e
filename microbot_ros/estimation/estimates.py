"""What the online estimator answers after every frame, and what a user may set."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ros.estimation.noise import Noise
from microbot_ros.estimation.phasor import polar
from microbot_ros.estimation.propagation import Step
from microbot_ros.estimation.shared import SharedKnowledge
from microbot_ros.records import Conditions

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
    sentences on what makes numbers doubtful, and what to do.
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
    p_var: np.ndarray
    velocity_phasor: np.ndarray
    phasor_var: np.ndarray
    cross: np.ndarray


def answer(
    state: State, ahead: Step, shared: SharedKnowledge, conditions: Conditions,
    diagnosis: tuple[str, ...], aging: complex,
) -> Estimates:
    """A filter's `state` in terms of speed, φ and force, and as after the step `ahead`.

    With what is `shared` by all, the `conditions` of the rig and the sentences of a
    `diagnosis`; `aging` is the factor by which the model has changed every v e^{iφ}
    since its start.
    """
    std = np.sqrt(state.phasor_var)
    known = std < FASTEST / 20
    speeds = polar(state.velocity_phasor * aging, std * abs(aging)).widened(
        shared.log_phasor_slope, shared.delay.std)
    force, force_std = speeds.force(conditions)
    spread = (
        state.p_var + 2 * np.real(ahead.path * np.conj(state.cross))
        + np.abs(ahead.path) ** 2 * state.phasor_var + 2 * shared.noise.diffusion * ahead.span
    )

    def shown(value: np.ndarray) -> np.ndarray:
        return np.where(known, value, np.nan)

    return Estimates(
        t=state.t, id=state.ids, seen=state.seen, known=known,
        position=_vectors(state.p), position_std=np.sqrt(state.p_var),
        speed=shown(speeds.speed), speed_std=shown(speeds.speed_std),
        phi=shown(speeds.phi), phi_std=shown(speeds.phi_std),
        force=shown(force), force_std=shown(force_std),
        prediction=_vectors(state.p + state.velocity_phasor * ahead.path + ahead.drift),
        prediction_std=np.sqrt(spread),
        delay=shared.delay.value, delay_std=shared.delay.std, noise=shared.noise,
        diagnosis=diagnosis,
    )


def _vectors(z: np.ndarray) -> np.ndarray:
    return np.stack([z.real, z.imag], axis=-1)
