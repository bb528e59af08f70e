"""Node `virtual_rig`: particles, fluid and microscope without a rig.

It receives the field from one place only: the log of the emulated amplifier, which holds the
currents that the bytes on the serial line requested.
"""

from __future__ import annotations

import json
import math
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, TextIO

import numpy as np
from sensor_msgs.msg import CameraInfo, Image, PointCloud2

from microbot_ros.common import units
from microbot_ros.common.errors import InputError
from microbot_ros.common.files import read_yaml
from microbot_ros.common.records import height_problem
from microbot_ros.common.settings import setting
from microbot_ros.magnetics.coils import CoilSet
from microbot_ros.magnetics.settings import CoilSettings
from microbot_ros.model.io.effect_table import write_effects
from microbot_ros.model.io.model_file import read_model
from microbot_ros.model.model import Model
from microbot_ros.model.physics.particle import Fluid, rolling_drag, rotational_drag
from microbot_ros.nodes.base import messages
from microbot_ros.nodes.base.lifecycle import IMAGES_OUT, OK, WARN, RigNode
from microbot_ros.nodes.base.preview import Preview
from microbot_ros.virtual_rig.body import bodies
from microbot_ros.virtual_rig.foreign_effects import make_world
from microbot_ros.virtual_rig.injected_effects import INJECTABLE, inject_effect
from microbot_ros.virtual_rig.microscope import Microscope, MicroscopeSettings
from microbot_ros.virtual_rig.record_session import in_picture
from microbot_ros.virtual_rig.rolling import Rolling
from microbot_ros.virtual_rig.world import FieldHistory, World

_REFERENCE_FIELD = 5e-3
"""Field [T] at which speeds and alignment are given: that of the paper, 5 mT."""
_LONGEST_DELAY = 2.0
"""Longest delay of the field [s] for which changes are kept: the bound of `command_delay`."""


@dataclass(frozen=True)
class VirtualRigParameters:
    """Parameters of the node `virtual_rig`. The defaults are three particles of the paper."""

    amplifier_log: str = setting(
        '', 'Log of the emulated amplifier (`microbot emulate ... --log`).', read_only=True)
    coils_file: str = setting(
        '', 'YAML file with the coils; empty takes the default rig.', read_only=True)
    seed: int = setting(1, 'Seed of all random numbers.', lower=0, upper=2**31 - 1, read_only=True)
    frame_rate_hz: float = setting(60.0, 'Frames per second.', lower=1.0, upper=200.0,
                                   read_only=True)
    radius_um: float = setting(2.3, 'Radius of every particle.', lower=0.1, upper=20.0,
                               read_only=True)
    height_um: float = setting(
        0.0, 'Height of the particle centres above the floor, more than radius_um; 0 if far from '
             'any.',
        lower=0.0, upper=1e5, read_only=True)
    viscosity_mPa_s: float = setting(1.245, 'Viscosity of the fluid.', lower=0.1, upper=1000.0,
                                     read_only=True)
    temperature_K: float = setting(298.0, 'Temperature of the fluid.', lower=270.0, upper=370.0,
                                   read_only=True)
    speeds_um_s: list[float] = setting(
        [3.71, 4.38, 4.98], 'Speed of each particle.', lower=0.0, upper=100.0, read_only=True)
    gains_um_s_hz: list[float] = setting(
        [], 'Speed per rotation frequency of each particle that rolls in a rotating field; empty: '
            'particles swim.', lower=0.0, upper=1000.0, read_only=True)
    phis_rad: list[float] = setting(
        [-1.09, 3.82, 2.64], 'Heading of each particle relative to the field.',
        lower=-7.0, upper=7.0, read_only=True)
    step_outs_hz: list[float] = setting(
        [], 'Frequency up to which each rolling particle follows a field of 5 mT; empty: computed '
            'from alignment_ms.', lower=0.0, upper=1000.0, read_only=True)
    walls_um: list[float] = setting(
        [], 'Straight walls: x, y of one end and x, y of the other end of each, in sequence.',
        lower=-10000.0, upper=10000.0, read_only=True)
    alignment_ms: float = setting(
        5.0, 'Time constant with which a field of 5 mT turns the particles.',
        lower=0.1, upper=10000.0, read_only=True)
    model_file: str = setting(
        '', 'model.yaml whose effects and learned terms the particles obey.', read_only=True)
    effect: str = setting('', 'Name of an effect hidden in the physics.', read_only=True)
    effect_parameters: list[str] = setting(
        [], 'Its parameters, such as wx_um_s=0.4.', read_only=True)


