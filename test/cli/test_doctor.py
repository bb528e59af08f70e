"""`microbot doctor`: what it finds of a machine, without a graph."""

import os
import re
import threading
from unittest import mock

import cv2
import numpy as np
import psutil
import pytest
import yaml

from microbot_ros.cameras.camera import EndOfFrames
from microbot_ros.cli.rig import doctor
from microbot_ros.cli.rig.doctor import (
    _camera,
    _dead_man,
    _latency,
    _real_time,
    _rig,
    _watch_camera,
    _watchdog,
)
from microbot_ros.common.real_time import lateness
from microbot_ros.magnetics import CoilSettings


def test_whether_real_time_is_granted_is_said_and_not_kept(monkeypatch):
    def refused(*_):
        raise PermissionError

    before = os.sched_getscheduler(threading.get_native_id())
    assert _real_time().level in ('ok', 'warn')
    assert os.sched_getscheduler(threading.get_native_id()) == before
    monkeypatch.setattr(os, 'sched_setscheduler', refused)
    assert _real_time().level == 'warn'
    assert 'limits.conf' in _real_time().detail


def test_how_late_the_dead_man_may_be_is_measured_on_a_busy_machine(monkeypatch):
    monkeypatch.setattr(doctor, '_WATCH_SECONDS', 0.2)
    found = _dead_man()
    assert f'with {os.cpu_count()} busy programs, woke at most ' in found.detail
    assert not [child for child in psutil.Process().children() if 'while True' in child.cmdline()]
    monkeypatch.setattr(doctor, '_LATE_MS', 0.0)
    assert (_dead_man().level, 'expected 0 ms' in _dead_man().detail) == ('warn', True)


def test_lateness_is_what_comes_on_top_of_the_wait():
    late = lateness(0.1, 0.01)
    assert 0 < len(late) <= 10
    assert all(0.0 <= one < 10.0 for one in late)


@pytest.mark.parametrize(('coil_driver', 'level', 'sentence'), [
    ('amplifier: modbus', 'fail', 'modbus has no watchdog: if this computer loses its power'),
    ('{amplifier: scpi, accept_no_watchdog: true}', 'warn', 'scpi, accepted without a watchdog'),
    ('amplifier: roboclaw', 'ok', 'roboclaw: set in the device and read back'),
    ('port: /dev/null', 'ok', 'serial_transfer: in the firmware, if it has one'),
    ('accept_no_watchdog: true', 'warn', 'serial_transfer, accepted without a watchdog'),
    ('{amplifier: sabertooth, accept_no_feedback: true, port: "rfc2217://10.0.0.9:4000"}', 'fail',
     'sabertooth at rfc2217://10.0.0.9:4000: the sentinel cannot open'),
    ('{amplifier: sabertooth, accept_no_feedback: true, port: /dev/ttyUSB0}', 'warn',
     'sabertooth measures no currents'),
])
def test_what_a_missing_watchdog_means_is_said(tmp_path, coil_driver, level, sentence):
    rig = tmp_path / 'rig.yaml'
    parameters = coil_driver if coil_driver.startswith('{') else f'{{{coil_driver}}}'
    rig.write_text(f'coil_driver: {{ros__parameters: {parameters}}}\n')
    found = _watchdog(rig)
    assert found.level == level
    assert found.detail.startswith(sentence)


def test_whose_coils_a_rig_is_driven_by_is_said_and_that_they_can_be(tmp_path):
    coils, rig = tmp_path / 'coils.yaml', tmp_path / 'rig.yaml'
    rig.write_text(f'coil_driver:\n  ros__parameters:\n    coils_file: {coils}\n')
    section = CoilSettings().content('not none')
    coils.write_text(yaml.safe_dump({'coils': section}))
    assert (_rig(rig).level, _rig(rig).detail) == (
        'ok', f'{rig}: coil_driver; coils of {coils}: 4, for fields along xy')
    coils.write_text('coil: {}\n')
    assert (_rig(rig).level, _rig(rig).detail) == (
        'fail', f"{coils}:1: unknown key 'coil'; expected one of: axes, background_mT, windings, "
        'workspace_mm')
    coils.write_text('axes: xyz\n')
    assert _rig(rig).level == 'fail'
    assert _rig(rig).detail.endswith('these make no field along z (0.00, 0.00, 1.00)')
    coils.write_text('coils: {background_mT: [50, 0]}\n')
    assert _rig(rig).level == 'fail'
    assert _rig(rig).detail.startswith(f'{coils}: background_mT: expected a field that the coils')
    rig.write_text('coil_driver: {}\n')
    assert _rig(rig).detail.endswith('coils of the default rig, for there is no coils_file')


