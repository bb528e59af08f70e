"""The recorder: what it writes, other readers read; what it cannot write, it says."""

import subprocess
import sys
import threading
from pathlib import Path

import pytest
from mcap.reader import make_reader
from recordings import IMAGE, VECTOR, image, vector
from rosbags.highlevel import AnyReader

from microbot_ros.common.errors import InputError
from microbot_ros.session.mcap import recorder, store
from microbot_ros.session.mcap.recorder import RecordingWriter
from microbot_ros.session.mcap.recording import Recording
from microbot_ros.session.mcap.store import MIB
from microbot_ros.session.mcap.writer import McapWriter

MS = 1_000_000
DATA = Path(__file__).parents[1] / 'data'


def fill(writer: RecordingWriter, frames: int = 50) -> dict[str, int]:
    """Frames, overlays and commands at 10 ms; how many of each."""
    for i in range(frames):
        t_ns = 10**9 + i * 10 * MS
        writer.write('/camera/image_raw', IMAGE, t_ns, image(t_ns))
        writer.write('/overlay/image_raw', IMAGE, t_ns + MS, image(t_ns))
        writer.write('/field/command', VECTOR, t_ns + 2 * MS, vector(t_ns, i, -i))
    return dict.fromkeys(['/camera/image_raw', '/overlay/image_raw', '/field/command'], frames)


def test_the_mcap_package_reads_every_message_attachment_and_key(tmp_path):
    with RecordingWriter(tmp_path / 'run') as writer:
        expected = fill(writer)
        writer.attach('rig.yaml', 'coils: 4\n')
        writer.attach('blob', b'\x00\x01')
        writer.describe('versions', {'microbot_ros': '1'})
    assert writer.status().counts == expected
    assert writer.status().dropped == {}
    assert writer.status().problem == ''
    with (tmp_path / 'run' / 'run_0.mcap').open('rb') as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == 'ros2'
        found = list(reader.iter_messages())
        assert len(found) == 150
        assert [m.log_time for _, _, m in found] == sorted(m.log_time for _, _, m in found)
        schema, channel, message = found[2]
        assert (schema.name, channel.topic) == (VECTOR, '/field/command')
        assert message.data == vector(10**9, 0, 0)
        assert {a.name: a.data for a in reader.iter_attachments()} == {
            'rig.yaml': b'coils: 4\n', 'blob': b'\x00\x01'}
        assert [(m.name, m.metadata) for m in reader.iter_metadata()] == [
            ('versions', {'microbot_ros': '1'})]


def test_rosbags_reads_the_folder_as_a_rosbag2_recording(tmp_path):
    with RecordingWriter(tmp_path / 'run') as writer:
        expected = fill(writer)
    with AnyReader([tmp_path / 'run']) as reader:
        assert {c.topic: c.msgcount for c in reader.connections} == expected
        assert (reader.start_time, reader.end_time) == (10**9, 10**9 + 492 * MS + 1)
        vectors = [c for c in reader.connections if c.msgtype == VECTOR]
        values = [
            reader.deserialize(data, c.msgtype).vector.x
            for c, _, data in reader.messages(connections=vectors)
        ]
        assert values == list(range(50))


def test_metadata_is_that_of_rosbag2_byte_for_byte(tmp_path):
    """With the keys of rosbag2's own test recordings (rosbag2_tests/resources/mcap). Since version
    9 `offered_qos_profiles` is a list; before, a string.
    """
    with RecordingWriter(tmp_path / 'run') as writer:
        for i in range(3):
            writer.write('/field/command', VECTOR, 10**9 + i * 10 * MS, vector(10**9, i, 0))
    written = (tmp_path / 'run' / 'metadata.yaml').read_bytes()
    assert written == (DATA / 'rosbag2_metadata.yaml').read_bytes()


def test_frames_overlays_and_data_never_share_a_chunk(tmp_path):
    with RecordingWriter(tmp_path / 'run') as writer:
        fill(writer)
    with (tmp_path / 'run' / 'run_0.mcap').open('rb') as file:
        chunks = make_reader(file).get_summary().chunk_indexes
        assert all(len(chunk.message_index_offsets) == 1 for chunk in chunks)


