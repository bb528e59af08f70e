"""What is published is recorded, and a recording is a session."""

from __future__ import annotations

import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml
from geometry_msgs.msg import PoseArray, Vector3Stamped
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from sensor_msgs.msg import Image, PointCloud2
from std_srvs.srv import SetBool

from microbot_ros.loop.points import PARTICLE
from microbot_ros.nodes.base import messages
from microbot_ros.nodes.client.parameter_collector import ParameterCollector
from microbot_ros.nodes.recorder import RecorderNode
from microbot_ros.nodes.replay import recorded_parameters
from microbot_ros.session import read_session
from microbot_ros.session.mcap.recording import Recording


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
    points = np.zeros(1, PARTICLE)
    begin = recorder.seconds()
    for k in range(20):
        stamp = messages.to_stamp(begin + k / 100)
        points['x'] = k * 1e-6
        outlets['particles'].publish(messages.cloud(points, stamp))
        outlets['field'].publish(messages.field_vector(np.array([1e-3, 0.0]), stamp))
        outlets['frames'].publish(messages.image(np.full((8, 8), k, np.uint8), stamp))
        graph.until(lambda k=k: recorder._seen_frames == k + 1)
    counts = recorder._writer.status
    graph.until(lambda: counts().counts.get('/particles') == 20
                and counts().counts.get('/field/command') == 20)
    recorder.trigger_deactivate()
    with Recording(folder) as recording:
        assert recording.complete
        assert recording.topics['/camera/image_raw'].count == 10
        assert recording.attachments()['rig.yaml'] == b'a: 1\n'
        assert recording.metadata()['recording']['title'] == 'a test'
    session = read_session(folder)
    assert session.tracks.position[:, 0] == pytest.approx(np.arange(20) * 1e-6, abs=1e-12)
    assert session.tracks.t - session.tracks.t[0] == pytest.approx(np.arange(20) / 100, abs=1e-6)
    assert (session.commands.field == [1e-3, 0.0]).all()


@pytest.mark.parametrize('height', [{}, {'height_um': 1.8}])
def test_the_conditions_that_the_model_knows_are_in_the_recording(
        ros: Any, tmp_path: Path, height: dict[str, float]) -> None:
    folder = tmp_path / 'recording'
    graph = ros({'recorder': {'folder': str(folder)},
                 'model': {'radius_um': 1.5, 'viscosity_mPa_s': 0.9, **height}})
    assert graph.add('model').active
    recorder = graph.add('recorder')
    particles = graph.probe.create_publisher(PointCloud2, 'particles', 10)
    graph.until(lambda: 'model' in recorder._collector.answered)
    graph.until(lambda: particles.get_subscription_count() == 2)
    particles.publish(messages.cloud(
        np.zeros(1, PARTICLE), messages.to_stamp(recorder.seconds())))
    graph.until(lambda: recorder._writer.status().counts.get('/particles'))
    recorder.trigger_deactivate()
    conditions = read_session(folder).conditions
    assert conditions.radius == pytest.approx(1.5e-6)
    assert conditions.viscosity == pytest.approx(0.9e-3)
    assert conditions.height == (pytest.approx(1.8e-6) if height else None)


def test_every_parameter_and_the_files_that_they_name_are_kept(ros: Any, tmp_path: Path) -> None:
    folder, first, other = tmp_path / 'recording', tmp_path / 'a.yaml', tmp_path / 'b.yaml'
    first.write_text('reference_field_mT: 5\n')
    other.write_text('reference_field_mT: 4\n')
    graph = ros({'recorder': {'folder': str(folder)},
                 'model': {'radius_um': 1.5, 'model_file': str(first)}})
    recorder = graph.add('recorder')
    graph.add('model')
    graph.until(lambda: recorder._collector.answered == {'model', 'recorder'})
    change = Parameter('model_file', value=str(other)).to_parameter_msg()
    graph.call(SetParameters, 'model/set_parameters', SetParameters.Request(parameters=[change]))
    graph.until(lambda: str(other) in recorder._kept)
    recorder.trigger_deactivate()
    with Recording(folder) as recording:
        kept = recording.attachments()
        values = yaml.safe_load(kept['parameters/model.yaml'])['model']['ros__parameters']
        assert values['radius_um'] == 1.5
        assert values['model_file'] == str(first)
        assert kept[str(first)] == first.read_bytes()
        assert kept[str(other)] == other.read_bytes()
        parameters = recorded_parameters(recording, ['model'], tmp_path)
        about = recording.metadata()
    # What was recorded starts a node again, from the files as they were.
    file = Path(parameters['model'].pop('model_file'))
    assert file.read_bytes() == first.read_bytes()
    assert file != first
    assert {'microbot_ros', 'numpy', 'python'} <= set(about['versions'])
    for name in ('clocks', 'clocks at the end'):
        ros_time = time.monotonic_ns() + int(about[name]['ros_minus_monotonic_ns'])
        assert ros_time == pytest.approx(time.time_ns(), abs=10**9)


