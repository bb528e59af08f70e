"""Reading recordings: finished, cut off anywhere, foreign, mixed."""

import signal
import subprocess
import sys
import threading
import tracemalloc
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
import zstandard
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, MessageIndex, Schema
from mcap.writer import Writer
from recordings import VECTOR, encode, record, small_session, vector
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as BagWriter

from microbot_ros.common.errors import InputError
from microbot_ros.session import read_session
from microbot_ros.session.mcap import store
from microbot_ros.session.mcap.bag import typestore
from microbot_ros.session.mcap.chunk import ClosedChunk
from microbot_ros.session.mcap.recorder import RecordingWriter
from microbot_ros.session.mcap.recording import Recording, is_recording
from microbot_ros.session.mcap.writer import McapWriter
from microbot_ros.session.replay.as_messages import SessionMessages

HERE = Path(__file__).parent
CLOUD = 'sensor_msgs/msg/PointCloud2'


def same_session(a, b) -> None:
    np.testing.assert_array_equal(a.tracks.particle, b.tracks.particle)
    np.testing.assert_allclose(a.tracks.t, b.tracks.t, atol=2e-9)
    np.testing.assert_allclose(a.tracks.position, b.tracks.position, rtol=1e-7)
    np.testing.assert_allclose(a.commands.t, b.commands.t, atol=2e-9)
    np.testing.assert_allclose(a.commands.field, b.commands.field, rtol=1e-12)


@pytest.mark.parametrize('rolling', [False, True])
def test_a_session_comes_back_out_of_its_recording(tmp_path, rolling):
    session = small_session(rolling=rolling)
    copy = read_session(record(tmp_path / 'run', session))
    same_session(copy, session)
    assert copy.conditions == session.conditions
    assert copy.name == 'run'
    if rolling:
        np.testing.assert_allclose(copy.commands.frequency, session.commands.frequency)


def test_messages_come_by_topic_and_time_and_lazily(tmp_path):
    session = small_session()
    expected = list(SessionMessages(session).messages())
    with Recording(record(tmp_path / 'run', session)) as recording:
        assert list(recording.messages()) == expected
        assert recording.start_ns == expected[0].t_ns
        assert recording.end_ns == expected[-1].t_ns
        low, high = expected[40].t_ns, expected[90].t_ns
        assert list(recording.messages(['/particles'], low, high)) == [
            m for m in expected if m.topic == '/particles' and low <= m.t_ns < high]
        assert recording.times('/field/command').tolist() == [
            m.t_ns for m in expected if m.topic == '/field/command']
        assert list(recording.messages([])) == []


def test_a_single_file_is_a_recording_too(tmp_path):
    folder = record(tmp_path / 'run', small_session())
    assert is_recording(folder)
    same_session(read_session(folder / 'run_0.mcap'), small_session())


def chunk_ends(file: Path) -> list[int]:
    with file.open('rb') as stream:
        chunks = make_reader(stream).get_summary().chunk_indexes
        return [c.chunk_start_offset + c.chunk_length + c.message_index_length for c in chunks]


def test_cut_off_anywhere_all_whole_chunks_are_there(tmp_path, monkeypatch):
    monkeypatch.setattr(store, 'CHUNK_BYTES', 2000)
    file = record(tmp_path / 'run', small_session()) / 'run_0.mcap'
    expected = list(SessionMessages(small_session()).messages())
    whole, ends = file.read_bytes(), chunk_ends(file)
    assert len(ends) > 8
    for cut in [*range(8, 1200, 97), *range(1200, len(whole), 997), *ends, len(whole) - 1]:
        crashed = tmp_path / 'crashed.mcap'
        crashed.write_bytes(whole[:cut])
        with Recording(crashed) as recording:
            found = list(recording.messages())
            assert not recording.complete
            assert sum(topic.count for topic in recording.topics.values()) == len(found)
            times = [recording.times(topic) for topic in recording.topics] or [[]]
            assert sum(map(len, times)) == len(found)
        assert set(found) <= set(expected)
        if cut >= ends[-1]:
            assert found == expected