def test_segments_roll_by_size_and_read_as_one(tmp_path, monkeypatch):
    monkeypatch.setattr(store, 'SEGMENT_BYTES', 20_000)
    monkeypatch.setattr(store, 'FLUSH_SECONDS', 0.0)
    rolled = threading.Event()
    grow = store.Store._next_segment
    monkeypatch.setattr(store.Store, '_next_segment', lambda self: (grow(self), (
        rolled.set() if len(self._writers) == 3 else None)))
    with RecordingWriter(tmp_path / 'run') as writer:
        i = 0
        while not rolled.is_set():
            i += 1
            writer.write('/camera/image_raw', IMAGE, i * MS, image(i))
            rolled.wait(0.002)
    assert len(list((tmp_path / 'run').glob('run_*.mcap'))) >= 3
    with Recording(tmp_path / 'run') as recording:
        assert recording.complete
        assert [m.t_ns // MS for m in recording.messages()] == list(range(1, i + 1))
    with AnyReader([tmp_path / 'run']) as reader:
        assert reader.message_count == i


def test_a_nearly_full_disk_costs_overlays_then_frames_and_no_command(tmp_path, monkeypatch):
    for free, lost in ((2048, []), (600, ['/overlay/image_raw']),
                       (100, ['/camera/image_raw', '/overlay/image_raw'])):
        usage = type('Usage', (), {'free': free * MIB})
        monkeypatch.setattr(store.shutil, 'disk_usage', lambda _, usage=usage: usage)
        with RecordingWriter(tmp_path / str(free)) as writer:
            expected = fill(writer)
        status = writer.status()
        assert sorted(status.dropped) == lost
        assert all(status.dropped[topic] == expected[topic] for topic in lost)
        assert status.counts == {k: n for k, n in expected.items() if k not in lost}
        assert bool(status.problem) == bool(lost)
        with Recording(tmp_path / str(free)) as recording:
            kept = recording.metadata().get('dropped', {})
            assert kept == {topic: str(expected[topic]) for topic in lost}


def test_a_slow_disk_costs_overlays_first_and_no_command(tmp_path, monkeypatch):
    monkeypatch.setattr(recorder, 'MOST_QUEUED', {
        store.Priority.OVERLAY: 20_000, store.Priority.FRAME: 100_000, store.Priority.DATA: 10**9})
    monkeypatch.setattr(store, 'FLUSH_SECONDS', 0.0)
    stuck, freed = threading.Event(), threading.Event()
    write = McapWriter.add_chunk

    def slowly(self, closed):
        stuck.set()
        assert freed.wait(60)
        write(self, closed)

    monkeypatch.setattr(McapWriter, 'add_chunk', slowly)
    with RecordingWriter(tmp_path / 'run') as writer:
        writer.write('/field/command', VECTOR, 1, vector(1, 0, 0))
        assert stuck.wait(60)
        fill(writer)
        status = writer.status()
        freed.set()
    assert status.dropped['/overlay/image_raw'] > status.dropped['/camera/image_raw'] > 0
    assert 'slow' in status.problem
    assert '/field/command' not in status.dropped
    assert writer.status().counts['/field/command'] == 51


FULL_DISK = """
import resource, signal, sys
sys.path.insert(0, sys.argv[2])
from recordings import IMAGE, VECTOR, image, vector
from microbot_ros.session.mcap import store
from microbot_ros.session.mcap.recorder import RecordingWriter

store.FLUSH_SECONDS = 0.0
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
hard = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
with RecordingWriter(sys.argv[1]) as writer:
    resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, hard))
    i = 0
    while '/camera/image_raw' not in writer.status().dropped:
        i += 1
        writer.write('/camera/image_raw', IMAGE, i * 1000, image(i))
        writer.write('/field/command', VECTOR, i * 1000 + 1, vector(i, i, 0))
    assert 'camera/image_raw' in writer.status().problem, writer.status()
    resource.setrlimit(resource.RLIMIT_FSIZE, (hard, hard))
status = writer.status()
assert status.counts['/field/command'] == i, status
assert status.counts['/camera/image_raw'] + status.dropped['/camera/image_raw'] == i, status
print(i)
"""


def test_a_full_disk_costs_frames_and_keeps_commands_until_it_has_room(tmp_path):
    program = [sys.executable, '-B', '-c', FULL_DISK, tmp_path / 'run', Path(__file__).parent]
    result = subprocess.run(program, capture_output=True, text=True, timeout=100)
    assert result.returncode == 0, result.stderr
    with Recording(tmp_path / 'run') as recording:
        sent = [m.t_ns // 1000 for m in recording.messages(['/field/command'])]
        assert sent == list(range(1, int(result.stdout) + 1))


def test_a_disk_that_stays_full_leaves_a_readable_recording_and_says_so(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, 'No space left on device')

    with RecordingWriter(tmp_path / 'run') as writer:
        monkeypatch.setattr(McapWriter, '_append', full)
        expected = fill(writer, 3)
    assert 'No space left' in writer.status().problem
    assert writer.status().dropped == expected
    with Recording(tmp_path / 'run') as recording:
        assert not recording.complete
        assert recording.topics == {}


def test_a_disk_that_stays_full_costs_data_only_when_memory_is_full_too(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, 'No space left on device')

    monkeypatch.setattr(recorder, 'MOST_QUEUED', {
        store.Priority.OVERLAY: 2_000, store.Priority.FRAME: 4_000, store.Priority.DATA: 8_000})
    monkeypatch.setattr(store, 'FLUSH_SECONDS', 0.0)
    with RecordingWriter(tmp_path / 'run') as writer:
        write, lost_first = McapWriter._append, []
        monkeypatch.setattr(McapWriter, '_append', full)
        sent = 0
        while '/field/command' not in writer.status().dropped:
            sent += 1
            lost_first += [t for t in writer.status().dropped if t not in lost_first]
            for topic, kind, data in (('/overlay/image_raw', IMAGE, image(sent)),
                                      ('/camera/image_raw', IMAGE, image(sent)),
                                      ('/field/command', VECTOR, vector(sent, sent, 0))):
                writer.write(topic, kind, sent * MS, data)
        status = writer.status()
        assert status.queued_bytes <= 8_000 + 2 * len(image(0))
        assert '1 of /field/command' in status.problem
        monkeypatch.setattr(McapWriter, '_append', write)
    assert '/field/command' not in lost_first
    status = writer.status()
    assert status.counts['/field/command'] == sent - 1
    assert status.dropped['/field/command'] == 1
    with Recording(tmp_path / 'run') as recording:
        assert recording.metadata()['dropped']['/field/command'] == '1'


@pytest.mark.filterwarnings('ignore::pytest.PytestUnhandledThreadExceptionWarning')
def test_a_recorder_that_failed_counts_all_it_loses_and_says_why(tmp_path, monkeypatch):
    failed = threading.Event()

    def fail(*_):
        failed.set()
        raise FileNotFoundError('the disk is gone')

    monkeypatch.setattr(store.Store, 'tick', fail)
    with RecordingWriter(tmp_path / 'run') as writer:
        assert failed.wait(60)
        writer._thread.join(60)
        writer.write('/field/command', VECTOR, 1, vector(1, 0, 0))
        assert writer.status().dropped == {'/field/command': 1}
        assert 'the disk is gone' in writer.status().problem


def test_a_new_segment_that_the_disk_refuses_leaves_the_old_one_in_use(tmp_path, monkeypatch):
    monkeypatch.setattr(store, 'SEGMENT_BYTES', 1000)
    monkeypatch.setattr(store, 'FLUSH_SECONDS', 0.0)
    begin, refused = McapWriter.__init__, threading.Event()

    def refuse(self, path):
        if not path.name.endswith('_0.mcap'):
            refused.set()
            raise OSError(28, 'No space left on device')
        begin(self, path)

    monkeypatch.setattr(McapWriter, '__init__', refuse)
    with RecordingWriter(tmp_path / 'run') as writer:
        expected = fill(writer)
        assert refused.wait(60)
        writer.write('/field/command', VECTOR, 10**10, vector(1, 0, 0))
    assert writer.status().counts['/field/command'] == expected['/field/command'] + 1
    with Recording(tmp_path / 'run') as recording:
        assert recording.complete
        assert recording.end_ns == 10**10


def test_nothing_is_taken_after_the_end(tmp_path):
    with RecordingWriter(tmp_path / 'run') as writer:
        pass
    with pytest.raises(RuntimeError, match='closed'):
        writer.write('/field/command', VECTOR, 1, vector(1, 0, 0))


def test_an_unknown_type_is_refused_at_once(tmp_path):
    with (RecordingWriter(tmp_path / 'run') as writer,
          pytest.raises(ValueError, match='no message type')):
        writer.write('/x', 'their_msgs/msg/Thing', 0, b'')


def test_nothing_is_recorded_over(tmp_path):
    (tmp_path / 'note.txt').write_text('mine')
    with pytest.raises(InputError, match='new or empty'):
        RecordingWriter(tmp_path)
    with pytest.raises(InputError, match='folder to record to'):
        RecordingWriter(tmp_path / 'note.txt')
