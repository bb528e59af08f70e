"""Chunks: the same memory again and again, and nothing of the last chunk in the next."""

from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.stream_reader import get_chunk_data_stream

from microbot_ros.session.mcap.chunk import ChunkBuilder
from microbot_ros.session.mcap.records import chunk_messages
from microbot_ros.session.mcap.writer import bytes_of, chunk_head

MESSAGES = st.lists(st.tuples(st.integers(1, 5), st.integers(0, 2**60), st.binary(max_size=300)),
                    min_size=1, max_size=20)


@settings(max_examples=30)
@given(st.lists(MESSAGES, min_size=1, max_size=4))
def test_every_chunk_holds_its_own_messages_where_its_index_says(chunks):
    builder = ChunkBuilder()
    for messages in chunks:
        for message in messages:
            builder.add(*message)
        closed = builder.close()
        assert builder.size == 0
        stream, size = get_chunk_data_stream(closed.chunk, validate_crc=True)
        data = stream.read(size)
        assert len(data) == size == closed.chunk.uncompressed_size
        found = list(chunk_messages(data))
        assert [(c, t, data[a:b]) for c, t, _, a, b in found] == messages
        assert {(index.channel_id, *record) for index in closed.indexes
                for record in index.records} == {(c, t, start) for c, t, start, _, _ in found}
        times = [t for _, t, _ in messages]
        assert (closed.chunk.message_start_time, closed.chunk.message_end_time) == (
            min(times), max(times))
        assert bytes_of(closed.chunk) == chunk_head(closed.chunk) + closed.chunk.data