class VirtualRigNode(RigNode):
    """Node that publishes the topics of a camera and, to evaluate the other nodes, `~/truth`."""

    Parameters: ClassVar[type] = VirtualRigParameters

    def setup(self) -> None:
        values = self.settings
        coils = values.coils_file
        self._coils = CoilSet(read_yaml(coils, CoilSettings) if coils else None)
        self._log = _AmplifierLog(values.amplifier_log, self.get_name())
        self._microscope_settings = MicroscopeSettings(radius_um=values.radius_um)
        self._microscope = Microscope(self._microscope_settings, values.seed)
        self._world = self._make_world()
        self._microscope.render(self._world.position, self._world.heading, 0.0)  # compiles too
        # No current has flowed before.
        self._changes = deque([(-1e9, np.zeros(len(self._coils.names)))])
        self._rolling = self._make_rolling() if values.gains_um_s_hz else None
        self._frames = 0
        self._busy = self._longest = 0.0
        self._images = self.publisher(Image, 'camera/image_raw', IMAGES_OUT)
        self._info = self.publisher(CameraInfo, 'camera/camera_info', IMAGES_OUT)
        self._preview = Preview(self)
        self._truth = self.publisher(PointCloud2, '~/truth')
        self.every(1 / values.frame_rate_hz, self._expose)

    def start(self) -> None:
        self._begin = time.monotonic() - self._world.t

    def teardown(self) -> None:
        if hasattr(self, '_log'):
            self._log.close()
        if hasattr(self, '_preview'):
            self._preview.close()

    def veto(self, proposed: VirtualRigParameters) -> str:
        moved = proposed.gains_um_s_hz or proposed.speeds_um_s
        if len(moved) != len(proposed.phis_rad):
            return 'speeds_um_s, or gains_um_s_hz, and phis_rad must be equally many'
        if proposed.step_outs_hz and len(proposed.step_outs_hz) != len(proposed.gains_um_s_hz):
            return 'step_outs_hz must be as many as gains_um_s_hz, or none'
        if proposed.effect == 'drive_response' and not proposed.gains_um_s_hz:
            return 'the effect drive_response is of particles that roll: set gains_um_s_hz'
        if len(proposed.walls_um) % 4:
            return 'walls_um must be four numbers each'
        return height_problem(proposed.height_um, proposed.radius_um)

    def health(self) -> tuple[bytes, str, dict[str, object]]:
        share = self._busy * self.settings.frame_rate_hz / max(1, self._frames)
        longest, self._longest = self._longest, 0.0
        values = {'frames_published': self._frames, 'load_of_a_core': share,
                  'longest_frame_ms': longest * 1e3}
        if longest > 1 / self.settings.frame_rate_hz:
            return WARN, 'this machine is too slow for the frame rate', values
        return OK, f'{len(self._world.position)} particles under the microscope', values

    def _make_world(self) -> World:
        values = self.settings
        fluid, radius = self._fluid(), units.to_si('radius_um', values.radius_um)
        count = len(values.phis_rad)
        own = 'gain' if values.gains_um_s_hz else 'speed'
        moved = 1e-6 * np.array(values.gains_um_s_hz or values.speeds_um_s)
        rng = np.random.default_rng(values.seed)
        view = self._microscope_settings
        # Walls a diameter inside the picture, so that every particle stays in view.
        half = (view.width_px * view.pixel_size / 2 - 2 * radius,
                view.height_px * view.pixel_size / 2 - 2 * radius)
        made = bodies(
            fluid, np.full(count, radius),
            np.full(count, self._moment()),
            np.array(values.phis_rad), _spread(count, half, rng),
            heading=rng.uniform(-np.pi, np.pi, count), **{own: moved})
        given = _named(values.effect_parameters, self.get_name())
        model = self._model()
        effects = write_effects(model.effects) | ({values.effect: given} if values.effect else {})
        for effect, parameters in effects.items():
            if effect in INJECTABLE:
                inject_effect(made, effect, parameters, _REFERENCE_FIELD)
        world = make_world(made, rng, effects, _REFERENCE_FIELD, model.learned, half,
                           1e-6 * np.array(values.walls_um))
        # The first step compiles; it must not happen while frames are due.
        world.advance(1e-3, FieldHistory(np.zeros(1), np.zeros((1, count, 2))))
        return world

    def _fluid(self) -> Fluid:
        values = self.settings
        return Fluid(values.viscosity_mPa_s * 1e-3, values.temperature_K,
                     values.height_um * 1e-6 or None)

    def _moment(self) -> float:
        """Return the moment [A·m²] that gives the alignment time of the parameters."""
        values = self.settings
        drag = rotational_drag(self._fluid(), units.to_si('radius_um', values.radius_um))
        return float(drag / (values.alignment_ms * 1e-3 * _REFERENCE_FIELD))

    def _make_rolling(self) -> Rolling:
        """Make rollers that rotate about an axis along the floor, of equal moment unless given."""
        if step_outs := self.settings.step_outs_hz:
            return Rolling(math.tau * np.array(step_outs) / _REFERENCE_FIELD)
        radius = units.to_si('radius_um', self.settings.radius_um)
        return Rolling(float(self._moment() / rolling_drag(self._fluid(), radius)))

    def _model(self) -> Model:
        """Return the model that the particles obey, by default that of first order."""
        file = self.settings.model_file
        return read_model(file)[0] if file else Model(_REFERENCE_FIELD)

    def _expose(self) -> None:
        began = time.monotonic()
        stamp = self.get_clock().now().to_msg()
        self._advance(began)
        world = self._world
        image = messages.image(
            self._microscope.render(in_picture(world), world.heading, world.t), stamp)
        self._images.publish(image)
        self._preview.offer(image)
        if self._info.get_subscription_count():
            self._info.publish(
                CameraInfo(header=image.header, height=image.height, width=image.width))
        points = np.zeros(len(self._world.position), messages.TRUTH)
        points['id'] = np.arange(len(points))
        points['x'], points['y'] = self._world.position.T
        points['theta'] = self._world.heading
        points['speed'] = self._world.bodies['gain' if self._rolling else 'speed']
        points['phi'] = self._world.bodies['phi']
        self._truth.publish(messages.cloud(points, stamp))
        self._frames += 1
        spent = time.monotonic() - began
        self._busy += spent
        self._longest = max(self._longest, spent)

    def _advance(self, now: float) -> None:
        """Advance the world to `now` under the currents that flowed since the last frame."""
        changes = self._changes
        changes += [(t - self._begin, currents) for t, currents in self._log.read()]
        # A hidden delay refers to the past; the last change before it still holds.
        while len(changes) > 1 and changes[1][0] < self._world.t - _LONGEST_DELAY:
            changes.popleft()
        times, currents = map(np.array, zip(*changes, strict=True))
        currents = self._coils.effective(currents)
        until = now - self._begin
        if self._rolling is None:
            per_ampere = self._coils.field_per_ampere(self._world.position)[..., :2]
            history = FieldHistory(times, np.tensordot(currents, per_ampere, 1))
        else:
            field = self._coils.field_per_ampere(np.zeros((1, 3)))[:, 0]
            self._rolling.take(times, currents @ field, until)
            history = self._rolling.history(self._world.t - _LONGEST_DELAY)
        self._world.advance(until, history)


