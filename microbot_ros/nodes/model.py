"""Node `model`: speed, offset angle and force of every particle, while it happens."""

from __future__ import annotations

import math
import time
from collections import deque
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Vector3Stamped
from sensor_msgs.msg import MagneticField, PointCloud2
from std_msgs.msg import Header

from microbot_ros.errors import InputError
from microbot_ros.estimation.online import Estimates, Estimator, Settings
from microbot_ros.model.model_file import read_model
from microbot_ros.nodes import messages
from microbot_ros.nodes.lifecycle import OK, SILENCE_SECONDS, WARN, RigNode
from microbot_ros.records import Conditions
from microbot_ros.settings import setting


@dataclass(frozen=True)
class ModelParameters:
    """Parameters of the node `model`."""

    propulsion: str = setting(
        'catalytic', 'What drives the particles.', choices=('catalytic', 'rolling'),
        read_only=True)
    radius_um: float = setting(2.3, 'Radius of the particles.', lower=0.05, upper=1000.0,
                               read_only=True)
    viscosity_mPa_s: float = setting(1.0, 'Viscosity of the fluid.', lower=0.05, upper=1e5,
                                     read_only=True)
    temperature_K: float = setting(298.0, 'Temperature of the fluid.', lower=250.0, upper=400.0,
                                   read_only=True)
    reference_field_mT: float = setting(5.0, 'Field at which alignment times are stated.',
                                        lower=1e-3, upper=1000.0, read_only=True)
    exposure_ms: float = setting(0.0, 'Exposure time of a frame.', lower=0.0, upper=1000.0,
                                 read_only=True)
    horizon_s: float = setting(0.5, 'How far ahead to predict.', lower=0.0, upper=60.0,
                               read_only=True)
    field_source: str = setting(
        'applied', 'What the particles felt: the field read back from the coils, or the one '
        'commanded where nothing is read back.', choices=('applied', 'command'), read_only=True,
        formerly='command_source')
    model_file: str = setting(
        '', 'model.yaml with the effects to filter with; empty is the first-order model. A file '
        'that cannot be used is refused and the present model kept.')


