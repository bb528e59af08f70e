"""Conversion between arrays and messages, without a Python object per particle or pixel."""

from __future__ import annotations

import array
from collections.abc import Collection, Iterable
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from builtin_interfaces.msg import Duration, Time
from geometry_msgs.msg import Pose, PoseArray, TwistStamped, Vector3, Vector3Stamped
from sensor_msgs.msg import (
    CameraInfo,
    Image,
    JointState,
    MagneticField,
    PointCloud2,
    PointField,
    RegionOfInterest,
)
from std_msgs.msg import Header
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from microbot_ros.cameras.camera import CameraFormat
from microbot_ros.common.errors import clipped
from microbot_ros.common.records import Commands
from microbot_ros.loop.points import ESTIMATE
from microbot_ros.session.mcap.cloud import POINT_TYPES, cloud_table

if TYPE_CHECKING:
    from microbot_ros.tracking.locate.colour import Weights

SECOND_NS = 1_000_000_000
"""Nanoseconds of a second, by definition."""

WORKSPACE = 'workspace'
"""Frame of every position and every field: x right, y up."""

CAMERA = 'camera'
"""Frame of the picture: x right, y down, z in viewing direction, origin at its centre."""

PIXELS = 'camera_pixels'
"""Frame name of pixel coordinates in a point: the centre of the first pixel is (0, 0), y down. It
is no frame of tf, in which lengths are metres (REP 103)."""

TRUTH = np.dtype([
    ('id', '<u4'), ('x', '<f4'), ('y', '<f4'), ('theta', '<f4'), ('speed', '<f4'),
    ('phi', '<f4'),
])
"""A point of `virtual_rig/truth`, in SI. It serves to evaluate the other nodes; no node reads
it."""

_PLANNED = ['bx', 'by', 'frequency']

_POINT_CODES = {name: code for code, name in POINT_TYPES.items()}


class MessageError(ValueError):
    """Error of a received message whose content does not agree with its topic."""


def to_seconds(stamp: Time) -> float:
    """Return a ROS stamp in seconds; the resolution of a double at today's epoch is 0.2 µs.

    Parameters
    ----------
    stamp : Time
        The stamp.

    Returns
    -------
    float
        Time [s].
    """
    return stamp.sec + stamp.nanosec * 1e-9


def to_stamp(seconds: float) -> Time:
    """Return a time as a ROS stamp.

    Parameters
    ----------
    seconds : float
        Time [s].

    Returns
    -------
    Time
        The stamp.
    """
    return stamp_at(round(seconds * 1e9))


def to_nanoseconds(stamp: Time) -> int:
    """Return a ROS stamp in nanoseconds, exactly.

    Parameters
    ----------
    stamp : Time
        The stamp.

    Returns
    -------
    int
        Time [ns].
    """
    return int(stamp.sec) * SECOND_NS + int(stamp.nanosec)