def test_zeros_after_a_power_cut_end_the_recording(tmp_path):
    whole = (record(tmp_path / 'run', small_session()) / 'run_0.mcap').read_bytes()
    end = chunk_ends(tmp_path / 'run' / 'run_0.mcap')[0]
    for content in (whole[:end] + bytes(5000), whole[:end - 3000] + bytes(3000)):
        crashed = tmp_path / 'crashed.mcap'
        crashed.write_bytes(content)
        with Recording(crashed) as recording:
            assert not recording.complete
            list(recording.messages())


KILLED = """
import sys, time
sys.path.insert(0, sys.argv[2])
from recordings import VECTOR, vector
from microbot_ros.session.mcap.recorder import RecordingWriter

writer = RecordingWriter(sys.argv[1])
writer.attach('rig.yaml', 'coils: 4')
while True:
    now = time.time_ns()
    writer.write('/field/command', VECTOR, now, vector(now, 1, 2))
    print(now, flush=True)
    time.sleep(0.005)
"""


def begun(folder):
    """Whether messages are on the disk."""
    if not list(folder.glob('*.mcap')):
        return False
    with Recording(folder) as recording:
        return any(recording.messages())


def killed(folder):
    """Times [ns] of the messages that a process wrote until it was killed."""
    with subprocess.Popen([sys.executable, '-c', KILLED, folder, HERE],
                          stdout=subprocess.PIPE, text=True) as process:
        sent = [int(process.stdout.readline()) for _ in range(300)]
        while not begun(folder):
            sent.append(int(process.stdout.readline()))
        process.send_signal(signal.SIGKILL)
        return sent + [int(line) for line in process.stdout.read().splitlines(keepends=True)
                       if line.endswith('\n')]


@pytest.mark.rig
def test_kill_9_costs_less_than_a_second(tmp_path):
    lost_s = []
    for k in range(20):
        sent = killed(tmp_path / f'{k}')
        with Recording(tmp_path / f'{k}') as recording:
            lost_s.append(1e-9 * (sent[-1] - max(m.t_ns for m in recording.messages())))
    assert sorted(lost_s)[18] < 1  # of 95 %


def test_after_kill_9_the_beginning_is_there_and_repair_makes_it_whole(tmp_path):
    folder = tmp_path / 'run'
    sent = killed(folder)
    with Recording(folder) as recording:
        assert not recording.complete
        kept = [message.t_ns for message in recording.messages()]
        assert kept
        assert kept == sent[:len(kept)]
        recording.repair()
    with Recording(folder) as recording:
        assert recording.complete
        assert [message.t_ns for message in recording.messages()] == kept
        assert recording.attachments() == {'rig.yaml': b'coils: 4'}
    with AnyReader([folder]) as reader:
        assert [t for _, t, _ in reader.messages()] == kept


def test_a_recording_in_progress_reads_as_far_as_it_goes_and_is_not_repaired(
    tmp_path, monkeypatch,
):
    monkeypatch.setattr(store, 'FLUSH_SECONDS', 0.0)
    write, written = McapWriter.add_chunk, threading.Event()
    monkeypatch.setattr(
        McapWriter, 'add_chunk', lambda self, chunk: (write(self, chunk), written.set()))
    with RecordingWriter(tmp_path / 'run') as writer:
        writer.write('/field/command', VECTOR, 7, vector(7, 1, 2))
        assert written.wait(60)
        with Recording(tmp_path / 'run') as recording:
            assert [message.t_ns for message in recording.messages()] == [7]
            with pytest.raises(InputError, match='no program is writing'):
                recording.repair()
        writer.write('/field/command', VECTOR, 8, vector(8, 1, 2))
    with Recording(tmp_path / 'run') as recording:
        assert recording.complete
        assert [message.t_ns for message in recording.messages()] == [7, 8]


