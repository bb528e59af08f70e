"""V4L2 against the kernel's own layout: no device is needed to know the bytes."""

import struct
import time

import cv2
import numpy as np
import pytest
from video_kernel import (
    BROKEN,
    CODES,
    EXPOSURE,
    EXPOSURE_AUTO,
    GAIN,
    MONOTONIC,
    START_OF_EXPOSURE,
    Kernel,
)

from microbot_ros.cameras import v4l2_device
from microbot_ros.cameras.camera import CameraSettings, Clock
from microbot_ros.cameras.stream import FrameStream
from microbot_ros.cameras.v4l2 import V4l2Camera
from microbot_ros.cameras.v4l2_device import VideoDevice
from microbot_ros.common.errors import InputError

GREY = np.arange(48 * 64, dtype=np.uint16).reshape(48, 64).astype(np.uint8)


@pytest.fixture
def plugged(tmp_path, monkeypatch):
    """Plugs a camera in; what is opened afterwards is that one."""
    def plug(**how):
        file = tmp_path / 'video'
        file.touch()
        kernel = Kernel(file, **how)
        monkeypatch.setattr(V4l2Camera, '_connected',
                            lambda *_: VideoDevice(str(file), kernel.ioctl))
        feed = kernel._streamon
        kernel.first = bytes(60_000)

        def switch_on(data):
            feed(data)
            kernel.fill(kernel.first, 0, time.monotonic(), kernel.flags)
        kernel.flags = MONOTONIC | START_OF_EXPOSURE
        kernel._streamon = switch_on
        return kernel
    return plug


def opened(**wanted):
    return FrameStream(V4l2Camera(CameraSettings('/dev/video0', **wanted), pytest.fail))


@pytest.mark.parametrize('name', CODES)
def test_requests_are_those_of_the_header(name):
    assert getattr(v4l2_device, name) == CODES[name]


@pytest.mark.parametrize(('pixel_format', 'payload', 'expected'), [
    ('GREY', GREY.tobytes(), GREY),
    ('YUYV', np.stack([GREY, GREY * 0 + 128], 2).tobytes(), GREY),
    ('UYVY', np.stack([GREY * 0 + 128, GREY], 2).tobytes(), GREY),
    ('NV12', GREY.tobytes() + bytes(32 * 48), GREY),
    ('Y16', (GREY.astype('<u2') * 256).tobytes(), GREY.astype('<u2') * 256),
    ('RGGB', GREY.tobytes(), GREY),
    ('BGR3', np.stack([GREY, GREY + 1, GREY + 2], 2).astype(np.uint8).tobytes(),
     np.stack([GREY, GREY + 1, GREY + 2], 2).astype(np.uint8)),
])
def test_brightness_is_read_out_of_every_layout(plugged, pixel_format, payload, expected):
    kernel = plugged(formats=(pixel_format,))
    stream = opened()
    kernel.fill(payload, 1, time.monotonic())
    found = stream.read(1.0)
    assert np.array_equal(found[0].image, expected)
    stream.close()
    assert not kernel.streaming


def test_rows_that_are_padded(plugged):
    kernel = plugged(formats=('GREY',), padding=16)
    stream = opened()
    kernel.fill(np.pad(GREY, ((0, 0), (0, 16))).tobytes(), 1, time.monotonic())
    assert np.array_equal(stream.read(1.0)[0].image, GREY)


def test_compressed_pictures_and_damaged_ones(plugged):
    kernel = plugged(formats=('MJPG',))
    smooth = np.tile(np.arange(64, dtype=np.uint8) * 3, (48, 1))
    jpeg = cv2.imencode('.jpg', smooth)[1].tobytes()
    stream = opened()
    kernel.fill(jpeg, 1, time.monotonic())
    assert np.abs(stream.read(1.0)[0].image.astype(int) - smooth).max() < 8
    kernel.fill(b'no jpeg', 2, time.monotonic())
    assert stream.read(0.1) is None
    kernel.fill(jpeg, 3, time.monotonic())
    assert stream.read(1.0)
    assert stream.lost == 1


def test_frames_that_are_short_broken_or_missing_are_counted(plugged):
    kernel = plugged(formats=('GREY',))
    stream = opened()
    for sequence, payload, flags in [
            (5, GREY, MONOTONIC), (6, GREY[:10], MONOTONIC), (7, GREY, MONOTONIC | BROKEN),
            (9, GREY, MONOTONIC)]:
        kernel.fill(payload.tobytes(), sequence, time.monotonic(), flags)
        stream.read(0.1)
    assert (stream.lost, stream.repeated) == (3, 0)


