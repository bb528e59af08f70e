"""Arrays survive the way through messages; foreign layouts are read, broken ones refused."""

from __future__ import annotations

import array

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.lib.recfunctions import repack_fields
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import Image, PointCloud2, PointField

from microbot_ros.common.records import Commands
from microbot_ros.loop.points import ESTIMATE, PARTICLE
from microbot_ros.nodes.base import messages

STAMP = Time(sec=1_700_000_000, nanosec=123_456_789)


@given(st.integers(0, 2**31 - 1), st.integers(0, 999_999_999))
def test_stamps_survive_to_a_quarter_of_a_microsecond(sec: int, nanosec: int) -> None:
    back = messages.to_stamp(messages.to_seconds(Time(sec=sec, nanosec=nanosec)))
    assert abs((back.sec - sec) * 10**9 + back.nanosec - nanosec) <= 250


@given(hnp.arrays(PARTICLE, st.integers(0, 20)))
def test_points_survive_a_cloud_on_the_wire(points: np.ndarray) -> None:
    wire = serialize_message(messages.cloud(points, STAMP))
    back = messages.points(deserialize_message(wire, PointCloud2), PARTICLE)
    assert back.tobytes() == points.tobytes()


def test_a_cloud_of_another_layout_is_read_by_name() -> None:
    theirs = np.dtype({'names': ['y', 'x', 'id'], 'formats': ['>f8', '>f8', '>i4'],
                       'offsets': [0, 12, 24], 'itemsize': 32})
    rows = np.zeros(2, theirs)
    rows['x'], rows['y'], rows['id'] = [1.5, -2.0], [0.25, 4.0], [7, 8]
    message = PointCloud2(height=1, width=2, point_step=32, is_bigendian=True, fields=[
        PointField(name='y', offset=0, datatype=PointField.FLOAT64, count=1),
        PointField(name='x', offset=12, datatype=PointField.FLOAT64, count=1),
        PointField(name='id', offset=24, datatype=PointField.INT32, count=1),
    ], data=array.array('B', rows.tobytes()))
    wanted = np.dtype([('id', '<u4'), ('x', '<f4'), ('y', '<f4')])
    assert messages.points(message, wanted).tolist() == [(7, 1.5, 0.25), (8, -2.0, 4.0)]


def test_a_cloud_without_a_field_or_with_too_few_bytes_is_refused() -> None:
    points = np.zeros(3, PARTICLE)
    with pytest.raises(messages.MessageError, match="'speed'"):
        messages.points(messages.cloud(points, STAMP), ESTIMATE)
    message = messages.cloud(points, STAMP)
    message.width = 4
    with pytest.raises(messages.MessageError, match='4 points'):
        messages.points(message, PARTICLE)


def test_a_picture_survives_and_padding_is_cut() -> None:
    picture = np.arange(6 * 5, dtype=np.uint8).reshape(6, 5)
    assert (messages.gray(messages.image(picture, STAMP)) == picture).all()
    padded = np.zeros((6, 8), np.uint8)
    padded[:, :5] = picture
    message = Image(height=6, width=5, step=8, encoding='mono8',
                    data=array.array('B', padded.tobytes()))
    assert (messages.gray(message) == picture).all()


@pytest.mark.parametrize('order', ['<', '>'])
def test_sixteen_bits_are_kept_in_either_byte_order(order: str) -> None:
    picture = np.array([[1, 500], [40_000, 65_535]], np.uint16)
    data = picture.astype(f'{order}u2').tobytes()
    message = Image(height=2, width=2, step=4, encoding='mono16', is_bigendian=order == '>',
                    data=array.array('B', data))
    assert messages.gray(message).tolist() == picture.tolist()