def stamp_at(nanoseconds: int) -> Time:
    """Return a time in nanoseconds as a ROS stamp.

    Parameters
    ----------
    nanoseconds : int
        Time [ns].

    Returns
    -------
    Time
        The stamp.
    """
    return Time(sec=nanoseconds // SECOND_NS, nanosec=nanoseconds % SECOND_NS)


def cloud(points: np.ndarray, stamp: Time) -> PointCloud2:
    """Return structured points as a PointCloud2, with one field per name.

    Parameters
    ----------
    points : ndarray, shape (N,)
        Structured array.
    stamp : Time
        Stamp of the message.

    Returns
    -------
    PointCloud2
        The message.
    """
    kind = points.dtype
    layout: dict[str, Any] = dict(kind.fields or {})
    fields = [
        PointField(name=name, offset=layout[name][1], count=1,
                   datatype=_POINT_CODES[layout[name][0].str[1:]])
        for name in kind.names or ()
    ]
    return PointCloud2(
        header=Header(stamp=stamp, frame_id=WORKSPACE), height=1, width=len(points),
        fields=fields, point_step=kind.itemsize, row_step=kind.itemsize * len(points),
        is_dense=True, data=array.array('B', points.tobytes()))


def in_workspace(header: Header) -> None:
    """Check that a header has the frame of the workspace, for which '' stands too.

    Parameters
    ----------
    header : Header
        The header.

    Raises
    ------
    MessageError
        If it has another frame.
    """
    if header.frame_id not in ('', WORKSPACE):
        raise MessageError(
            f"expected the frame '{WORKSPACE}'; received '{clipped(header.frame_id)}': "
            'transform the points before sending them, or set the Fixed Frame of RViz to '
            f"'{WORKSPACE}'")


def estimates(message: PointCloud2) -> np.ndarray:
    """Return the estimates in a message of `model/state`.

    Parameters
    ----------
    message : PointCloud2
        The message.

    Returns
    -------
    ndarray, shape (N,)
        ESTIMATE; `theta` is NaN in a recording from before that field existed.
    """
    return points(message, ESTIMATE, optional=('theta',))


def points(message: PointCloud2, kind: np.dtype, optional: Collection[str] = ()) -> np.ndarray:
    """Return the points of a cloud as a structured array.

    Parameters
    ----------
    message : PointCloud2
        The message.
    kind : dtype
        Type of the array.
    optional : collection of str
        Fields that are NaN if they are missing.

    Returns
    -------
    ndarray, shape (N,)
        Array of type `kind`.

    Raises
    ------
    MessageError
        If the frame is not that of the workspace, a field of `kind` is missing or the data are too
        short.
    """
    in_workspace(message.header)
    names = [field.name for field in message.fields]
    missing = [name for name in kind.names or () if name not in {*names, *optional}]
    if missing:
        raise MessageError(f'expected a point field {missing[0]!r}, found {", ".join(names)}')
    count = message.width * message.height
    if len(message.data) < count * message.point_step:
        raise MessageError(f'expected {count} points, found {len(message.data)} bytes')
    raw = cloud_table(message)
    if raw.dtype == kind:
        return raw
    result = np.empty(count, kind)
    for name in kind.names or ():
        result[name] = raw[name] if name in names else np.nan
    return result


def image(pixels: np.ndarray, stamp: Time, frame_id: str = CAMERA, encoding: str = '') -> Image:
    """Return pixels as an Image.

    Parameters
    ----------
    pixels : ndarray
        Array (H, W) or (H, W, values).
    stamp : Time
        Stamp of the message.
    frame_id : str
        Frame of the picture.
    encoding : str
        Encoding; '' for uint8, mono8 or (H, W, 3) bgr8.

    Returns
    -------
    Image
        The message.
    """
    rows = np.ascontiguousarray(pixels)
    data = array.array('B')
    data.frombytes(rows.data.cast('B'))  # 300 times faster than assigning an array
    return Image(
        header=Header(stamp=stamp, frame_id=frame_id), height=rows.shape[0], width=rows.shape[1],
        encoding=encoding or ('mono8' if rows.ndim == 2 else 'bgr8'), step=rows.strides[0],
        data=data)


def camera_info(form: CameraFormat, stamp: Time) -> CameraInfo:
    """Return the CameraInfo of a camera's format: size and region.

    Its matrices are zero, which means uncalibrated: a microscope has no focal length in pixels.

    Parameters
    ----------
    form : CameraFormat
        Format of the camera.
    stamp : Time
        Stamp of the message.

    Returns
    -------
    CameraInfo
        The message.
    """
    height, width = form.sensor or (form.height, form.width)
    result = CameraInfo(header=Header(stamp=stamp, frame_id=CAMERA), height=height, width=width)
    if (height, width) != (form.height, form.width):
        x, y = form.offset
        result.roi = RegionOfInterest(
            x_offset=x, y_offset=y, height=form.height, width=form.width)
    return result


_TO_GRAY = {
    'bgr8': cv2.COLOR_BGR2GRAY, 'rgb8': cv2.COLOR_RGB2GRAY,
    'bgra8': cv2.COLOR_BGRA2GRAY, 'rgba8': cv2.COLOR_RGBA2GRAY,
    # OpenCV names a Bayer pattern by its second row, ROS by its first.
    'bayer_rggb8': cv2.COLOR_BayerBG2GRAY, 'bayer_bggr8': cv2.COLOR_BayerRG2GRAY,
    'bayer_gbrg8': cv2.COLOR_BayerGR2GRAY, 'bayer_grbg8': cv2.COLOR_BayerGB2GRAY,
}

_TO_BGR = {
    'rgb8': cv2.COLOR_RGB2BGR, 'rgba8': cv2.COLOR_RGBA2BGR,
    'bayer_rggb8': cv2.COLOR_BayerBG2BGR, 'bayer_bggr8': cv2.COLOR_BayerRG2BGR,
    'bayer_gbrg8': cv2.COLOR_BayerGR2BGR, 'bayer_grbg8': cv2.COLOR_BayerGB2BGR,
}


def gray(message: Image, colour: Weights | None = None) -> np.ndarray:
    """Return the picture in a message as grey values.

    Parameters
    ----------
    message : Image
        The message.
    colour : Weights or None
        Weights of the colours; None for brightness.

    Returns
    -------
    ndarray, shape (H, W)
        Uint8, or uint16 for mono16.

    Raises
    ------
    MessageError
        If the encoding is unknown, if it has no colours and `colour` is given, or if the data do
        not fill the picture.
    """
    kinds: dict[str, tuple[str, int]] = {
        'mono8': ('u1', 1), '8UC1': ('u1', 1), 'mono16': ('u2', 1), '16UC1': ('u2', 1),
        'bgr8': ('u1', 3), 'rgb8': ('u1', 3), 'bgra8': ('u1', 4), 'rgba8': ('u1', 4),
    }
    kinds |= {name: ('u1', 1) for name in _TO_GRAY if name.startswith('bayer')}
    if message.encoding not in kinds:
        known = ', '.join(sorted(kinds))
        raise MessageError(f'expected an image encoding of {known}; received {message.encoding!r}')
    kind, channels = kinds[message.encoding]
    depth = np.dtype(('>' if message.is_bigendian else '<') + kind)
    width = message.width * channels * depth.itemsize
    if message.step < width or len(message.data) < message.step * message.height or not width:
        raise MessageError(
            f'expected {message.width}×{message.height} pixels of {message.encoding}; '
            f'received {len(message.data)} bytes')
    rows = np.frombuffer(message.data, np.uint8, message.step * message.height)
    rows = rows.reshape(message.height, message.step)[:, :width]
    pixels = np.ascontiguousarray(rows).view(depth).reshape(message.height, message.width, -1)
    if colour is not None:
        from microbot_ros.tracking.locate.colour import weighted  # imports the whole tracker

        if message.encoding not in _TO_GRAY:
            raise MessageError('expected colour images, which distinguish the kinds; received '
                               f'{message.encoding}')
        code = _TO_BGR.get(message.encoding)
        return weighted(pixels if code is None else cv2.cvtColor(pixels, code), colour)
    if message.encoding in _TO_GRAY:
        return np.asarray(cv2.cvtColor(pixels, _TO_GRAY[message.encoding]))
    return pixels[..., 0]


def poses(xy: np.ndarray, theta: np.ndarray, stamp: Time) -> PoseArray:
    """Return positions and headings as a PoseArray.

    Parameters
    ----------
    xy : ndarray, shape (N, 2)
        Positions [m].
    theta : ndarray, shape (N,)
        Headings [rad], NaN where unknown, which becomes 0.
    stamp : Time
        Stamp of the message.

    Returns
    -------
    PoseArray
        The message.
    """
    half = np.nan_to_num(theta) / 2
    result = PoseArray(header=Header(stamp=stamp, frame_id=WORKSPACE))
    for (x, y), sine, cosine in zip(xy.tolist(), np.sin(half), np.cos(half), strict=True):
        pose = Pose()
        pose.position.x, pose.position.y = x, y
        pose.orientation.z, pose.orientation.w = float(sine), float(cosine)
        result.poses.append(pose)
    return result


def currents(names: Iterable[str], amperes: Any, stamp: Time) -> JointState:
    """Return currents as a JointState, the message of all `coils/…` topics.

    Parameters
    ----------
    names : iterable of str
        Names of the N coils.
    amperes : object
        Currents (N,) [A]; they are sent in `effort`.
    stamp : Time
        Stamp of the message.

    Returns
    -------
    JointState
        The message.
    """
    return JointState(header=Header(stamp=stamp, frame_id='coils'), name=list(names),
                      effort=[float(value) for value in amperes])


def field_at(message: MagneticField) -> tuple[float, np.ndarray]:
    """Return time and field of a message.

    Parameters
    ----------
    message : MagneticField
        The message.

    Returns
    -------
    tuple[float, ndarray]
        Time [s] and field (2,) [T].

    Raises
    ------
    MessageError
        If its frame is not that of the workspace.
    """
    return _vector_at(message.header, message.magnetic_field)


def whole_field_at(message: MagneticField) -> tuple[float, np.ndarray]:
    """Return time and field of a message, with the component along z.

    Parameters
    ----------
    message : MagneticField
        The message.

    Returns
    -------
    tuple[float, ndarray]
        Time [s] and field (3,) [T].

    Raises
    ------
    MessageError
        If its frame is not that of the workspace.
    """
    t, (x, y) = field_at(message)
    return t, np.array([x, y, message.magnetic_field.z])


def vector_at(message: Vector3Stamped) -> tuple[float, np.ndarray]:
    """Return time and vector in the plane of a message.

    Parameters
    ----------
    message : Vector3Stamped
        The message.

    Returns
    -------
    tuple[float, ndarray]
        Time [s] and vector (2,).

    Raises
    ------
    MessageError
        If its frame is not that of the workspace.
    """
    return _vector_at(message.header, message.vector)


def _vector_at(header: Header, vector: Vector3) -> tuple[float, np.ndarray]:
    in_workspace(header)
    return to_seconds(header.stamp), np.array([vector.x, vector.y])


def field_vector(field: np.ndarray, stamp: Time) -> Vector3Stamped:
    """Return a field as the message of `field/command`.

    Parameters
    ----------
    field : ndarray
        Field (2,) in the plane, or (3,) [T].
    stamp : Time
        Stamp of the message.

    Returns
    -------
    Vector3Stamped
        The message.
    """
    message = Vector3Stamped(header=Header(stamp=stamp, frame_id=WORKSPACE))
    for name, value in zip('xyz', field.tolist(), strict=False):
        setattr(message.vector, name, value)
    return message


def vector(message: Vector3Stamped) -> np.ndarray:
    """Return the vector of a message.

    Parameters
    ----------
    message : Vector3Stamped
        The message.

    Returns
    -------
    ndarray, shape (3,)
        Vector in the frame of the workspace.

    Raises
    ------
    MessageError
        If its frame is not that of the workspace.
    """
    in_workspace(message.header)
    return np.array([message.vector.x, message.vector.y, message.vector.z])


def rotating(field: np.ndarray, angular_velocity: np.ndarray, stamp: Time) -> TwistStamped:
    """Return a rotating field as the message of `field/rotating`.

    Parameters
    ----------
    field : ndarray
        Field that rotates, (2,) in the plane or (3,) [T].
    angular_velocity : ndarray, shape (3,)
        Angular velocity of the field [rad/s].
    stamp : Time
        Exposure of the frame that the command answers.

    Returns
    -------
    TwistStamped
        The message.
    """
    message = TwistStamped(header=Header(stamp=stamp, frame_id=WORKSPACE))
    for part, values in ((message.twist.linear, field), (message.twist.angular, angular_velocity)):
        for name, value in zip('xyz', values.tolist(), strict=False):
            setattr(part, name, value)
    return message


def rotating_field(message: TwistStamped) -> tuple[np.ndarray, np.ndarray]:
    """Return field and angular velocity of a message on `field/rotating`.

    Parameters
    ----------
    message : TwistStamped
        The message.

    Returns
    -------
    tuple[ndarray, ndarray]
        Field (3,) [T] and angular velocity (3,) [rad/s].

    Raises
    ------
    MessageError
        If its frame is not that of the workspace.
    """
    in_workspace(message.header)
    field, angular_velocity = (np.array([part.x, part.y, part.z]) for part in (
        message.twist.linear, message.twist.angular))
    return field, angular_velocity


def plan_rows(message: JointTrajectory) -> Commands:
    """Return the plan in a message on `field/plan`, with times from its beginning.

    Its joints are `bx` and `by` [T], and optionally `frequency` [Hz] of a rolling field.

    Parameters
    ----------
    message : JointTrajectory
        The message.

    Returns
    -------
    Commands
        The plan.

    Raises
    ------
    MessageError
        If it has other joints or another frame.
    """
    in_workspace(message.header)
    names = list(message.joint_names)
    if names not in (_PLANNED[:2], _PLANNED):
        raise MessageError(f'expected joints {", ".join(_PLANNED)}, found {", ".join(names)}')
    if any(len(point.positions) != len(names) for point in message.points):
        raise MessageError(f'expected {len(names)} positions at every point')
    rows = np.array([point.positions for point in message.points], float).reshape(-1, len(names))
    t = np.array([p.time_from_start.sec + p.time_from_start.nanosec * 1e-9
                  for p in message.points])
    return Commands(t, rows[:, :2], rows[:, 2] if len(names) > 2 else None)


def plan(commands: Commands, stamp: Time) -> JointTrajectory:
    """Return a plan as the message of `field/plan`.

    Parameters
    ----------
    commands : Commands
        The plan, with times from 0.
    stamp : Time
        Stamp that distinguishes it from other plans.

    Returns
    -------
    JointTrajectory
        The message.
    """
    rows = commands.field if commands.frequency is None else np.column_stack(
        [commands.field, commands.frequency])
    result = JointTrajectory(header=Header(stamp=stamp, frame_id=WORKSPACE),
                             joint_names=_PLANNED[:rows.shape[1]])
    for t, row in zip(commands.t.tolist(), rows.tolist(), strict=True):
        at = to_stamp(t)
        result.points.append(JointTrajectoryPoint(
            positions=row, time_from_start=Duration(sec=at.sec, nanosec=at.nanosec)))
    return result


def magnetic_field(field: np.ndarray, stamp: Time) -> MagneticField:
    """Return a field as the message of `field/applied`.

    Parameters
    ----------
    field : ndarray
        Field (2,) in the plane, or (3,) [T].
    stamp : Time
        Stamp of the message.

    Returns
    -------
    MagneticField
        The message.
    """
    message = MagneticField(header=Header(stamp=stamp, frame_id=WORKSPACE))
    for name, value in zip('xyz', field.tolist(), strict=False):
        setattr(message.magnetic_field, name, value)
    return message
