"""What a rig says of itself, the newest of each, as the cockpit's page is to have it."""

from __future__ import annotations

import json
import math
import re
import time
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import TwistStamped, Vector3Stamped
from nav_msgs.msg import Path
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from sensor_msgs.msg import (
    CameraInfo,
    CompressedImage,
    JointState,
    MagneticField,
    PointCloud2,
    TimeReference,
)
from std_msgs.msg import Bool, String

from microbot_ros.cockpit.rig import ParticleListener, PictureListener, zero_in
from microbot_ros.loop.points import GOAL, PARTICLE, PLACE
from microbot_ros.nodes.base import messages
from microbot_ros.nodes.base.lifecycle import LATCHED, RigNode
from microbot_ros.session.replay.log import header_stamp_ns
from microbot_ros.tracking import ImageToWorkspace

_NEWEST = QoSProfile(depth=1, reliability=QoSReliabilityPolicy.BEST_EFFORT)
_OFTEN: dict[str, type] = {
    'model/state': PointCloud2, 'field/command': Vector3Stamped, 'field/rotating': TwistStamped,
    'field/applied': MagneticField,
    'field/measured': MagneticField, 'coils/applied': JointState, 'coils/measured': JointState,
    'coil_driver/latency': TimeReference}
"""What is said many times a second: kept as it came, and read when a state is made of it."""

_SILENCE_S = 3.0
"""A node says how it is once a second; one that is silent for so long is not there."""
_FRESH_S = 1.0
"""What is said often counts for so long."""
_PICTURE_S = 0.5
"""Without a picture for so long, particles are shown by themselves."""
_PERIOD_S = 1 / 30
_KEPT = 64
"""Frames whose particles are waited for."""

_UNKNOWN = re.compile(r'particles? ([\d, ]+): ([^;]*), so v and φ are not known')
_KIND = np.dtype([('kind', '<u4')])
_LEVELS = {b'\0': 'ok', b'\1': 'warn', b'\2': 'error', b'\3': 'stale'}


