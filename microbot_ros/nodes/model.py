"""Node `model`: speed, offset angle and force of every particle, online."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import ClassVar

from geometry_msgs.msg import Vector3Stamped
from sensor_msgs.msg import MagneticField, PointCloud2

from microbot_ros.common.errors import InputError
from microbot_ros.common.records import height_problem
from microbot_ros.common.settings import setting
from microbot_ros.loop.model import ModelParameters, ModelStage
from microbot_ros.loop.points import PARTICLE
from microbot_ros.model.io.model_file import read_model
from microbot_ros.nodes.base import messages
from microbot_ros.nodes.base.core import Core
from microbot_ros.nodes.base.felt_rotation import follow_rotation
from microbot_ros.nodes.base.lifecycle import OK, SILENCE_SECONDS, WARN, RigNode, in_one_line


@dataclass(frozen=True)
class ModelNodeParameters(ModelParameters):
    """Parameters of the node `model`."""

    field_source: str = setting(
        'applied', 'Source of the field: measured at the coils (applied), or '
                   'commanded where nothing is measured. Rollers use the '
                   'commanded rotation, with applied only while a field is '
                   'measured.', choices=('applied', 'command'), read_only=True)


class ModelCore(Core):
    """Core between `particles`, the field and `model/state`."""

    Parameters: ClassVar[type] = ModelNodeParameters
    frame = 'particles'

    def connect(self) -> None:
        values: ModelNodeParameters = self.settings
        self.stage = ModelStage(values)
        self._state = self.publisher(PointCloud2, 'model/state')
        self.subscribe(PointCloud2, 'particles', self._on_particles)
        if values.propulsion == 'rolling':
            follow_rotation(self, self.stage.rotation, values.field_source == 'applied')
        elif values.field_source == 'applied':
            self.subscribe(MagneticField, 'field/applied', self._on_applied)
        else:
            self.subscribe(Vector3Stamped, 'field/command', self._on_command)

    def _on_applied(self, message: MagneticField) -> None:
        self.stage.field(*messages.field_at(message))

    def _on_command(self, message: Vector3Stamped) -> None:
        # Its stamp is the exposure that it answers; the time until the field changes is a delay,
        # which is estimated.
        self.stage.field(*messages.vector_at(message))

    def _on_particles(self, message: PointCloud2) -> None:
        self.stage.use(self.settings.model_file)
        stamp = message.header.stamp
        estimates = self.stage.step(
            messages.points(message, PARTICLE), messages.to_seconds(stamp))
        self.known()
        self._state.publish(messages.cloud(estimates, stamp))

    def known(self) -> None:
        """Do nothing; called after each frame, before its estimates are published."""


class ModelNode(RigNode, ModelCore):
    """Node with a `ModelCore`."""

    def setup(self) -> None:
        self._came = -math.inf
        self.connect()

    def veto(self, proposed: ModelNodeParameters) -> str:
        if proposed.model_file:
            try:
                model, _ = read_model(proposed.model_file)
            except InputError as error:
                return str(error)
            if model.propulsion != proposed.propulsion:
                return f'{proposed.model_file} is of {model.propulsion} particles'
        return height_problem(proposed.height_um, proposed.radius_um)

    def health(self) -> tuple[bytes, str, dict[str, object]]:
        found = self.stage.estimates
        if found is None:
            return WARN, 'no particles yet', {}
        noise, silence = found.noise, time.monotonic() - self._came
        values: dict[str, object] = {
            'particles': len(found.id), 'known': int(found.known.sum()),
            'delay_s': found.delay, 'delay_std_s': found.delay_std,
            'diffusion_um2_s': noise.diffusion * 1e12,
            'diffusion_std_um2_s': noise.diffusion_std * 1e12,
            'localisation_um': noise.localisation * 1e6,
            'silence_s': silence,
            **{f'unknown_because_{name}': why for name, why in found.unknown_because.items()}}
        if silence > SILENCE_SECONDS:
            return WARN, f'no particles for {silence:.0f} s', values
        if found.diagnosis:
            return WARN, in_one_line(found.diagnosis), values
        return OK, f'{int(found.known.sum())} of {len(found.id)} particles known', values

    def known(self) -> None:
        self._came = time.monotonic()
        if self.stage.estimates and self.stage.estimates.begun_anew:
            self.get_logger().warning(
                in_one_line(self.stage.estimates.begun_anew), throttle_duration_sec=5.0)