def test_a_recording_by_rosbags_reads_alike_and_survives_a_crash(tmp_path):
    with BagWriter(tmp_path / 'bag', version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection('/rig/field/command', VECTOR, typestore=typestore())
        for i in range(5000):
            writer.write(connection, 10**9 + i * 1000, vector(i, 1, 2) + bytes(300))
    file = tmp_path / 'bag' / 'bag.mcap'
    for complete in (True, False):
        with Recording(tmp_path / 'bag') as recording:
            assert recording.complete == complete
            assert recording.topic('field/command', VECTOR) == '/rig/field/command'
            kept = list(recording.messages())
            assert kept[0].data == vector(0, 1, 2) + bytes(300)
            assert len(kept) == recording.topics['/rig/field/command'].count
            assert len(kept) == 5000 if complete else 2000 < len(kept) < 5000
        file.write_bytes(file.read_bytes()[:-file.stat().st_size // 6])
        (tmp_path / 'bag' / 'metadata.yaml').unlink(missing_ok=True)


def test_a_recording_without_chunks_reads_alike_finished_or_cut_off(tmp_path):
    expected = list(SessionMessages(small_session()).messages())
    with (tmp_path / 'bare.mcap').open('wb') as stream:
        writer = Writer(stream, use_chunking=False)
        writer.start('ros2')
        schemas = {kind: writer.register_schema(kind, 'ros2msg', b'')
                   for kind in {message.type for message in expected}}
        channels = {topic: writer.register_channel(topic, 'cdr', schemas[kind])
                    for topic, kind in {(m.topic, m.type) for m in expected}}
        for m in expected:
            writer.add_message(channels[m.topic], m.t_ns, m.data, m.t_ns)
        writer.finish()
    whole = (tmp_path / 'bare.mcap').read_bytes()
    for size in (len(whole), len(whole) // 2):
        (tmp_path / 'bare.mcap').write_bytes(whole[:size])
        with Recording(tmp_path / 'bare.mcap') as recording:
            kept = list(recording.messages())
            assert kept == expected[:len(kept)]
            assert recording.complete == (len(kept) == len(expected))
            assert sum(topic.count for topic in recording.topics.values()) == len(kept) > 50
            assert recording.times('/particles').tolist() == [
                m.t_ns for m in kept if m.topic == '/particles']


def foreign(path: Path, encoding: str = 'json') -> Path:
    with path.open('wb') as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema('Thing', 'jsonschema', b'{}')
        channel = writer.register_channel('/thing', encoding, schema)
        writer.add_message(channel, 1, b'{}', 1)
        writer.finish()
    return path


def test_what_is_no_recording_is_refused(tmp_path):
    for name, content, said in (
        ('empty.mcap', b'', 'found an empty file'), ('text.mcap', b'hello world' * 9, 'MCAP'),
        ('short.mcap', b'\x89MCAP', 'MCAP'),
    ):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match=said) as refusal:
            Recording(tmp_path / name)
        assert refusal.value.source.endswith(name)
    with pytest.raises(InputError, match='CDR'):
        Recording(foreign(tmp_path / 'foreign.mcap'))
    with pytest.raises(InputError, match='found nothing'):
        Recording(tmp_path / 'nowhere')
    (tmp_path / 'bag').mkdir()
    (tmp_path / 'bag' / 'bag_0.db3').write_bytes(b'SQLite')
    with pytest.raises(InputError, match='sqlite3'):
        Recording(tmp_path / 'bag')


def test_a_broken_index_is_made_anew(tmp_path):
    file = record(tmp_path / 'run', small_session()) / 'run_0.mcap'
    whole = bytearray(file.read_bytes())
    summary = chunk_ends(file)[-1] + 40
    whole[summary:summary + 30] = b'\xfe' * 30
    file.write_bytes(whole)
    expected = list(SessionMessages(small_session()).messages())
    with Recording(tmp_path / 'run') as recording:
        assert not recording.complete
        assert list(recording.messages()) == expected
        recording.repair()
    with Recording(tmp_path / 'run') as recording:
        assert recording.complete
        assert list(recording.messages()) == expected


def test_broken_chunks_are_refused_where_they_are_read(tmp_path):
    file = record(tmp_path / 'run', small_session()) / 'run_0.mcap'
    whole = bytearray(file.read_bytes())
    with file.open('rb') as stream:
        start = make_reader(stream).get_summary().chunk_indexes[0].chunk_start_offset
    whole[start + 60:start + 200] = bytes(140)
    file.write_bytes(whole)
    with Recording(file) as recording, pytest.raises(InputError, match='damaged data'):
        list(recording.messages())


def one_chunk(file: Path, compression: str, data: bytes, says: int) -> None:
    """A recording of one chunk with `data` as they are, that `says` how much it holds."""
    writer = McapWriter(file)
    writer.add_channel(Schema(id=1, name=VECTOR, encoding='ros2msg', data=b''), Channel(
        id=1, schema_id=1, topic='/t', message_encoding='cdr', metadata={}))
    writer.add_chunk(ClosedChunk(Chunk(
        compression=compression, data=data, message_start_time=1, message_end_time=1,
        uncompressed_crc=0, uncompressed_size=says), [MessageIndex(1, [(1, 0)])]))
    writer.finish()


@pytest.mark.parametrize(('compression', 'squeeze'), [
    ('zstd', lambda data: zstandard.ZstdCompressor(write_content_size=True).compress(data)),
    ('zstd', lambda data: zstandard.ZstdCompressor(write_content_size=False).compress(data)),
    ('lz4', lz4.frame.compress)])
@pytest.mark.parametrize('says', [100, 2**28 + 1, 2**40])
def test_a_chunk_that_would_fill_the_memory_is_refused(tmp_path, compression, squeeze, says):
    """What it says is more than the file may hold, or less than comes out of it."""
    file = tmp_path / 'bomb.mcap'
    one_chunk(file, compression, squeeze(bytes(2**28)), says)
    assert file.stat().st_size < 2**21
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match='damaged data'), Recording(file) as recording:
            list(recording.messages())
        assert tracemalloc.get_traced_memory()[1] < 2**26
    finally:
        tracemalloc.stop()


def test_mixed_and_incomplete_folders_are_refused(tmp_path):
    a = record(tmp_path / 'a', small_session())
    b = record(tmp_path / 'b', small_session())
    (b / 'b_0.mcap').rename(a / 'b_0.mcap')
    with pytest.raises(InputError, match=r'b_0\.mcap'):
        Recording(b)
    (a / 'metadata.yaml').write_text('nonsense: 1\n')
    with pytest.raises(InputError, match='rosbag2') as refusal:
        Recording(a)
    assert refusal.value.source.endswith('metadata.yaml')
    (a / 'metadata.yaml').unlink()
    with pytest.raises(InputError, match='files of a, b'):
        Recording(a)
    (a / 'b_0.mcap').unlink()
    (a / 'tracks.csv').write_text('')
    with pytest.raises(InputError, match='both'):
        read_session(a)


def test_files_of_a_recording_that_disagree_on_a_type_are_refused(tmp_path):
    for i, kind in enumerate((VECTOR, 'geometry_msgs/msg/PointStamped')):
        with RecordingWriter(tmp_path / str(i)) as writer:
            writer.write('/field/command', kind, i, b'')
    (tmp_path / 'run').mkdir()
    for i in range(2):
        (tmp_path / str(i) / f'{i}_0.mcap').rename(tmp_path / 'run' / f'run_{i}.mcap')
    with pytest.raises(InputError, match='Vector3Stamped on /field/command'):
        Recording(tmp_path / 'run')


@pytest.mark.parametrize(('topics', 'kind', 'data', 'said'), [
    (['/particles'], 'std_msgs/msg/String', encode('std_msgs/msg/String', 'x'),
     'PointCloud2 on /particles, found std_msgs/msg/String'),
    (['/a/particles', '/b/particles'], CLOUD, b'', '/a/particles, /b/particles'),
    (['/particles'], CLOUD, b'\x00\x01\x00\x00\xff', f'expected a {CLOUD}')])
def test_topics_of_another_type_twice_or_damaged_are_refused(tmp_path, topics, kind, data, said):
    with RecordingWriter(tmp_path / 'run') as writer:
        for i, topic in enumerate(topics):
            writer.write(topic, kind, i, data)
    with pytest.raises(InputError, match=said):
        read_session(tmp_path / 'run')
