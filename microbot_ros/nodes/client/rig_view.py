"""Newest reports of a rig, as the cockpit's page shows them."""

from __future__ import annotations

import json
import math
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

from microbot_ros.cockpit.rig import ParticleListener, PictureListener, Rig, zero_in
from microbot_ros.loop.points import GOAL, PARTICLE, PLACE
from microbot_ros.nodes.base import messages
from microbot_ros.nodes.base.lifecycle import LATCHED, RigNode
from microbot_ros.session.replay.log import header_stamp_ns
from microbot_ros.tracking import ImageToWorkspace

_NEWEST = QoSProfile(depth=1, reliability=QoSReliabilityPolicy.BEST_EFFORT)
"""Receive the newest message only. Choice: a page has no use for older ones."""
_OFTEN: dict[str, type] = {
    'model/state': PointCloud2, 'field/command': Vector3Stamped, 'field/rotating': TwistStamped,
    'field/applied': MagneticField,
    'field/measured': MagneticField, 'coils/applied': JointState, 'coils/measured': JointState,
    'coil_driver/latency': TimeReference}
"""Topics with many messages a second: kept as received, and read when a state is made from
them."""

_SILENCE_S = 3.0
"""Time [s] of silence after which a node counts as missing. Choice: three reports at 1 Hz."""
_FRESH_S = 1.0
"""Time [s] for which a frequent message is valid. Choice: many periods; a page would show older
values as present."""
_PICTURE_S = 0.5
"""Time [s] without a picture after which particles are shown alone. Choice: several pictures at 30
Hz."""
_PERIOD_S = 1 / 30  # choice: the rate of the pictures
_KEPT = 64
"""Number of frames whose particles or picture are awaited. Choice: one second at 60 Hz."""

_KIND = np.dtype([('kind', '<u4')])
_LEVELS = {b'\0': 'ok', b'\1': 'warn', b'\2': 'error', b'\3': 'stale'}