class _AmplifierLog:
    """Reader of the amplifier's log while it grows."""

    def __init__(self, path: str, node: str) -> None:
        if not path:
            raise InputError(node, 'expected the parameter amplifier_log: the log of the emulator')
        try:
            self._stream: TextIO = Path(path).open(encoding='utf-8')  # noqa: SIM115
        except OSError as error:
            raise InputError(path, f'expected the log of an emulated amplifier ({error.strerror})'
                             ) from None
        self._rest = ''

    def read(self) -> Iterator[tuple[float, np.ndarray]]:
        """Yield new changes: time [s, monotonic] and currents (N,) [A]."""
        *lines, self._rest = (self._rest + self._stream.read()).split('\n')
        for line in lines:
            entry = json.loads(line)
            yield float(entry['t_monotonic_s']), np.array(entry['currents_A'], float)

    def close(self) -> None:
        self._stream.close()


def _spread(count: int, half_extent: tuple[float, float], rng: np.random.Generator) -> np.ndarray:
    """Return places (count, 2) [m] on a jittered grid, separate from each other and the walls."""
    columns = math.ceil(math.sqrt(count * half_extent[0] / half_extent[1]))
    rows = math.ceil(count / columns)
    cells = [(c, r) for r in range(rows) for c in range(columns)][:count]
    grid = (np.array(cells) + 0.5) / (columns, rows) * 2 - 1
    jitter = rng.uniform(-0.15, 0.15, (count, 2)) / (columns, rows)
    places: np.ndarray = (grid * 0.9 + jitter) * half_extent
    return places


def _named(pairs: list[str], node: str) -> dict[str, float]:
    """Return `['wx_um_s=0.4']` as a dictionary; InputError for anything else."""
    try:
        return {name: float(value) for name, value in (pair.split('=') for pair in pairs)}
    except ValueError:
        raise InputError(node, f'effect_parameters: expected name=value; received {pairs}'
                         ) from None