class ModelNode(RigNode):
    """`particles` and the field → `model/state`."""

    Parameters: ClassVar[type] = ModelParameters
    accounts_for = 'particles'

    def setup(self) -> None:
        values: ModelParameters = self.settings
        _warm_up(self._make_estimator())
        self._estimator = self._make_estimator()
        self._first_order = self._estimator.model
        self._model_file = ''
        self._origin: float | None = None
        self._early: deque[tuple[float, np.ndarray, float | None]] = deque(maxlen=256)
        self._estimates: Estimates | None = None
        self._came = -math.inf
        self._state = self.publisher(PointCloud2, 'model/state')
        self.subscribe(PointCloud2, 'particles', self._on_particles)
        if values.propulsion == 'rolling':
            self.subscribe(Vector3Stamped, 'field/rotation', self._on_rotation)
        elif values.field_source == 'applied':
            self.subscribe(MagneticField, 'field/applied', self._on_applied)
        else:
            self.subscribe(Vector3Stamped, 'field/command', self._on_command)

    def _make_estimator(self) -> Estimator:
        values: ModelParameters = self.settings
        return Estimator(
            Conditions(
                propulsion=values.propulsion, radius=values.radius_um * 1e-6,
                viscosity=values.viscosity_mPa_s * 1e-3, temperature=values.temperature_K,
                reference_field=values.reference_field_mT * 1e-3),
            Settings(horizon=values.horizon_s, exposure=values.exposure_ms * 1e-3))

    def veto(self, proposed: ModelParameters) -> str:
        if proposed.model_file:
            try:
                model, _ = read_model(proposed.model_file)
            except InputError as error:
                return str(error)
            if model.propulsion != proposed.propulsion:
                return f'{proposed.model_file} is of {model.propulsion} particles'
        return ''

    def health(self) -> tuple[bytes, str, dict[str, object]]:
        found = self._estimates
        if found is None:
            return WARN, 'no particles yet', {}
        noise, silence = found.noise, time.monotonic() - self._came
        values: dict[str, object] = {
            'particles': len(found.id), 'known': int(found.known.sum()),
            'delay_s': found.delay, 'delay_std_s': found.delay_std,
            'diffusion_um2_s': noise.diffusion * 1e12,
            'localisation_um': noise.localisation * 1e6,
            'silence_s': silence}
        if silence > SILENCE_SECONDS:
            return WARN, f'no particles for {silence:.0f} s', values
        if found.diagnosis:
            return WARN, '; '.join(found.diagnosis), values
        return OK, f'{int(found.known.sum())} of {len(found.id)} particles known', values

    def _on_applied(self, message: MagneticField) -> None:
        field = message.magnetic_field
        self._command(message.header, np.array([field.x, field.y]))

    def _on_command(self, message: Vector3Stamped) -> None:
        # Its stamp is the exposure it answers; what passes until the field turns is a delay, and
        # that is estimated.
        field = np.array([message.vector.x, message.vector.y])
        self._command(message.header, field)

    def _on_rotation(self, message: Vector3Stamped) -> None:
        """A field that turns with ω rolls particles along ω̂ × ẑ."""
        x, y = message.vector.x, message.vector.y
        rate = math.hypot(x, y)
        direction = np.array([y, -x]) / (rate or 1.0)
        self._command(message.header, direction, rate / math.tau)

    def _on_particles(self, message: PointCloud2) -> None:
        self._follow_model_file()
        found = messages.points(message, messages.PARTICLE)
        position = np.stack([found['x'], found['y']], axis=1).astype(float)
        self._estimates = estimates = self._estimator.update(
            self._exposed(message.header.stamp), found['id'].astype(int), position,
            found['sigma'].astype(float))
        self._came = time.monotonic()
        points = _points(estimates)
        points['theta'] = _headings(found, estimates.id)
        self._state.publish(messages.cloud(points, message.header.stamp))

    def _command(self, header: Header, field: np.ndarray, frequency: float | None = None) -> None:
        messages.in_workspace(header)
        self._early.append((messages.to_seconds(header.stamp), field, frequency))
        if self._origin is not None:
            self._take_commands(self._origin)

    def _exposed(self, stamp: Time) -> float:
        """Seconds since the first frame: effects such as fuel decay count from the start."""
        t = messages.to_seconds(stamp)
        if self._origin is None:
            self._origin = t
            self._take_commands(t)
        return t - self._origin

    def _take_commands(self, origin: float) -> None:
        while self._early:
            t, field, frequency = self._early.popleft()
            self._estimator.command(t - origin, field, frequency)

    def _follow_model_file(self) -> None:
        file = self.settings.model_file
        if file != self._model_file:
            if file:
                self._estimator.load(file)
            else:
                self._estimator.use(self._first_order)
            self._model_file = file


def _warm_up(estimator: Estimator) -> None:
    """Compile what the first frames would otherwise wait for."""
    for frame in range(200):
        t = frame / 50
        if frame % 25 == 0:
            estimator.command(t, 1e-3 * np.array([np.cos(frame), np.sin(frame)]), 1.0)
        estimator.update(t, np.arange(2), np.full((2, 2), 1e-6 * t), np.full(2, 1e-7))


def _headings(found: np.ndarray, ids: np.ndarray) -> np.ndarray:
    """The headings (N,) [rad] that particles of these ids have in a frame; NaN where not seen."""
    seen = dict(zip(found['id'].tolist(), found['theta'].tolist(), strict=True))
    return np.array([seen.get(name, math.nan) for name in ids.tolist()])


def _points(estimates: Estimates) -> np.ndarray:
    points = np.empty(len(estimates.id), messages.ESTIMATE)
    points['id'] = estimates.id
    points['x'], points['y'] = estimates.position.T
    points['x_std'] = points['y_std'] = estimates.position_std
    points['x_ahead'], points['y_ahead'] = estimates.prediction.T
    points['ahead_std'] = estimates.prediction_std
    columns: dict[str, Any] = {
        'speed': estimates.speed, 'phi': estimates.phi, 'force': estimates.force,
        'speed_std': estimates.speed_std, 'phi_std': estimates.phi_std,
        'force_std': estimates.force_std}
    for name, value in columns.items():
        points[name] = value
    return points
