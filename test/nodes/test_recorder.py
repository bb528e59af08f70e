"""What is published is recorded, and a recording is a session."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import Vector3Stamped
from sensor_msgs.msg import Image, PointCloud2

from microbot_ros.nodes import messages
from microbot_ros.session import open_recording, read_session


def test_tracks_commands_and_every_second_frame(ros: Any, tmp_path: Path) -> None:
    note = tmp_path / 'rig.yaml'
    note.write_text('a: 1\n')
    folder = tmp_path / 'recording'
    graph = ros({'recorder': {'folder': str(folder), 'frame_every': 2, 'title': 'a test',
                              'attachments': [str(note)]}})
    recorder = graph.add('recorder')
    assert recorder.active, recorder.fault
    probe = graph.probe
    outlets = {
        'particles': probe.create_publisher(PointCloud2, 'particles', 10),
        'field': probe.create_publisher(Vector3Stamped, 'field/command', 10),
        'frames': probe.create_publisher(Image, 'camera/image_raw', 10)}
    graph.until(lambda: all(o.get_subscription_count() == 1 for o in outlets.values()))
    points = np.zeros(1, messages.PARTICLE)
    begin = recorder.seconds()
    for k in range(20):
        stamp = messages.to_stamp(begin + k / 100)
        points['x'] = k * 1e-6
        outlets['particles'].publish(messages.cloud(points, stamp))
        outlets['field'].publish(messages.field_vector(np.array([1e-3, 0.0]), stamp))
        outlets['frames'].publish(messages.image(np.full((8, 8), k, np.uint8), stamp))

        def counted(k: int = k) -> bool:
            counts = recorder._writer.status().counts
            return bool(counts.get('/particles') == counts.get('/field/command') == k + 1
                        and counts.get('/camera/image_raw', 0) == (k + 1) // 2)
        graph.until(counted)
    recorder.trigger_deactivate()
    with open_recording(folder) as recording:
        assert recording.complete
        assert recording.topics['/camera/image_raw'].count == 10
        assert recording.attachments()['rig.yaml'] == b'a: 1\n'
        assert recording.metadata()['recording']['title'] == 'a test'
    session = read_session(folder)
    assert session.tracks.position[:, 0] == pytest.approx(np.arange(20) * 1e-6, abs=1e-12)
    assert session.tracks.t - session.tracks.t[0] == pytest.approx(np.arange(20) / 100, abs=1e-6)
    assert (session.commands.field == [1e-3, 0.0]).all()


def test_the_conditions_that_the_model_knows_are_in_the_recording(
        ros: Any, tmp_path: Path) -> None:
    folder = tmp_path / 'recording'
    graph = ros({'recorder': {'folder': str(folder)},
                 'model': {'radius_um': 1.5, 'viscosity_mPa_s': 0.9}})
    assert graph.add('model').active
    recorder = graph.add('recorder')
    particles = graph.probe.create_publisher(PointCloud2, 'particles', 10)
    graph.until(lambda: 'model' in recorder._snapshot.answered)
    graph.until(lambda: particles.get_subscription_count() == 2)
    particles.publish(messages.cloud(
        np.zeros(1, messages.PARTICLE), messages.to_stamp(recorder.seconds())))
    graph.until(lambda: recorder._writer.status().counts.get('/particles'))
    recorder.trigger_deactivate()
    conditions = read_session(folder).conditions
    assert conditions.radius == pytest.approx(1.5e-6)
    assert conditions.viscosity == pytest.approx(0.9e-3)


@pytest.mark.parametrize(('parameters', 'expected'), [
    ({'attachments': ['/nowhere.yaml']}, '/nowhere.yaml: expected a file to attach'),
    ({'folder': 'FILE'}, 'expected'),
])
def test_what_cannot_be_recorded_is_one_clear_line(
        ros: Any, tmp_path: Path, parameters: dict[str, Any], expected: str) -> None:
    (tmp_path / 'file').write_text('')
    parameters = {k: str(tmp_path / 'file') if v == 'FILE' else v for k, v in parameters.items()}
    node = ros({'recorder': parameters}).add('recorder')
    assert not node.active
    assert expected in node.fault
    assert '\n' not in node.fault
