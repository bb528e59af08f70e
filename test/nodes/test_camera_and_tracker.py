"""From a source of frames to particles with identities, with everything a camera can do wrong."""

from __future__ import annotations

import math
import threading
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from command_line import microbot
from diagnostic_msgs.msg import DiagnosticStatus
from films import HEADING, PLACE, film
from geometry_msgs.msg import Point, PointStamped, TwistStamped, Vector3Stamped
from rclpy.parameter import Parameter
from schemas import conforming
from sensor_msgs.msg import Image, MagneticField, PointCloud2
from std_msgs.msg import Header, String

from microbot_ros.loop.points import PARTICLE
from microbot_ros.nodes.base import messages
from microbot_ros.nodes.base.lifecycle import IMAGES_IN, LATCHED
from microbot_ros.virtual_rig.microscope import Microscope, MicroscopeSettings


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder of 40 pictures."""
    return film(tmp_path / 'film', 40)


def filmed(ros: Any, folder: Path) -> tuple[Any, list[PointCloud2]]:
    """A graph whose camera plays the film in a loop, and the particles that are found in it."""
    graph = ros({'camera': {'source': str(folder), 'frame_rate_hz': 60, 'loop': True},
                 'tracker': {'pixel_size_um': 0.45}})
    particles = graph.hear(PointCloud2, 'particles')
    assert graph.add('tracker').active
    assert graph.add('camera').active, graph.nodes['camera'].fault
    return graph, particles


def test_frames_become_particles_where_they_are(ros: Any, folder: Path) -> None:
    graph, particles = filmed(ros, folder)

    def all_found() -> bool:
        return bool(particles) and particles[-1].width == len(PLACE)
    graph.until(all_found)
    points = messages.points(particles[-1], PARTICLE)
    found = np.stack([points['x'], points['y']], axis=1)
    assert np.abs(np.sort(found, axis=0) - np.sort(PLACE, axis=0)).max() < 0.5e-6
    assert (points['sigma'] > 0).all()
    assert len(set(points['id'].tolist())) == len(PLACE)


def test_what_is_pointed_at_is_followed_and_its_name_reaches_who_comes_later(
        ros: Any, folder: Path) -> None:
    graph, particles = filmed(ros, folder)
    graph.until(lambda: bool(particles))
    taught = graph.hear(DiagnosticStatus, 'tracker/taught', LATCHED)

    examples = graph.talk(PointStamped, 'tracker/like')

    def point(frame_id: str, x: float, y: float) -> DiagnosticStatus:
        before = len(taught)
        examples.publish(PointStamped(
            header=Header(frame_id=frame_id), point=Point(x=float(x), y=float(y))))
        graph.until(lambda: len(taught) > before)
        return taught[-1]
    for frame_id, x, y, reason in (
            ('camera_pixels', 5.0, 5.0, 'nothing is visible'),
            ('camera', 1.0, 1.0, 'expected the frame'),
            ('camera_pixels', math.nan, 5.0, 'expected finite coordinates'),
            ('workspace', math.inf, 0.0, 'expected finite coordinates')):
        nothing = point(frame_id, x, y)
        assert nothing.level == DiagnosticStatus.WARN
        assert reason in nothing.message
    x, y = PLACE[1] / 0.45e-6 * [1, -1] + [319.5, 239.5]
    graph.nodes['tracker'].set_parameters([Parameter('example_kind', value='swimmer')])
    answer = point('camera_pixels', round(x), round(y))
    assert answer.level == DiagnosticStatus.OK, answer.message
    assert {value.key: value.value for value in answer.values}['example'] == 'like'
    graph.until(lambda: particles[-1].fields[-1].name == 'kind' and particles[-1].width > 0)
    kinds = graph.hear(String, 'tracker/kinds', LATCHED)
    graph.until(lambda: bool(kinds))
    points = messages.points(particles[-1], np.dtype([('kind', '<f4')]))
    assert [conforming('tracker/kinds', kinds[-1].data)[int(kind)] for kind in points['kind']] == (
        ['swimmer'] * particles[-1].width)


def _beads(seed: int) -> np.ndarray:
    """Red and green discs, as bright as the light around them: (200, 320, 3), red first."""
    v, u = np.mgrid[:200, :320]
    picture = np.tile([145.0, 150.0, 140.0], (200, 320, 1))
    for x, y, colour in ((60, 50, (197, 130, 107)), (250, 150, (99, 177, 118))):
        covered = 1 / (1 + np.exp((np.hypot(u - x, v - y) - 7) / 0.8))
        picture += covered[..., None] * (np.array(colour) - picture)
    noise = np.random.default_rng(seed).normal(0, 2, picture.shape)
    return np.clip(np.rint(picture + noise), 0, 255).astype(np.uint8)


def test_kinds_that_were_learned_by_colour_are_followed_in_colour(
        ros: Any, tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / 'beads.png'), _beads(0)[..., ::-1])
    assert microbot('track', tmp_path / 'beads.png', '--out', tmp_path / 'out', '--no-overlay',
                    '--like', '0,60,50,red', '--like', '0,250,150,green') == 0
    graph = ros({'tracker': {'settings_file': str(tmp_path / 'out' / 'learned.yaml')}})
    tracker = graph.add('tracker')
    assert tracker.active, tracker.fault
    publisher = graph.talk(Image, 'camera/image_raw')
    particles, begin = graph.hear(PointCloud2, 'particles'), tracker.seconds()

    def came(count: int) -> bool:
        return len(particles) == count

    for k in range(1, 6):
        stamp = messages.to_stamp(begin + k / 30)
        publisher.publish(messages.image(_beads(k), stamp, encoding='rgb8'))
        graph.until(partial(came, k))
    seen = messages.points(particles[-1], np.dtype([('x', '<f4'), ('kind', '<f4')]))
    names = {tracker.stage.kinds[int(kind)]: x for x, kind in seen.tolist()}
    assert names == pytest.approx({'red': -49.75e-6, 'green': 45.25e-6}, abs=0.1e-6)


def test_frames_go_on_while_the_tracker_is_taught(
        ros: Any, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    graph, particles = filmed(ros, folder)
    tracker = graph.nodes['tracker']
    graph.until(lambda: bool(particles))
    begun, seen = threading.Event(), threading.Event()

    def slowly(*_: Any) -> str:
        begun.set()
        assert seen.wait(60)
        return 'learned'
    monkeypatch.setattr(tracker.stage, 'teach', slowly)
    taught = graph.hear(DiagnosticStatus, 'tracker/taught', LATCHED)
    examples = graph.talk(PointStamped, 'tracker/like')
    examples.publish(PointStamped(header=Header(frame_id='camera_pixels')))
    graph.until(begun.is_set)
    before = len(particles)
    graph.until(lambda: len(particles) >= before + 10)
    assert not taught
    seen.set()
    graph.until(lambda: bool(taught))
    assert taught[-1].message == 'learned'


def test_a_film_that_ends_is_said_and_all_frames_came(ros: Any, folder: Path) -> None:
    graph = ros({'camera': {'source': str(folder), 'frame_rate_hz': 200.0}})
    frames = graph.hear(Image, 'camera/image_raw', IMAGES_IN)
    camera = graph.add('camera')
    graph.until(lambda: 'ended after 40 frames' in camera.health()[1])
    graph.until(lambda: len(frames) >= 35)  # discovery may cost the first
    stamps = [messages.to_seconds(frame.header.stamp) for frame in frames]
    assert (np.diff(stamps) > 0).all()
    assert messages.gray(frames[-1]).shape == (480, 640)


def test_pictures_that_cannot_be_read_are_left_out_and_said(ros: Any, folder: Path) -> None:
    (folder / '005.png').write_bytes(b'')
    (folder / '006.png').write_bytes((folder / '007.png').read_bytes()[:300])
    graph = ros({'camera': {'source': str(folder), 'frame_rate_hz': 500.0}})
    camera = graph.add('camera')
    graph.until(lambda: 'ended after 38 frames' in camera.health()[1])
    assert camera.health()[2]['frames_lost'] == 2


@pytest.mark.parametrize(('source', 'more', 'expected'), [
    ('', {}, 'expected the parameter source'),
    ('/nowhere/film.mp4', {}, '/nowhere/film.mp4'),
    ('/dev/video99', {'exposure_ms': 3.0}, 'expected a camera that delivers frames'),
    ('EMPTY', {}, 'no frame'),
    ('FOLDER', {}, 'expected images'),
    ('FILM', {'gain': 3.0}, 'gain cannot be set'),
    ('x', {'camera': 'polaroid'}, 'expected one of aravis, file'),
])
def test_no_source_no_camera_and_no_other_one(
        ros: Any, folder: Path, source: str, more: dict[str, Any], expected: str) -> None:
    empty, none = folder.with_name('empty.mp4'), folder.with_name('folder')
    empty.write_bytes(b'')
    none.mkdir()
    source = {'EMPTY': str(empty), 'FOLDER': str(none), 'FILM': str(folder)}.get(source, source)
    node = ros({'camera': {'source': source, **more}}).add('camera')
    assert not node.active
    assert expected in node.fault
    assert '\n' not in node.fault


@pytest.mark.parametrize('broken', ['size', 'encoding', 'short', 'stamp'])
def test_a_wrong_frame_in_mid_stream_is_reported_and_passed_over(ros: Any, broken: str) -> None:
    graph = ros({'tracker': {'pixel_size_um': 0.45}})
    tracker = graph.add('tracker')
    assert tracker.active, tracker.fault
    publisher = graph.talk(Image, 'camera/image_raw')
    particles = graph.hear(PointCloud2, 'particles')
    scope = Microscope(MicroscopeSettings(), seed=3)
    begin = tracker.seconds()

    def frame(k: int, height: int = 480) -> Image:
        picture = scope.render(PLACE, HEADING, k / 30)[:height]
        return messages.image(picture, messages.to_stamp(begin + k / 30))

    def seen() -> list[int]:
        return sorted(messages.points(particles[-1], PARTICLE)['id'].tolist())

    def answered(frames: int) -> bool:
        return bool(len(particles) == tracker.stage.frames == frames)

    k = 0
    while not (particles and len(seen()) == 3):
        publisher.publish(frame(k))
        k += 1
        graph.until(partial(answered, k))
        assert k < 200
    ids = seen()
    wrong = frame(k if broken != 'stamp' else 3, 200 if broken == 'size' else 480)
    if broken == 'encoding':
        wrong.encoding = 'yuv422'
    elif broken == 'short':
        wrong.data = wrong.data[:1000]
    publisher.publish(wrong)
    graph.until(lambda: tracker._complaint)
    publisher.publish(frame(k + 1))
    graph.until(partial(answered, k + 1))
    assert seen() == ids


def test_who_goes_unseen_is_carried_on_the_way_the_field_now_points(ros: Any) -> None:
    """Learned while the field turned; hidden while it turns once more."""
    graph = ros({'tracker': {'pixel_size_um': 0.45}})
    tracker = graph.add('tracker')
    images = graph.probe.create_publisher(Image, 'camera/image_raw', 10)
    fields = graph.probe.create_publisher(MagneticField, 'field/applied', 10)
    particles = graph.hear(PointCloud2, 'particles')
    graph.until(lambda: images.get_subscription_count() == fields.get_subscription_count() == 1)
    scope = Microscope(MicroscopeSettings(), seed=3)
    begin, step = tracker.seconds(), 0.8e-6
    place, angle = PLACE.copy(), 0.0

    def answered(frames: int) -> bool:
        return bool(len(particles) == tracker.stage.frames == frames)

    for k in range(90):
        if k == 85 or (k % 12 == 0 and k < 80):
            angle += np.pi if k == 85 else 2.0
            field = np.array([np.cos(angle), np.sin(angle)]) * 5e-3
            stamp = messages.to_stamp(begin + (k - 0.99) / 30)
            known = len(tracker.stage._drive._commands)
            fields.publish(messages.magnetic_field(field, stamp))
            graph.until(lambda known=known: len(tracker.stage._drive._commands) > known)
        place = place + step * np.array([np.cos(angle), np.sin(angle)])
        shown = place if k < 85 else place[:0]
        picture = scope.render(shown, np.full(len(shown), angle), k / 30)
        images.publish(messages.image(picture, messages.to_stamp(begin + k / 30)))
        graph.until(partial(answered, k + 1))
    points = messages.points(particles[-1], PARTICLE)
    assert len(points) == len(PLACE)
    found = np.stack([points['x'], points['y']], axis=1)
    away = np.linalg.norm(found[:, None] - place, axis=2).min(axis=1)
    assert away.max() < 1.5e-6  # by constant velocity they would be 8 µm off
    assert (points['sigma'] > 0.1e-6).all()


@pytest.mark.parametrize(('source', 'kind'), [
    ('applied', MagneticField), ('command', Vector3Stamped), ('rotation', TwistStamped)])
def test_a_field_in_another_frame_turns_nothing(ros: Any, source: str, kind: type) -> None:
    graph = ros({'tracker': {'field_source': source}})
    tracker = graph.add('tracker')
    topic = 'field/rotating' if source == 'rotation' else f'field/{source}'
    sent = graph.talk(kind, topic)
    message = kind()
    message.header.frame_id = 'camera'
    sent.publish(message)
    graph.until(lambda: "expected the frame 'workspace'; received 'camera'"
                in tracker._complaint)


def test_a_camera_that_is_gone_is_said_whatever_its_clock_said(ros: Any) -> None:
    """A last frame stamped an hour ahead would look fresh for an hour."""
    graph = ros({'tracker': {}})
    tracker = graph.add('tracker')
    frames = graph.talk(Image, 'camera/image_raw')
    picture = MicroscopeSettings()
    image = np.zeros((picture.height_px, picture.width_px), np.uint8)
    frames.publish(messages.image(image, messages.to_stamp(tracker.seconds() + 3600.0)))
    graph.until(lambda: tracker.health()[2]['frames'] == 1)
    graph.until(lambda: tracker.health()[1] == 'no frames on camera/image_raw for 1 s')