class RigView(Rig):
    """Listener to all reports of a rig, which makes the page's state from them.

    Frequent topics are subscribed to only while a page is open. Subscriptions come and go in the
    executor's thread (`update_subscriptions`); a state is made in any thread.

    Parameters
    ----------
    node : RigNode
        Node of the cockpit.
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
        self._was_armed_s = -math.inf
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
        self._frames: tuple[float, dict[str, float | None] | None] = -math.inf, None
        self._picture_s, self._picture_stamp = -math.inf, 0
        self._told_s = -math.inf
        self.kinds: list[str] = []
        """Names of the kinds that the tracker was taught, by their numbers."""
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
        self._picture, self._particles = picture, particles

    def look(self, wanted: bool) -> None:
        self._wanted = wanted

    def update_subscriptions(self) -> None:
        """Subscribe to frequent topics if a page is open, and unsubscribe if none is."""
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
        """Unsubscribe from all frequent topics."""
        for subscription in self._looking:
            self._node.destroy_subscription(subscription)
        self._looking = []

    def _ask_size(self) -> None:
        """Receive the size of the full picture once: a camera publishes it with every frame."""
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
        """Return the kind of each particle, if the tracker distinguishes and names kinds."""
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
                self._count_frames(name, values)
                self._health[name] = time.monotonic(), status, values

    def _count_frames(self, name: str, values: Mapping[str, str]) -> None:
        """Derive the frame rate of a camera from two reports of it."""
        if 'frames_published' in values and name in self._health:
            now_s, (told_s, _, before) = time.monotonic(), self._health[name]
            last, first = (_number(one.get('frames_published', math.nan)) or 0.0
                           for one in (values, before))
            self._frames = now_s, {
                'rate_hz': _finite((last - first) / max(now_s - told_s, 1e-3)),
                'exposure_ms': _number(values.get('exposure_ms', math.nan))}

    def _on_armed(self, message: Bool) -> None:
        self._armed = time.monotonic(), message.data
        if message.data:
            self._was_armed_s = time.monotonic()

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
        """Derive size and orientation of a pixel from the parameters of the tracker.

        Parameters
        ----------
        tracker : mapping of str to object
            Parameters by name.
        """
        if self._size is None:
            return
        self._camera = ImageToWorkspace.of_tracker(tracker, *self._size)

    @property
    def calibrated(self) -> bool:
        """Whether there is nothing to ask the tracker for."""
        return self._camera is not None or self._size is None

    def camera(self) -> dict[str, Any] | None:
        known = self._camera
        if known is None:
            return None
        return {'width_px': known.width, 'height_px': known.height,
                'pixel_size_um': round(known.pixel_size * 1e6, 9), 'to_um': _to_um(known)}

    def progress(self, what: str) -> str:
        """Return a value of the controller's last report.

        Parameters
        ----------
        what : str
            Name of the value.

        Returns
        -------
        str
            '' if the controller is silent.
        """
        heard_s, values = self._progress
        return values.get(what, '') if time.monotonic() - heard_s <= _SILENCE_S else ''

    def goals(self) -> list[dict[str, Any]]:
        """Return the goals of the controller, from any sender.

        Returns
        -------
        list of dict of str to object
            One dictionary per goal.
        """
        return self._taken_goals

    def state(self) -> dict[str, Any]:
        rig, sentence, age = self._rig()
        return {
            'rig': rig, 'sentence': sentence, 'zero': self._zero(rig),
            'fault': self._fault() if rig == 'fault' else None,
            'link': {'age_ms': _finite(1e3 * age)},
            'latency_ms': self._latency_ms(), 'picture_age_ms': self._picture_age_ms(),
            'frames': self._frames[1] if time.monotonic() - self._frames[0] <= _SILENCE_S
            else None,
            'recording': self.recording(), 'field': self._field(),
            'estimates': self._estimates(), 'currents_a': self._currents(),
            'health': self._nodes(), 'verdict': self._verdict}

    def controller(self) -> dict[str, Any] | None:
        """Return the active controller and its goals.

        Returns
        -------
        dict of str to object or None
            None if the controller is silent.
        """
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
        """Whether the coil driver reports that currents may flow."""
        return self._rig()[0] == 'armed'

    def _rig(self) -> tuple[str, str, float]:
        """Return armed, disarmed, fault or unknown; a sentence; the age of the report [s]."""
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

    def _fault(self) -> dict[str, str] | None:
        """Return reason and detail of the fault of the gate, if there is one."""
        values = self._health['coil_driver'][2]
        reason = values.get('fault_reason')
        return {'reason': reason, 'detail': values.get('fault_detail', '')} if reason else None

    def _zero(self, rig: str) -> str | None:
        """Return the state of a zero: 'confirmed', 'sent' or 'unreachable'.

        None while the rig is armed or the driver is silent. A report from before the rig was last
        armed says nothing about the present zero.
        """
        told_s, _, values = self._health.get('coil_driver', (-math.inf, None, {}))
        fresh = time.monotonic() - told_s <= _SILENCE_S and told_s > self._was_armed_s
        return zero_in(values.get('zero', '')) if fresh and rig != 'armed' else None

    def _read(self, topic: str) -> Any:
        """Return the last message on a topic if it is still valid; else None."""
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
        """Return the state of the recorder.

        Returns
        -------
        dict of str to object or None
            Whether it records, for how long [s], its title, and how much was lost; None without a
            recorder.
        """
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
        _, _, values = self._health.get('model', (0.0, DiagnosticStatus(), {}))
        diffusion, std = (_number(values.get(name, math.nan))
                          for name in ('diffusion_um2_s', 'diffusion_std_um2_s'))
        return [{
            'id': int(p['id']), 'v_um_s': _finite(1e6 * p['speed']),
            'v_std_um_s': _finite(1e6 * p['speed_std']), 'phi_deg': _finite(np.degrees(p['phi'])),
            'phi_std_deg': _finite(np.degrees(p['phi_std'])), 'd_um2_s': diffusion,
            'd_std_um2_s': std, 'force_pn': _finite(1e12 * p['force']),
            'force_std_pn': _finite(1e12 * p['force_std']),
            'reason': values.get(f'unknown_because_{p["id"]}')} for p in points]

    def _nodes(self) -> list[dict[str, str]]:
        """Return the state of each node, including nodes that have gone silent."""
        now, found = time.monotonic(), []
        for name, (told_s, status, _) in sorted(self._health.items()):
            silent = now - told_s > _SILENCE_S
            level = 'stale' if silent else _LEVELS.get(status.level, 'error')
            said = f'no message for {now - told_s:.0f} s' if silent else status.message
            found.append({'name': name, 'level': level, 'sentence': said})
        return found


def particles_message(stamp: int, points: np.ndarray, kinds: list[str | None],
                      camera: ImageToWorkspace | None) -> dict[str, Any]:
    """Return particles as the page receives them.

    Parameters
    ----------
    stamp : int
        Stamp of the picture [ns].
    points : ndarray, shape (N,)
        PARTICLE of each particle.
    kinds : list of str or None
        Kind (N,) of each particle.
    camera : ImageToWorkspace or None
        Geometry of the picture; without it there are no pixels.

    Returns
    -------
    dict of str to object
        The message.
    """
    xy = np.stack([points['x'], points['y']], axis=1).astype(float)
    pixels = np.full_like(xy, np.nan) if camera is None else camera.pixels(xy)
    size = camera.pixel_size if camera else math.nan
    return {'kind': 'particles', 'stamp': str(stamp), 'particles': [
        {'id': int(point['id']), 'kind': kind, 'x_px': _finite(x), 'y_px': _finite(y),
         'x_um': _finite(1e6 * point['x']), 'y_um': _finite(1e6 * point['y']),
         'heading_rad': _finite(point['theta']), 'sigma_px': _finite(point['sigma'] / size)}
        for point, (x, y), kind in zip(points, pixels.tolist(), kinds, strict=True)]}


def _json_in(text: str, topic: str) -> Any:
    """Return the content of a text of a topic; MessageError if it is not JSON."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        raise messages.MessageError(f'{topic}: expected JSON') from None


def _millitesla(vector: Any) -> list[float | None] | None:
    return None if vector is None else [_finite(1e3 * vector.x), _finite(1e3 * vector.y)]


def _to_um(camera: ImageToWorkspace) -> list[list[float]]:
    """Return the affine map of pixels to µm (2, 3)."""
    origin, right, down = 1e6 * camera.position(np.array([[0, 0], [1, 0], [0, 1]]))
    return np.column_stack([right - origin, down - origin, origin]).round(9).tolist()


def _finite(value: Any) -> float | None:
    """Return a number as in JSON, with six digits; None for a value that is not finite."""
    number = float(value)
    return float(f'{number:.6g}') if math.isfinite(number) else None


def _number(value: Any) -> float | None:
    try:
        return _finite(value)
    except ValueError:
        return None


def _nobody(*_: object) -> None:
    """Do nothing, as a listener."""