def test_stamps_are_the_buffers_own(plugged):
    kernel = plugged(formats=('GREY',))
    stream = opened()
    assert stream.format.clock is Clock.HOST
    exposed = time.monotonic() - 0.037
    kernel.fill(GREY.tobytes(), 1, exposed)
    assert stream.read(1.0)[1] == pytest.approx(exposed, abs=2e-6)


def test_a_stamp_at_the_end_of_a_frame_is_less_its_exposure(plugged):
    kernel = plugged(formats=('GREY',))
    stream = opened(exposure_ms=20.0)
    ended = time.monotonic() - 0.005
    kernel.fill(GREY.tobytes(), 1, ended, MONOTONIC)
    assert stream.read(1.0)[1] == pytest.approx(ended - 0.020, abs=2e-6)


def test_stamps_of_another_clock_are_mapped(plugged):
    kernel = plugged(formats=('GREY',))
    kernel.flags = 0
    stream = opened()
    assert stream.format.clock is Clock.DEVICE
    begin = time.monotonic()
    for k in range(3):
        kernel.fill((GREY + k).tobytes(), k + 1, 1.79e9 + 0.001 * k, 0)
    moments = [stream.read(1.0)[1] for _ in range(3)]
    assert begin <= moments[0] <= moments[1] <= moments[2] <= time.monotonic()


def test_settings_reach_the_device(plugged):
    kernel = plugged()
    kernel.sizes = [(64, 48), (32, 24)]
    stream = opened(width_px=32, height_px=24, exposure_ms=5.0, gain=33.0, frame_rate_hz=60.0,
                    pixel_format='GREY')
    assert (kernel.size, kernel.format, kernel.rate) == ((32, 24), 'GREY', (1, 60))
    assert kernel.controls[EXPOSURE_AUTO][0] == 1
    assert kernel.controls[EXPOSURE][0] == 50
    assert kernel.controls[GAIN][0] == 33
    form = stream.format
    assert (form.width, form.height, form.frame_rate, form.least_delay) == (32, 24, 60.0, 0.005)


def test_the_region_lies_where_it_is_asked(plugged):
    kernel = plugged(formats=('GREY',))
    kernel.crop = ()
    assert opened(offset_x_px=8, offset_y_px=4).format.offset == (8, 4)
    assert kernel.crop == (8, 4, 64, 48)


@pytest.mark.parametrize(('wanted', 'said'), [
    ({'width_px': 33}, 'does not support 33×48 YUYV; nearest is 64×48 YUYV'),
    ({'pixel_format': 'NV12'}, 'pixel_format must be one of YUYV, GREY, MJPG'),
    ({'exposure_ms': 5000.0}, 'exposure_ms must be 0.3 to 200 ms'),
    ({'gain': 65.0}, 'gain must be 0 to 64'),
    ({'frame_rate_hz': 400.0}, 'does not support 400 frames/s; nearest is 60'),
    ({'offset_x_px': 8}, 'offset_x_px cannot be set'),
    ({'trigger': 'Line1'}, 'trigger cannot be set'),
])
def test_what_it_cannot_do_is_refused(plugged, wanted, said):
    kernel = plugged()
    with pytest.raises(InputError, match=said):
        opened(**wanted)
    assert not kernel.streaming


def test_a_camera_that_is_pulled_out(plugged):
    kernel = plugged(formats=('GREY',))
    stream = opened()
    kernel.gone = True
    with pytest.raises(InputError, match='/dev/video0: stopped delivering frames'):
        stream.read(0.1)
    stream.close()


@pytest.mark.parametrize('source', ['/dev/video99', '99', '/dev/null', '/dev/nothing/here'])
def test_only_the_camera_that_was_asked_for_is_opened(source):
    with pytest.raises(InputError, match='expected a camera that delivers frames'):
        FrameStream(V4l2Camera(CameraSettings(source), pytest.fail))


def test_a_device_that_cannot_stream_is_none(plugged):
    kernel = plugged()
    kernel._querycap = lambda data: struct.pack_into('<2I', data, 84, 0x8420_0001, 0x1)
    with pytest.raises(InputError, match='not a camera that can stream'):
        opened()
