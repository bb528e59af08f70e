"""The ordered log of what the nodes took in, and recorded messages found by it."""

import json
import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recordings import Listed, vector

from microbot_ros.common.errors import InputError
from microbot_ros.session.mcap.recording import Message
from microbot_ros.session.replay.log import (
    Entry,
    Inputs,
    header_stamp_ns,
    order_of_receipt,
    read_log,
)

VECTOR = 'geometry_msgs/msg/Vector3Stamped'
MS = 1_000_000


def received(topic, t_ms, stamp_ms, x=0.0):
    return Message(topic, VECTOR, t_ms * MS, vector(stamp_ms * MS, x, 0.0))


def text(content):
    data = content + b'\0'
    return Message('/loop/log', 'std_msgs/msg/String', 1,
                   b'\0\1\0\0' + struct.pack('<I', len(data)) + data)


def line(node, turn, *taken):
    return text(json.dumps({'node': node, 'turn': turn, 'taken': taken}).encode())


def frame(stamp, *calls):
    return ['particles', stamp, stamp + 5, *calls]


def log(*lines):
    return list(read_log(Listed(lines), '/loop/log', 'model', 'particles'))


def test_the_entries_of_a_node_come_in_order_and_those_of_others_not_at_all():
    found = log(line('model', 1, ['field/applied', 7, 9], frame(10)),
                line('controller', 1, ['model/state', 10, 20]), line('model', 2, frame(20, 'tl')))
    assert found == [Entry('field/applied', 7, 9), Entry('particles', 10, 15),
                     Entry('particles', 20, 25, 'tl')]


def test_a_line_without_a_frame_belongs_to_the_next():
    found = log(line('model', 0, ['field/applied', 1, 2]), line('model', 1, frame(10)))
    assert [entry.doubt for entry in found] == ['', '']


@pytest.mark.parametrize(('lines', 'place', 'reason'), [
    ([line('model', 5, frame(10)), line('model', 6, frame(20))], 0, 'before the recording began'),
    ([line('model', 1, frame(10)), line('model', 3, frame(20))], 1, 'whose log was lost'),
    ([line('model', 1, frame(10)), line('model', 1, frame(20))], 1, 'was started again'),
    ([line('model', 2, frame(10)), line('model', 1, frame(20))], 1, 'was started again'),
])
def test_a_gap_in_the_log_is_named_where_it_is(lines, place, reason):
    assert reason in log(*lines)[place].doubt


@pytest.mark.parametrize('content', [
    b'steam', b'{}', b'{"node": "model", "turn": 1, "taken": []}',
    b'{"node": "model", "turn": 1, "taken": [["particles"]]}'])
def test_other_text_is_refused(content):
    with pytest.raises(InputError, match='expected a line of the loop log'):
        log(text(content))


def test_without_a_log_the_order_is_that_of_receipt():
    source = Listed([received('/particles', 100, 90), received('/a/field', 95, 94)])
    found = list(order_of_receipt(source, {'/particles': 'particles', '/a/field': 'field'}))
    assert found == [Entry('field', 94 * MS, 95 * MS), Entry('particles', 90 * MS, 100 * MS)]


def test_inputs_are_found_by_stamp_in_whatever_order_they_came():
    source = Listed([received('/goals', 900, 5, 1.0)]
                    + [received('/a', t, s) for t, s in ((100, 1), (130, 2), (90, 3))])
    inputs = Inputs(source, {'a': '/a', 'goals': '/goals'})
    assert [inputs.find('a', s * MS, 100 * MS) for s in (1, 2, 3)] == [
        vector(s * MS, 0.0, 0.0) for s in (1, 2, 3)]
    assert inputs.find('a', 1 * MS, 100 * MS) is None
    assert inputs.find('goals', 5 * MS, 100 * MS) == vector(5 * MS, 1.0, 0.0)


def test_of_messages_with_one_stamp_each_is_the_nearest():
    source = Listed([received('/goals', 100 * k, 0, float(k)) for k in range(1, 6)])
    inputs = Inputs(source, {'goals': '/goals'})
    assert inputs.find('goals', 0, 310 * MS) == vector(0, 3.0, 0.0)
    assert inputs.find('goals', 0, 420 * MS) == vector(0, 4.0, 0.0)
    assert inputs.find('joy', 0, 420 * MS) is None


@given(st.integers(0, 2**31 - 1), st.integers(0, 999_999_999))
@settings(max_examples=30)
def test_the_stamp_is_read_out_of_the_bytes(seconds, nanoseconds):
    t_ns = seconds * 10**9 + nanoseconds
    assert header_stamp_ns(vector(t_ns, 1.0, 2.0)) == t_ns
    big = b'\0\0\0\0' + struct.pack('>iI', seconds, nanoseconds)
    assert header_stamp_ns(big) == t_ns


@pytest.mark.parametrize('data', [b'', b'\0\1\0\0', bytes(11)])
def test_a_message_too_short_for_a_header_is_refused(data):
    with pytest.raises(InputError, match='expected a message with a header'):
        header_stamp_ns(data)
