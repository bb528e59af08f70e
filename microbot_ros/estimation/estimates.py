"""What the online estimator answers after every frame, and what a user may set."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from microbot_ros.estimation.noise import Noise
from microbot_ros.estimation.phasor import polar
from microbot_ros.estimation.propagation import Step
from microbot_ros.estimation.shared import SharedKnowledge
from microbot_ros.records import Conditions


@dataclass(frozen=True)
class Settings:
    """What a user may want different; SI."""

    horizon: float = 0.5
    """How far ahead to predict [s]."""
    forget_after: float = 5.0
    """Seconds without a sighting after which a particle is dropped."""
    exposure: float = 0.0
    """Exposure time of a frame [s]."""
    fastest: float = 20e-6
    """Largest plausible speed [m/s], or gain [m/s/Hz]: two standard deviations of the prior."""
    change_interval: float = 3600.0
    """Mean seconds between abrupt changes of one particle's speed or direction."""
    wander: float = 1e-3
    """Relative random walk of speed and direction in one second."""
    viscosity_relative_std: float = 0.05
    radius_relative_std: float = 0.05


@dataclass(frozen=True)
class Estimates:
    """What is known after a frame; one row per living particle, ordered by identity.

    SI; `*_std` are standard deviations, of positions per axis. `seen`: in this frame. `speed`
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

    @property
    def ok(self) -> bool:
        """Whether nothing speaks against the numbers."""
        return not self.diagnosis


@dataclass(frozen=True)
class State:
    """The filter's state of the living particles at one moment; arrays (N,), SI, complex.

    Variances are per axis; `cross` is half the mean of p̃ c̃*.
    """

    t: float
    ids: np.ndarray
    seen: np.ndarray
    p: np.ndarray
    p_var: np.ndarray
    c: np.ndarray
    c_var: np.ndarray
    cross: np.ndarray


def answer(
    state: State, ahead: Step, shared: SharedKnowledge, conditions: Conditions,
    settings: Settings, diagnosis: tuple[str, ...], aging: complex = 1.0,
) -> Estimates:
    """The state in terms of speed, φ and force, and as it will be after the step `ahead`.

    `aging` is what time has made of every c.
    """
    std = np.sqrt(state.c_var)
    known = std < settings.fastest / 20
    swims = polar(state.c * aging, std * abs(aging)).widened(shared.turn, shared.delay.std)
    force, force_std = swims.force(
        conditions, np.hypot(settings.viscosity_relative_std, settings.radius_relative_std)
    )
    spread = (
        state.p_var + 2 * np.real(ahead.drive * np.conj(state.cross))
        + np.abs(ahead.drive) ** 2 * state.c_var + 2 * shared.noise.diffusion * ahead.span
    )

    def shown(value: np.ndarray) -> np.ndarray:
        return np.where(known, value, np.nan)

    return Estimates(
        t=state.t, id=state.ids, seen=state.seen, known=known,
        position=_vectors(state.p), position_std=np.sqrt(state.p_var),
        speed=shown(swims.speed), speed_std=shown(swims.speed_std),
        phi=shown(swims.phi), phi_std=shown(swims.phi_std),
        force=shown(force), force_std=shown(force_std),
        prediction=_vectors(state.p + state.c * ahead.drive + ahead.drift),
        prediction_std=np.sqrt(spread),
        delay=shared.delay.value, delay_std=shared.delay.std, noise=shared.noise,
        diagnosis=diagnosis,
    )


def _vectors(z: np.ndarray) -> np.ndarray:
    return np.stack([z.real, z.imag], axis=-1)