def test_the_frame_rate_is_that_of_the_stamps_and_two_frames_are_needed():
    """The first read times out; a stream that ends is no fault."""
    stream = mock.Mock()
    stream.read.side_effect = [None, (0, 7.0), (1, 7.02), (2, 7.05), EndOfFrames]
    assert _watch_camera(stream) == '40.0 frames/s'
    stream.read.side_effect = [(0, 7.0), EndOfFrames]
    assert _watch_camera(stream) == '1 frames in 1 s'


@pytest.fixture
def film(tmp_path):
    """Twenty pictures in a folder."""
    folder = tmp_path / 'film'
    folder.mkdir()
    for k in range(20):
        cv2.imwrite(str(folder / f'{k}.png'), np.zeros((48, 64), np.uint8))
    return folder


@pytest.fixture
def rig(tmp_path, film):
    """A rig whose camera shows the film at 100 Hz."""
    file = tmp_path / 'rig.yaml'
    file.write_text(yaml.safe_dump({'camera': {'ros__parameters': {
        'source': str(film), 'frame_rate_hz': 100}}}))
    return file


@pytest.mark.rig
def test_the_frame_rate_is_about_that_of_the_film(rig):
    assert 50 < float(re.search(r'([\d.]+) frames/s', _camera(rig).detail)[1]) < 150


def test_the_camera_is_opened_and_what_it_gives_is_said(rig, film, monkeypatch):
    monkeypatch.setattr(doctor, '_CAMERA_SECONDS', 60.0)  # the film ends before
    found = _camera(rig)
    assert found.level == 'ok'
    assert re.fullmatch(r'file \S+: 64×48 decoded to grey, [\d.]+ frames/s, 0 lost; '
                        r'clock: no clock: a frame is stamped on arrival', found.detail)
    (film / '7.png').write_bytes(b'')
    found = _camera(rig)
    assert (found.level, '1 lost' in found.detail) == ('warn', True)
    assert 'frame 7 cannot be decoded' in found.detail


@pytest.mark.parametrize(('parameters', 'said'), [
    ('source: /dev/video99', 'expected a camera that delivers frames'),
    ('camera: polaroid', 'expected one of aravis, file'),
    ('source: nowhere.mp4', 'not found'),
])
def test_a_camera_that_is_not_there_fails(tmp_path, parameters, said):
    rig = tmp_path / 'rig.yaml'
    rig.write_text(f'camera: {{ros__parameters: {{{parameters}}}}}\n')
    found = _camera(rig)
    assert (found.what, found.level) == ('camera', 'fail')
    assert said in found.detail


def test_a_rig_without_a_camera_is_none_the_worse(tmp_path):
    rig = tmp_path / 'rig.yaml'
    rig.write_text('model: {}\n')
    assert _camera(rig).level == 'ok'


def test_a_rig_without_nodes_is_none(tmp_path):
    (tmp_path / 'rig.yaml').write_text('# nothing yet\n')
    assert _rig(tmp_path / 'rig.yaml').level == 'fail'


def test_a_port_that_cannot_be_opened_was_not_checked(tmp_path):
    (tmp_path / 'rig.yaml').write_text(
        f'coil_driver:\n  ros__parameters:\n    port: {tmp_path}/none\n')
    found = _latency(tmp_path / 'rig.yaml')
    assert found.level == 'warn'
    assert found.detail.startswith(f'{tmp_path}/none: not checked, expected a serial port')