@pytest.mark.parametrize(('encoding', 'colour'), [
    ('rgb8', (250, 10, 20)), ('bgr8', (250, 10, 20)), ('bayer_rggb8', (250, 10, 20)),
    ('bayer_bggr8', (10, 20, 250)), ('bayer_gbrg8', (10, 250, 20)), ('bayer_grbg8', (10, 250, 20)),
])
def test_colour_is_weighed_as_the_eye_does_or_as_was_learned(
    encoding: str, colour: tuple[int, int, int]
) -> None:
    """A uniformly coloured scene, made into each mosaic by hand, gives the grey of its colour."""
    red, green, blue = colour
    channels = {'r': red, 'g': green, 'b': blue}
    if encoding.startswith('bayer'):
        a, b, c, d = encoding[6:10]
        picture = np.tile(np.array([[channels[a], channels[b]], [channels[c], channels[d]]],
                                   np.uint8), (8, 8))
        data, step = picture.tobytes(), 16
    else:
        pixel = [channels[name] for name in encoding[:3]]
        data, step = np.full((16, 16, 3), pixel, np.uint8).tobytes(), 48
    message = Image(height=16, width=16, step=step, encoding=encoding,
                    data=array.array('B', data))
    expected = 0.299 * red + 0.587 * green + 0.114 * blue
    inside = messages.gray(message)[3:-3, 3:-3]
    assert inside.shape == (10, 10)
    assert np.abs(inside.astype(float) - expected).max() <= 2
    learned = messages.gray(message, (-0.5, 0.3, 0.2))[3:-3, 3:-3]
    expected = 127.5 - 0.5 * (red - 127.5) + 0.3 * (green - 127.5) + 0.2 * (blue - 127.5)
    assert np.abs(learned.astype(float) - expected).max() <= 2


def test_a_grey_picture_has_no_colours_to_tell_by() -> None:
    with pytest.raises(messages.MessageError, match='expected colour images'):
        messages.gray(messages.image(np.zeros((4, 6), np.uint8), STAMP), (1.0, 0.0, 0.0))


@pytest.mark.parametrize('broken', [
    {'encoding': 'yuv422'}, {'encoding': ''}, {'step': 3}, {'height': 100}, {'width': 0},
])
def test_a_broken_picture_is_refused_in_one_line(broken: dict[str, object]) -> None:
    message = messages.image(np.zeros((4, 6), np.uint8), STAMP)
    for name, value in broken.items():
        setattr(message, name, value)
    with pytest.raises(messages.MessageError, match=r'^[^\n]+$'):
        messages.gray(message)


def test_a_state_of_before_headings_were_carried_is_read_without() -> None:
    before = [name for name in ESTIMATE.names or () if name != 'theta']
    points = np.ones(2, ESTIMATE)
    message = messages.cloud(repack_fields(points[before]), STAMP)
    with pytest.raises(messages.MessageError, match="'theta'"):
        messages.points(message, ESTIMATE)
    read = messages.estimates(message)
    assert np.isnan(read['theta']).all()
    assert all((read[name] == 1).all() for name in before)
    assert messages.estimates(messages.cloud(points, STAMP))['theta'].tolist() == [1.0, 1.0]
    assert ESTIMATE.names[-1] == 'theta'


@pytest.mark.parametrize('frame', ['camera', 'map', 'Workspace', ' '])
def test_points_in_another_frame_are_refused(frame: str) -> None:
    message = messages.cloud(np.zeros(1, PARTICLE), STAMP)
    message.header.frame_id = ''
    assert len(messages.points(message, PARTICLE)) == 1
    message.header.frame_id = frame
    with pytest.raises(messages.MessageError, match=f"the frame 'workspace'; received '{frame}'"):
        messages.points(message, PARTICLE)


@pytest.mark.parametrize('rolling', [False, True])
def test_a_plan_comes_out_as_it_went_in(rolling: bool) -> None:
    plan = Commands(np.array([0.0, 1.25, 60.5]), np.array([[1e-3, 0], [0, -2e-3], [0, 0]]),
                    np.array([1.0, 5.0, 0.0]) if rolling else None)
    back = messages.plan_rows(messages.plan(plan, messages.to_stamp(12.5)))
    assert back.t == pytest.approx(plan.t)
    assert back.field.tolist() == plan.field.tolist()
    assert (back.frequency is None) == (not rolling)


def test_a_plan_of_other_joints_is_refused() -> None:
    message = messages.plan(Commands(np.zeros(1), np.zeros((1, 2))), messages.to_stamp(0.0))
    message.joint_names = ['elbow', 'wrist']
    with pytest.raises(messages.MessageError, match='bx, by'):
        messages.plan_rows(message)
    message.joint_names = ['bx', 'by']
    message.points[0].positions = [1.0]
    with pytest.raises(messages.MessageError, match='2 positions'):
        messages.plan_rows(message)
