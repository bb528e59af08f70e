"""Second stage: from particles and the field to speed, offset angle and force of each."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from functools import cache

import numpy as np

from microbot_ros.common.records import Conditions
from microbot_ros.common.settings import setting
from microbot_ros.estimation.online.commands import SET_BACK
from microbot_ros.estimation.online.estimator import Estimates, Estimator, Settings
from microbot_ros.loop.points import ESTIMATE, numbers

_EARLY = 256
"""Choice: commands kept until the first frame; older ones are dropped."""


@dataclass(frozen=True)
class ModelParameters:
    """Parameters of the model."""

    propulsion: str = setting(
        'catalytic', 'Propulsion of the particles.', choices=('catalytic', 'rolling'),
        read_only=True)
    radius_um: float = setting(2.3, 'Radius of the particles.', lower=0.05, upper=1000.0,
                               read_only=True)
    viscosity_mPa_s: float = setting(1.0, 'Viscosity of the fluid.', lower=0.05, upper=1e5,
                                     read_only=True)
    temperature_K: float = setting(298.0, 'Temperature of the fluid.', lower=250.0, upper=400.0,
                                   read_only=True)
    height_um: float = setting(
        0.0, 'Height of the particle centres above the floor, more than radius_um; 0 if far from '
             'any floor, or unknown.', lower=0.0, upper=1e5, read_only=True)
    reference_field_mT: float = setting(5.0, 'Field strength at which alignment times are stated.',
                                        lower=1e-3, upper=1000.0, read_only=True)
    exposure_ms: float = setting(0.0, 'Exposure time of a frame.', lower=0.0, upper=1000.0,
                                 read_only=True)
    horizon_s: float = setting(0.5, 'Prediction horizon.', lower=0.0, upper=60.0,
                               read_only=True)
    model_file: str = setting(
        '', 'File model.yaml with the effects of the filter; empty: the first-order model. A file '
        'that cannot be used is refused and the present model kept.')


class ModelStage:
    """Filter that estimates the state of every particle after each frame.

    It starts with the first-order model of `parameters`; `use` loads a model file.

    Parameters
    ----------
    parameters : ModelParameters
        Parameters of the filter.
    """

    def __init__(self, parameters: ModelParameters) -> None:
        _warm_up()
        self.estimator = _estimator(parameters)
        self._first_order = self.estimator.model
        self._model_file = ''
        self._origin: float | None = None
        self._newest = -math.inf
        self._early: deque[tuple[float, np.ndarray, float | None]] = deque(maxlen=_EARLY)
        self.estimates: Estimates | None = None
        """Estimates after the last frame."""

    def use(self, model_file: str) -> None:
        """Filter with `model_file` from the next frame on; '' is the first-order model.

        Raises InputError for a file that cannot be used, and the present model stays.

        Parameters
        ----------
        model_file : str
            Path of the file, or ''.
        """
        if model_file == self._model_file:
            return
        if model_file:
            self.estimator.load(model_file)
        else:
            self.estimator.use(self._first_order)
        self._model_file = model_file

    def field(self, t: float, field: np.ndarray) -> None:
        """Take a `field` (2,) [T] that acts from `t` [s] on.

        Parameters
        ----------
        t : float
            Time [s].
        field : ndarray, shape (2,)
            Field [T].
        """
        self._command(t, field, None)

    def rotation(self, t: float, angular_velocity: np.ndarray) -> None:
        """Let rollers move along ω̂ × ẑ from `t` [s], `angular_velocity` (2,) [rad/s].

        Parameters
        ----------
        t : float
            Time [s].
        angular_velocity : ndarray, shape (2,)
            Angular velocity [rad/s].
        """
        x, y = angular_velocity
        rate = math.hypot(x, y)
        self._command(t, np.array([y, -x]) / (rate or 1.0), rate / math.tau)

    def step(self, particles: np.ndarray, t: float) -> np.ndarray:
        """Return the estimates (N,) of type ESTIMATE after a frame exposed at `t` [s].

        `particles` are those seen in it, of type PARTICLE.

        Parameters
        ----------
        particles : ndarray, shape (N,)
            PARTICLE of each particle.
        t : float
            Exposure of the frame [s].

        Returns
        -------
        ndarray, shape (N,)
            ESTIMATE of each particle.
        """
        rows = numbers(particles)
        self.estimates = found = self.estimator.update(
            self._exposed(t), particles['id'].astype(int), rows[:2].T.copy(), rows[5])
        seen = dict(zip(particles['id'].tolist(), rows[2].tolist(), strict=True))
        return _points(found, [seen.get(name, math.nan) for name in found.id.tolist()])

    def _command(self, t: float, field: np.ndarray, frequency: float | None) -> None:
        self._early.append((t, field, frequency))
        if self._origin is not None:
            self._take_commands(self._origin)

    def _exposed(self, t: float) -> float:
        """Return seconds since the first frame.

        Effects such as fuel decay count from the start, and anew where the clock was set back.
        """
        if self._origin is None or t < self._newest - SET_BACK:
            self._origin = t
            self._take_commands(t)
        self._newest = t
        return t - self._origin

    def _take_commands(self, origin: float) -> None:
        while self._early:
            t, field, frequency = self._early.popleft()
            self.estimator.command(t - origin, field, frequency)


def _estimator(values: ModelParameters) -> Estimator:
    return Estimator(
        Conditions(
            propulsion=values.propulsion, radius=values.radius_um * 1e-6,
            viscosity=values.viscosity_mPa_s * 1e-3, temperature=values.temperature_K,
            reference_field=values.reference_field_mT * 1e-3,
            height=values.height_um * 1e-6 or None),
        Settings(horizon=values.horizon_s, exposure=values.exposure_ms * 1e-3))


@cache
def _warm_up() -> None:
    """Compile the code that the first frames would otherwise wait for."""
    estimator = _estimator(ModelParameters())
    for frame in range(200):
        t = frame / 50
        if frame % 25 == 0:
            estimator.command(t, 1e-3 * np.array([np.cos(frame), np.sin(frame)]), 1.0)
        estimator.update(t, np.arange(2), np.full((2, 2), 1e-6 * t), np.full(2, 1e-7))


def _points(estimates: Estimates, theta: list[float]) -> np.ndarray:
    std, found = estimates.position_std, estimates
    rows = np.empty((len(theta), ESTIMATE.itemsize // 4), '<f4')
    rows[:, 1:] = np.array([
        *found.position.T, found.speed, found.phi, found.force, std, std, found.speed_std,
        found.phi_std, found.force_std, *found.prediction.T, found.prediction_std, theta]).T
    points = rows.view(ESTIMATE)[:, 0]
    points['id'] = found.id
    return points