class RigView:
    """Listens by a `node` to all that its rig tells; makes the page's state of it.

    What is told often is listened to only while somebody looks. Subscriptions come and go in the
    executor's thread, `attend`; a state is made in any.
    """

    def __init__(self, node: RigNode) -> None:
        self._node = node
        self._wanted = False
        self._picture: PictureListener = _nobody
        self._particles: ParticleListener = _nobody
        self._looking: list[Subscription] = []
        self._raw: dict[str, tuple[float, bytes]] = {}
        self._health: dict[str, tuple[float, DiagnosticStatus, dict[str, str]]] = {}
        self._armed: tuple[float, bool] | None = None
        self._progress: tuple[float, dict[str, str]] = (-math.inf, {})
        self._available: list[dict[str, str]] = []
        self._taken_goals: list[dict[str, Any]] = []
        self._taken_path: list[list[float | None]] = []
        self._verdict: dict[str, Any] = {}
        self._size: tuple[int, int] | None = None
        self._asking_size: Subscription | None = None
        self._camera: ImageToWorkspace | None = None
        self._seen: deque[tuple[int, bytes]] = deque(maxlen=_KEPT)
        self._shown: deque[int] = deque(maxlen=_KEPT)
        self._picture_s, self._picture_stamp = -math.inf, 0
        self._told_s = -math.inf
        self.kinds: list[str] = []
        """The names of the kinds that the tracker was taught, by their numbers."""
        self._listen()

    # In the executor's thread ---------------------------------------------------------------

    def _listen(self) -> None:
        node = self._node
        node.subscribe(DiagnosticArray, '/diagnostics', self._on_diagnostics,
                       QoSProfile(depth=50))
        node.subscribe(Bool, 'coil_driver/armed', self._on_armed, LATCHED)
        node.subscribe(DiagnosticStatus, 'controller/progress', self._on_progress)
        node.subscribe(String, 'controller/controllers', self._on_controllers, LATCHED)
        node.subscribe(String, 'discovery/verdict', self._on_verdict, LATCHED)
        node.subscribe(String, 'tracker/kinds', self._on_kinds, LATCHED)
        node.subscribe(PointCloud2, 'controller/goals', self._on_goals, LATCHED)
        node.subscribe(Path, 'controller/path', self._on_path, LATCHED)

    def watch(self, picture: PictureListener, particles: ParticleListener) -> None:
        """From now on tell each `picture`, and the `particles` in it."""
        self._picture, self._particles = picture, particles

    def look(self, wanted: bool) -> None:
        """Whether anybody looks, if it is `wanted`; from any thread."""
        self._wanted = wanted

    def update_subscriptions(self) -> None:
        """Listen to what is told often if somebody looks, and not if nobody does."""
        if self._wanted and not self._looking:
            create = self._node.create_subscription
            self._looking = [
                create(CompressedImage, 'camera/preview', self._on_preview, _NEWEST),
                create(PointCloud2, 'particles', self._on_particles, _NEWEST, raw=True),
                *(create(kind, topic, self._keeper(topic), _NEWEST, raw=True)
                  for topic, kind in _OFTEN.items())]
        elif not self._wanted and self._looking:
            self.close()
        self._ask_size()

    def close(self) -> None:
        """Listen to nothing that is told often."""
        for subscription in self._looking:
            self._node.destroy_subscription(subscription)
        self._looking = []

    def _ask_size(self) -> None:
        """Hear how large the full picture is, once: a camera says it with every frame."""
        if self._size is None and self._looking and self._asking_size is None:
            self._asking_size = self._node.create_subscription(
                CameraInfo, 'camera/camera_info', self._on_camera_info, _NEWEST)
        elif self._asking_size is not None and (self._size is not None or not self._looking):
            self._node.destroy_subscription(self._asking_size)
            self._asking_size = None

    def _keeper(self, topic: str) -> Callable[[bytes], None]:
        def keep(data: bytes) -> None:
            self._raw[topic] = time.monotonic(), data
        return keep

    def _on_camera_info(self, message: CameraInfo) -> None:
        region = message.roi
        self._size = (region.width or message.width, region.height or message.height)

    def _on_preview(self, message: CompressedImage) -> None:
        now = time.monotonic()
        if now - self._picture_s > _SILENCE_S:
            self._size = self._camera = None  # perhaps another camera
        stamp = messages.to_nanoseconds(message.header.stamp)
        self._picture_s, self._picture_stamp = now, stamp
        self._picture(stamp, message.data.tobytes())
        for seen, data in self._seen:
            if seen == stamp:
                self._tell_particles(stamp, data)
                return
        self._shown.append(stamp)

    def _on_particles(self, data: bytes) -> None:
        stamp, now = header_stamp_ns(data), time.monotonic()
        alone = now - self._picture_s > _PICTURE_S and now - self._told_s >= _PERIOD_S
        if alone or stamp in self._shown:
            self._tell_particles(stamp, data)
        else:
            self._seen.append((stamp, data))

    def _tell_particles(self, stamp: int, data: bytes) -> None:
        message = deserialize_message(data, PointCloud2)
        try:
            points = messages.points(message, PARTICLE)
            kinds = self._kinds_of(message)
        except messages.MessageError as error:
            self._node.complain(str(error))
            return
        self._told_s = time.monotonic()
        self._particles(particles_message(stamp, points, kinds, self._camera))

    def _kinds_of(self, message: PointCloud2) -> list[str | None]:
        """The kind of each particle, where the tracker tells kinds apart and has named it."""
        if all(field.name != 'kind' for field in message.fields):
            return [None] * (message.width * message.height)
        numbers = messages.points(message, _KIND)['kind'].tolist()
        return [self.kinds[number] if number < len(self.kinds) else None for number in numbers]

    def _on_kinds(self, message: String) -> None:
        kinds = _json_in(message.data, 'tracker/kinds')
        if not (isinstance(kinds, list) and all(isinstance(kind, str) for kind in kinds)):
            raise messages.MessageError('tracker/kinds: expected a list of names')
        self.kinds = kinds

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        here = self._node.get_namespace()
        for status in message.status:
            place, _, name = f'/{status.name.split(":")[0]}'.rpartition('/')
            if (place or '/') == here and name != self._node.get_name():
                values = {pair.key: pair.value for pair in status.values}
                self._health[name] = time.monotonic(), status, values

    def _on_armed(self, message: Bool) -> None:
        self._armed = time.monotonic(), message.data

    def _on_progress(self, message: DiagnosticStatus) -> None:
        values = {pair.key: pair.value for pair in message.values}
        self._progress = time.monotonic(), {**values, 'sentence': message.message}

    def _on_controllers(self, message: String) -> None:
        summaries = _json_in(message.data, 'controller/controllers')
        if not isinstance(summaries, dict):
            raise messages.MessageError('controller/controllers: expected a summary by name')
        self._available = [{'name': str(name), 'summary': str(summary)}
                           for name, summary in summaries.items()]

    def _on_verdict(self, message: String) -> None:
        found = _json_in(message.data, 'discovery/verdict')
        self._verdict = found if isinstance(found, dict) else {}

    def _on_goals(self, message: PointCloud2) -> None:
        named = any(field.name == 'id' for field in message.fields)
        self._taken_goals = [
            {'x_um': _finite(1e6 * goal['x']), 'y_um': _finite(1e6 * goal['y']),
             'id': int(goal['id']) if named else None}
            for goal in messages.points(message, GOAL if named else PLACE)]

    def _on_path(self, message: Path) -> None:
        self._taken_path = [[_finite(1e6 * p.pose.position.x), _finite(1e6 * p.pose.position.y)]
                      for p in message.poses]

    # In any thread --------------------------------------------------------------------------

    def use_calibration(self, tracker: Mapping[str, Any]) -> None:
        """Know from the parameters of the `tracker` how large a pixel is, and how it lies."""
        if self._size is None:
            return
        self._camera = ImageToWorkspace.of_tracker(tracker, *self._size)

    @property
    def calibrated(self) -> bool:
        """Whether there is nothing to ask the tracker for."""
        return self._camera is not None or self._size is None

    def camera(self) -> dict[str, Any] | None:
        """Size of the full picture and of a pixel, and how it lies: the rows a, b, c of `to_um`
        give a x + b y + c [µm] of the pixel x, y. None until all are known.
        """
        known = self._camera
        if known is None:
            return None
        return {'width_px': known.width, 'height_px': known.height,
                'pixel_size_um': round(known.pixel_size * 1e6, 9), 'to_um': _to_um(known)}

    def progress(self, what: str) -> str:
        """What the controller said last under the name `what`; '' where it is silent."""
        heard_s, values = self._progress
        return values.get(what, '') if time.monotonic() - heard_s <= _SILENCE_S else ''

    def goals(self) -> list[dict[str, Any]]:
        """The goals that the controller has, whoever sent them."""
        return self._taken_goals

    def state(self) -> dict[str, Any]:
        """All but the parameters: a part by its name; None for what is not known."""
        rig, sentence, age = self._rig()
        return {
            'rig': rig, 'sentence': sentence, 'zero': self._zero(rig),
            'link': {'age_ms': _finite(1e3 * age)},
            'latency_ms': self._latency_ms(), 'picture_age_ms': self._picture_age_ms(),
            'recording': self.recording(), 'field': self._field(),
            'estimates': self._estimates(), 'currents_a': self._currents(),
            'health': self._nodes(), 'verdict': self._verdict}

    def controller(self) -> dict[str, Any] | None:
        """Who drives, and where to; None where nobody says so."""
        name = self.progress('controller')
        if not name:
            return None
        return {'name': name, 'sentence': self.progress('sentence'),
                'driven': [int(one) for one in self.progress('particles').split(', ') if one],
                'goal': int(self.progress('goal')) if self.progress('goal') else None,
                'distance_um': _number(self.progress('distance_um') or math.nan),
                'done': self.progress('done') == 'True',
                'takes': self.progress('takes').split(', '),
                'available': self._available, 'goals': self._taken_goals, 'path': self._taken_path}

    @property
    def armed(self) -> bool:
        """Whether the coil driver says that currents may flow."""
        return self._rig()[0] == 'armed'

    def _rig(self) -> tuple[str, str, float]:
        """armed, disarmed, fault or unknown; in a sentence; the age of what is known [s]."""
        told_s, status, values = self._health.get(
            'coil_driver', (-math.inf, DiagnosticStatus(), {}))
        changed_s, armed = self._armed or (-math.inf, values.get('armed') == 'True')
        heard_s = max(told_s, changed_s, self._raw.get('coils/measured', (-math.inf,))[0])
        age = time.monotonic() - heard_s
        if not age <= _SILENCE_S:
            return 'unknown', 'the coil driver reports nothing', age
        if changed_s > told_s:
            return ('armed', 'armed', age) if armed else ('disarmed', 'disarmed', age)
        if status.level == b'\2':
            return 'fault', status.message, age
        return 'armed' if armed else 'disarmed', status.message, age

    def _zero(self, rig: str) -> str | None:
        """What the driver knows of a zero: 'confirmed', 'sent' or 'unreachable'; None while the
        `rig` is armed or the driver is silent."""
        told_s, _, values = self._health.get('coil_driver', (-math.inf, None, {}))
        fresh = time.monotonic() - told_s <= _SILENCE_S
        return zero_in(values.get('zero', '')) if fresh and rig != 'armed' else None

    def _read(self, topic: str) -> Any:
        """What was said last on a topic, if that is still true; else None."""
        heard_s, data = self._raw.get(topic, (-math.inf, b''))
        if not time.monotonic() - heard_s <= _FRESH_S:
            return None
        return deserialize_message(data, _OFTEN[topic])

    def _latency_ms(self) -> float | None:
        message = self._read('coil_driver/latency')
        if message is None:
            return None
        return _finite(1e3 * (messages.to_seconds(message.header.stamp)
                              - messages.to_seconds(message.time_ref)))

    def _picture_age_ms(self) -> float | None:
        if not self._picture_stamp:
            return None
        return _finite(1e3 * (self._node.seconds() - 1e-9 * self._picture_stamp))

    def recording(self) -> dict[str, Any] | None:
        """Whether it records, for how long [s], of what, and what was lost; None without a
        recorder."""
        told_s, _, values = self._health.get('recorder', (-math.inf, None, {}))
        if not time.monotonic() - told_s <= _SILENCE_S:
            return None
        return {'on': 'messages' in values, 'seconds': _number(values.get('recording_s', 0.0)),
                'lost': int(_number(values.get('dropped', 0)) or 0),
                'title': values.get('title', '')}

    def _field(self) -> dict[str, Any] | None:
        applied, measured = (self._read(topic) for topic in ('field/applied', 'field/measured'))
        newest = max(('field/command', 'field/rotating'),
                     key=lambda topic: self._raw.get(topic, (-math.inf, b''))[0])
        wanted = self._read(newest)
        if wanted is not None:
            wanted = wanted.twist.linear if newest == 'field/rotating' else wanted.vector
        if wanted is None and applied is None and measured is None:
            return None
        return {'wanted_mT': _millitesla(wanted),
                'applied_mT': _millitesla(applied and applied.magnetic_field),
                'measured_mT': _millitesla(measured and measured.magnetic_field)}

    def _currents(self) -> list[float | None] | None:
        message = self._read('coils/measured') or self._read('coils/applied')
        return None if message is None else [_finite(value) for value in message.effort]

    def _estimates(self) -> list[dict[str, Any]] | None:
        message = self._read('model/state')
        if message is None:
            return None
        try:
            points = messages.estimates(message)
        except messages.MessageError:
            return None
        _, status, values = self._health.get('model', (0.0, DiagnosticStatus(), {}))
        reasons = _reasons(status.message)
        diffusion, std = (_number(values.get(name, math.nan))
                          for name in ('diffusion_um2_s', 'diffusion_std_um2_s'))
        return [{
            'id': int(p['id']), 'v_um_s': _finite(1e6 * p['speed']),
            'v_std_um_s': _finite(1e6 * p['speed_std']), 'phi_deg': _finite(np.degrees(p['phi'])),
            'phi_std_deg': _finite(np.degrees(p['phi_std'])), 'd_um2_s': diffusion,
            'd_std_um2_s': std, 'force_pn': _finite(1e12 * p['force']),
            'force_std_pn': _finite(1e12 * p['force_std']),
            'reason': reasons.get(int(p['id']))} for p in points]

    def _nodes(self) -> list[dict[str, str]]:
        """How each node is, those that have gone silent too."""
        now, found = time.monotonic(), []
        for name, (told_s, status, _) in sorted(self._health.items()):
            silent = now - told_s > _SILENCE_S
            level = 'stale' if silent else _LEVELS.get(status.level, 'error')
            said = f'no message for {now - told_s:.0f} s' if silent else status.message
            found.append({'name': name, 'level': level, 'sentence': said})
        return found


