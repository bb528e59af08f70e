"""Cameras as their makers emulate them: what is asked is done, what is lost is counted.

`test_emulators.py` runs these tests in a process for each maker.
"""

import importlib.util
import math
import time

import numpy as np
import pytest

from bench._aravis import has_aravis
from microbot_ros.cameras.camera import CameraSettings, Clock, camera_class
from microbot_ros.cameras.stream import FrameStream
from microbot_ros.cameras.testkit import exercise
from microbot_ros.common.errors import InputError

pytestmark = pytest.mark.rig

pylon = pytest.param('pylon', '0815-0000', marks=pytest.mark.skipif(
    importlib.util.find_spec('pypylon') is None, reason='pypylon is not installed'))
micromanager = pytest.param('micromanager', 'demo', marks=pytest.mark.skipif(
    None in map(importlib.util.find_spec, ('pymmcore', 'mm_test_adapters')),
    reason='pymmcore or mm-test-adapters is not installed'))
aravis = pytest.param('aravis', 'Fake_1', marks=pytest.mark.skipif(
    not has_aravis(), reason='Aravis and PyGObject are not installed (Debian: '
    'gir1.2-aravis-0.8, python3-gi)'))
every_kind = pytest.mark.parametrize(('kind', 'source'), [pylon, micromanager, aravis])


@pytest.fixture(autouse=True)
def emulated(monkeypatch):
    """One Basler camera that is none."""
    monkeypatch.setenv('PYLON_CAMEMU', '1')


@pytest.fixture
def opened():
    """Opens cameras, by kind, source and settings; closes them all at the end."""
    streams = []

    def open_one(kind, source, **wanted):
        streams.append(FrameStream(
            camera_class(kind)(CameraSettings(source, **wanted), pytest.fail)))
        return streams[-1]
    yield open_one
    for stream in streams:
        stream.close()


def read(stream, count, each=lambda _: None):
    """The next frames: numbers, moments and arrivals; `each` sees a frame while it is there."""
    rows = []
    deadline = time.monotonic() + 30.0
    while len(rows) < count:
        assert time.monotonic() < deadline
        if found := stream.read(0.5):
            frame, moment = found
            each(frame)
            rows.append((frame.number, moment, frame.arrived))
    return np.array(rows)


@every_kind
def test_frames_of_the_region_in_order_with_moments_before_they_arrive(kind, source, opened):
    stream = opened(kind, source, width_px=320, height_px=200, offset_x_px=16, offset_y_px=8,
                    exposure_ms=4.0)
    form = stream.format
    assert (form.width, form.height, form.offset) == (320, 200, (16, 8))
    assert form.least_delay == pytest.approx(0.004)
    shapes = set()
    rows = read(stream, 40, lambda frame: shapes.add((frame.image.shape, frame.image.dtype)))
    assert shapes == {((200, 320), np.dtype(np.uint8))}
    numbers, moments, arrivals = rows.T
    assert (np.diff(moments) > 0).all()
    assert (moments <= arrivals - 0.004).all()
    steps = np.diff(numbers)
    if kind == 'aravis':
        steps %= 65535
    assert stream.lost >= (steps - 1).sum()
    assert stream.repeated == 0


@every_kind
def test_pictures_are_no_constant(kind, source, opened):
    """A view of memory that has been given back would show."""
    contents = []
    read(opened(kind, source), 5, lambda frame: contents.append(frame.image.astype(float).std()))
    assert min(contents) > 1.0


@pytest.mark.parametrize(('kind', 'source', 'pixel_format', 'encoding', 'shape', 'depth'), [
    (*pylon.values, 'Mono12', 'mono16', (), np.uint16),
    (*pylon.values, 'BayerRG8', 'bayer_rggb8', (), np.uint8),
    (*pylon.values, 'BGR8Packed', 'bgr8', (3,), np.uint8),
    (*micromanager.values, '16bit', 'mono16', (), np.uint16),
    (*micromanager.values, '32bitRGB', 'bgra8', (4,), np.uint8),
    (*aravis.values, 'Mono16', 'mono16', (), np.uint16),
    (*aravis.values, 'BayerGR8', 'bayer_grbg8', (), np.uint8),
])
def test_pixels_come_as_they_are(kind, source, pixel_format, encoding, shape, depth, opened):
    for param in (pylon, micromanager, aravis):
        if param.values[0] == kind and param.marks[0].args[0]:
            pytest.skip(param.marks[0].kwargs['reason'])
    stream = opened(kind, source, pixel_format=pixel_format)
    form = stream.format
    assert form.encoding == encoding

    def look(frame):
        assert frame.image.shape == (form.height, form.width, *shape)
        assert frame.image.dtype == depth
    read(stream, 2, look)