def test_each_recording_holds_the_parameters_of_its_time_whatever_the_list_of_nodes(
        ros: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(RecorderNode, 'get_node_names_and_namespaces', lambda _: [])
    graph = ros({'recorder': {'recording': False}})
    recorder = graph.add('recorder')
    graph.add('model')
    clients: list[Any] = []
    for name in 'first', 'second':
        graph.call(SetParameters, 'recorder/set_parameters', SetParameters.Request(parameters=[
            Parameter('folder', value=str(tmp_path / name)).to_parameter_msg()]))
        assert graph.call(SetBool, 'recorder/record', SetBool.Request(data=True)).success
        graph.until(lambda: recorder._collector.answered == {'model', 'recorder'})
        assert recorder.health()[2]['parameters_of'] == 'model recorder'
        recorder.trigger_deactivate()
        recorder.trigger_activate()
        with Recording(tmp_path / name) as recording:
            kept = recorded_parameters(recording, ['model', 'recorder'], tmp_path)
        assert kept['recorder']['folder'] == str(tmp_path / name)
        assert 'radius_um' in kept['model']
        clients.append(dict(recorder._collector._clients))
    assert clients[0].items() <= clients[1].items()


def test_an_answer_to_a_question_of_an_earlier_recording_is_not_kept() -> None:
    told: list[str] = []
    collector = ParameterCollector(SimpleNamespace(), lambda node, _: told.append(node))
    earlier = collector._again
    earlier['model'] = 0.0
    collector.begin()
    collector._answered(earlier, 'model', [], [])
    assert told == []
    assert collector.answered == set()


def test_a_service_begins_and_ends_recordings_with_title_and_notes(
        ros: Any, tmp_path: Path) -> None:
    graph = ros({'recorder': {'recording': False, 'topics': ['goals']}})
    recorder = graph.add('recorder')
    assert recorder.health()[1] == 'not recording'
    goals = graph.talk(PoseArray, 'goals')

    def tell(**values: Any) -> None:
        graph.call(SetParameters, 'recorder/set_parameters', SetParameters.Request(parameters=[
            Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]))

    def record(data: bool) -> Any:
        return graph.call(SetBool, 'recorder/record', SetBool.Request(data=data))
    goals.publish(PoseArray())
    assert record(False).message == 'not recording'
    for k in (1, 2):
        tell(folder=str(tmp_path / str(k)), title=f'run {k}', notes='fresh peroxide')
        answer = record(True)
        assert answer.success
        assert answer.message == f'recording to {tmp_path / str(k)}'
        assert not record(True).success
        for _ in range(k):
            goals.publish(PoseArray())
        graph.until(lambda k=k: recorder._writer.status().counts.get('/goals') == k)
        assert record(False).message == f'recorded {tmp_path / str(k)}'
        with Recording(tmp_path / str(k)) as recording:
            assert recording.complete
            assert recording.topics['/goals'].count == k
            assert recording.metadata()['recording'] == {
                'title': f'run {k}', 'notes': 'fresh peroxide'}
    refused = record(True)
    assert not refused.success
    assert 'expected a new or empty folder' in refused.message


@pytest.mark.parametrize(('parameters', 'expected'), [
    ({'attachments': ['/nowhere.yaml']}, '/nowhere.yaml: expected a file to attach'),
    ({'folder': 'FILE'}, 'expected'),
    ({'topics': ['steam']}, 'no topic steam to record'),
])
def test_what_cannot_be_recorded_is_one_clear_line(
        ros: Any, tmp_path: Path, parameters: dict[str, Any], expected: str) -> None:
    (tmp_path / 'file').write_text('')
    parameters = {k: str(tmp_path / 'file') if v == 'FILE' else v for k, v in parameters.items()}
    node = ros({'recorder': parameters}).add('recorder')
    assert not node.active
    assert expected in node.fault
    assert '\n' not in node.fault