def particles_message(stamp: int, points: np.ndarray, kinds: list[str | None],
                      camera: ImageToWorkspace | None) -> dict[str, Any]:
    """`points` (N,) of type PARTICLE, of `kinds` (N,), in the picture of a `stamp` [ns] for the
    page; without a `camera` not in pixels."""
    xy = np.stack([points['x'], points['y']], axis=1).astype(float)
    pixels = np.full_like(xy, np.nan) if camera is None else camera.pixels(xy)
    size = camera.pixel_size if camera else math.nan
    return {'kind': 'particles', 'stamp': str(stamp), 'particles': [
        {'id': int(point['id']), 'kind': kind, 'x_px': _finite(x), 'y_px': _finite(y),
         'x_um': _finite(1e6 * point['x']), 'y_um': _finite(1e6 * point['y']),
         'heading_rad': _finite(point['theta']), 'sigma_px': _finite(point['sigma'] / size)}
        for point, (x, y), kind in zip(points, pixels.tolist(), kinds, strict=True)]}


def _reasons(sentence: str) -> dict[int, str]:
    """Why nothing is known of a particle, by its number, from what the model says."""
    return {int(name): reason for names, reason in _UNKNOWN.findall(sentence)
            for name in names.split(', ')}


def _json_in(text: str, topic: str) -> Any:
    """What a `text` of a `topic` holds; MessageError where it is no JSON."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        raise messages.MessageError(f'{topic}: expected JSON') from None


def _millitesla(vector: Any) -> list[float | None] | None:
    return None if vector is None else [_finite(1e3 * vector.x), _finite(1e3 * vector.y)]


def _to_um(camera: ImageToWorkspace) -> list[list[float]]:
    """The affine map of pixels to µm (2, 3)."""
    origin, right, down = 1e6 * camera.position(np.array([[0, 0], [1, 0], [0, 1]]))
    return np.column_stack([right - origin, down - origin, origin]).round(9).tolist()


def _finite(value: Any) -> float | None:
    """As JSON has it, in six digits: what is no number is None."""
    number = float(value)
    return float(f'{number:.6g}') if math.isfinite(number) else None


def _number(value: Any) -> float | None:
    try:
        return _finite(value)
    except ValueError:
        return None


def _nobody(*_: object) -> None:
    """Nobody listens yet."""