@every_kind
@pytest.mark.parametrize(('wanted', 'said'), [
    ({'exposure_ms': 9e5}, 'exposure_ms must be'),
    ({'gain': 1e5}, 'gain must be'),
    ({'width_px': 90_000}, 'width_px must be'),
    ({'offset_x_px': 90_000}, 'offset_x_px must be'),
    ({'pixel_format': 'Mono7'}, 'pixel_format must be one of'),
    ({'trigger': 'Line77'}, 'trigger must be one of|trigger cannot be set'),
    ({'source': 'nobody'}, 'nobody'),
])
def test_what_it_cannot_do_is_refused_in_a_line_and_leaves_it_free(
        kind, source, wanted, said, opened):
    with pytest.raises(InputError, match=said) as refused:
        opened(kind, **{'source': source, **wanted})
    assert '\n' not in str(refused.value)
    assert read(opened(kind, source), 2).shape == (2, 3)


@every_kind
def test_the_contract_is_kept(kind, source):
    exercise(camera_class(kind), source)


@pytest.mark.parametrize(('kind', 'source'), [pylon])
def test_frames_that_arrive_damaged_are_counted_and_left_out(kind, source, opened):
    stream = opened(kind, source, width_px=64, height_px=64)
    before = read(stream, 5)
    device = stream._camera._device
    device.ForceFailedBufferCount.Value = 6
    device.ForceFailedBuffer.Execute()
    rows = read(stream, 60)
    assert stream.lost == 6
    assert rows[-1, 0] - before[-1, 0] == len(rows) + 6


@pytest.mark.parametrize(('kind', 'source'), [pylon, aravis])
def test_a_trigger_that_does_not_come_is_waited_for(kind, source, opened):
    line = {'pylon': 'Line1', 'aravis': 'Line0'}[kind]
    stream = opened(kind, source, trigger=line)
    assert stream.format.patience == math.inf
    if kind == 'pylon':  # the fake camera of Aravis takes the setting and gives frames
        assert stream.read(0.3) is None


@pytest.mark.parametrize(('kind', 'source'), [aravis])
def test_frames_without_room_for_them_are_counted(kind, source, opened):
    """By Aravis' own book: those that came, and those for which no buffer was free."""
    stream = opened(kind, source, width_px=64, height_px=64, frame_rate_hz=400.0)
    read(stream, 20)
    time.sleep(0.5)
    read(stream, 60)
    assert stream.lost == stream._camera._stream.get_statistics()[2] > 50


@pytest.mark.parametrize(('kind', 'source'), [aravis])
def test_stamps_are_by_the_devices_clock(kind, source, opened):
    """They are regular where arrivals, read late on purpose, are not."""
    stream = opened(kind, source, width_px=64, height_px=64, frame_rate_hz=100.0)
    assert stream.format.clock is Clock.DEVICE
    rows = read(stream, 60, lambda frame: time.sleep(0.05 if frame.number % 20 == 0 else 0.0))
    _, moments, arrivals = rows.T
    assert np.abs(np.diff(arrivals)).max() > 0.045
    assert np.abs(np.diff(moments)).max() < 0.035


@pytest.mark.parametrize(('kind', 'source'), [micromanager])
def test_a_buffer_that_runs_over_stops_it_and_says_so(kind, source, opened, monkeypatch):
    monkeypatch.setattr('microbot_ros.cameras.micromanager._BUFFER_MB', 1)
    stream = opened(kind, source, exposure_ms=1.0)
    core = stream._camera._core
    deadline = time.monotonic() + 20
    while core.isSequenceRunning() and time.monotonic() < deadline:
        time.sleep(0.01)
    held = core.getRemainingImageCount()
    for _ in range(held):  # are given first
        assert stream.read(0.05)
    with pytest.raises(InputError, match='its buffer overflowed'):
        stream.read(0.05)
